"""``verdict.json`` and JUnit XML of an evaluated run: what a program reads of a verdict."""

import hashlib
import json
import math
from typing import Any
from xml.etree import ElementTree

from flflab.property_names import PROPERTY_NAMES
from flflab.record import Run, versions
from flflab.report.budgets import budget_numbers
from flflab.report.facts import following
from flflab.verdict.comparison import Verdict, percent
from flflab.verdict.diagnosis import likeliest
from flflab.verdict.evaluation import Evaluation

SCHEMA = 2  # of verdict.json; described by verdict.schema.json beside this file


def verdict_numbers(evaluation: Evaluation, run: Run) -> dict[str, Any]:
    """What ``verdict.json`` holds.

    Args:
        evaluation: of the run.
        run: whose seed, versions and descriptions are named.
    """
    comparison, step = evaluation.comparison, following(evaluation, run)
    return {
        "schema": SCHEMA,
        "verdict": "accepted" if comparison.accepted else "rejected",
        "properties": {
            one.quantity: _property(one) | {"budgets": budget_numbers(evaluation, one.quantity)}
            for one in comparison.verdicts
        },
        "suspects": [
            {
                "name": one.what,
                "change": one.change,
                "size": one.size,
                "uncertainty": one.uncertainty if math.isfinite(one.uncertainty) else None,
                "explains": round(one.removed, 6),
                "sufficient": one.explains,
                "p_left": one.p_left,
                "chi_squared_left": one.chi2,
                "numbers": one.numbers,
            }
            for one in likeliest(evaluation.suspects)
        ],
        "visible": [
            {
                "name": one.what,
                "smallest": one.smallest if math.isfinite(one.smallest) else None,
                "unit": one.unit,
            }
            for one in evaluation.visible
        ],
        "next": {"what": step.what, "command": step.command},
        "study": str(run.start.get("study", "")),
        "began": run.start.get("time"),
        "seed": run.start.get("seed"),
        "configurations": len(evaluation.measured),
        "frames": {
            **{
                status: sum(frame.validity.status == status for frame in run.frames)
                for status in ("admitted", "diagnostic", "unvalidated")
            },
            "not_used": [
                {
                    "point": frame.key,
                    "status": frame.validity.status,
                    "reason": frame.validity.reason,
                }
                for frame in run.frames
                if not frame.validity.admitted
            ],
        },
        "repeats": _repeats(evaluation),
        "sha256": {
            name: hashlib.sha256((run.folder / name).read_bytes()).hexdigest()
            for name in ("bench.yaml", "camera.yaml", "study.yaml")
            if (run.folder / name).exists()
        },
        "versions": {"recorded": _recorded_versions(run), "evaluated": versions()},
    }


def _repeats(evaluation: Evaluation) -> dict[str, Any] | None:
    found = evaluation.repeats
    if found is None:
        return None
    return {
        "stages_mm": found.stages,
        "stages_degrees_of_freedom": found.stages_dof,
        "stages_stated_mm": found.stages_stated,
        "stages_used_mm": found.stages_used,
        "light": found.light if math.isfinite(found.light) else None,
        "light_stated": found.light_stated,
        "light_used": found.light_used,
        "pictures_over_noise": found.pictures,
        "pictures_used": found.pictures_used,
    }


def _property(one: Verdict) -> dict[str, Any]:
    return {
        "name": PROPERTY_NAMES.get(one.quantity, one.quantity),
        "values": one.rows,
        "p_value": one.p_value,
        "p_is_upper_bound": one.p_is_upper_bound,
        "draws": one.draws,
        "limit": one.threshold,
        "verdict": "accepted" if one.accepted else "rejected",
        "worst_z": one.worst_z if math.isfinite(one.worst_z) else None,
    }


def _recorded_versions(run: Run) -> dict[str, str]:
    file = run.folder / "versions.json"
    return dict(json.loads(file.read_text(encoding="utf-8"))) if file.exists() else {}


def verdict_text(evaluation: Evaluation, run: Run) -> str:
    """``verdict.json`` as text."""
    return json.dumps(verdict_numbers(evaluation, run), indent=1) + "\n"


def junit_text(evaluation: Evaluation, run: Run) -> str:
    """The verdicts as JUnit XML: a test case a property, a failure where it is rejected."""
    verdicts = evaluation.comparison.verdicts
    failed = str(sum(not one.accepted for one in verdicts))
    count = str(len(verdicts))
    whole = ElementTree.Element("testsuites", tests=count, failures=failed)
    name = f"flflab.{run.start.get('study', run.folder.name)}"
    suite = ElementTree.SubElement(
        whole, "testsuite", name=name, tests=count, failures=failed, errors="0", skipped="0"
    )
    for one in verdicts:
        case = ElementTree.SubElement(
            suite,
            "testcase",
            classname=name,
            name=PROPERTY_NAMES.get(one.quantity, one.quantity),
            time="0",
        )
        if not one.accepted:
            told = f"{one.p_clause}; rejected below {percent(one.threshold)}"
            failure = ElementTree.SubElement(case, "failure", message=told, type="rejected")
            suspects = [suspect.sentence for suspect in likeliest(evaluation.suspects)]
            failure.text = "\n".join([one.sentence, *suspects])
    ElementTree.indent(whole)
    text = ElementTree.tostring(whole, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'
