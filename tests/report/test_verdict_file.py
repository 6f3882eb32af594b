"""What programs read of a verdict: ``verdict.json`` by its schema, and JUnit XML as CI reads it."""

import json
import math
from dataclasses import replace
from importlib.resources import files
from xml.etree import ElementTree

import jsonschema
import pytest

from flflab.cli.sweep import numbers_of
from flflab.record import Run
from flflab.report import junit_text, verdict_text
from flflab.verdict.comparison import Comparison, Verdict, rule
from flflab.verdict.diagnosis import Suspect
from flflab.verdict.evaluation import Evaluation

SUSPECT = Suspect(
    "sensor", 0.02, "(0.0200 ± 0.0010) mm farther", 20.0, 400.0, 24, 1e-3, 0.6, True, "calibrate"
)


@pytest.fixture
def rejected(single: Evaluation) -> Evaluation:
    mtf, views = single.comparison.verdicts
    bad = replace(mtf, accepted=False, p_value=1 / 201, worst_z=9.5, sentence="mtf disagrees")
    return replace(
        single, comparison=Comparison(single.comparison.rows, (bad, views)), suspects=(SUSPECT,)
    )


def read(evaluation: Evaluation, run: Run) -> dict[str, object]:
    found = json.loads(verdict_text(evaluation, run))
    schema = json.loads(files("flflab.report").joinpath("verdict.schema.json").read_text("utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(found, schema)
    return found


def test_an_accepted_run_keeps_the_schema(single: Evaluation, run: Run) -> None:
    found = read(single, run)
    assert found["verdict"] == "accepted"
    assert found["suspects"] == []
    assert found["study"] == "first"
    mtf = found["properties"]["mtf"]  # type: ignore[index]
    (budget,) = mtf.pop("budgets")
    assert (budget["quantity"], budget["configuration"]) == ("mtf", 0)
    variance = sum(math.copysign(one["contribution"] ** 2, one["contribution"])
                   for one in budget["sources"])  # fmt: skip
    assert variance == pytest.approx(budget["uncertainty"] ** 2)
    assert mtf == {
        "name": "contrast (MTF)", "values": 12, "p_value": 0.41, "p_is_upper_bound": False,
        "draws": 200, "limit": 0.025, "verdict": "accepted", "worst_z": 1.7,
    }  # fmt: skip


def test_a_rejected_run_names_property_bound_and_suspect(rejected: Evaluation, run: Run) -> None:
    found = read(rejected, run)
    assert found["verdict"] == "rejected"
    assert found["properties"]["mtf"]["p_is_upper_bound"] is True  # type: ignore[index]
    (suspect,) = found["suspects"]  # type: ignore[misc]
    assert suspect["name"] == "sensor"
    assert suspect["explains"] == pytest.approx(0.95)
    assert (suspect["uncertainty"], suspect["sufficient"]) == (1e-3, True)
    assert found["next"]["command"] == f"flflab calibrate --bench {run.folder / 'bench.yaml'}"  # type: ignore[index]


def test_junit_shows_each_property_as_a_test(rejected: Evaluation, run: Run) -> None:
    whole = ElementTree.fromstring(junit_text(rejected, run))  # noqa: S314 - our own
    (suite,) = whole
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    cases = {case.get("name"): case for case in suite}
    failure = cases["contrast (MTF)"].find("failure")
    assert failure is not None
    assert failure.get("message") == (
        "none of 200 simulated benches deviates as much, p < 0.5 %; rejected below 2.5 %"
    )
    assert SUSPECT.sentence in (failure.text or "")
    assert cases["number of views"].find("failure") is None


def test_a_p_value_beyond_the_simulated_benches_is_a_bound() -> None:
    one = Verdict("views", 4, 1 / 501, 500, 8.0, 0.025, False, "")
    assert one.p_words == "none of 500, p < 0.2 %"
    assert one.p_clause == "none of 500 simulated benches deviates as much, p < 0.2 %"
    inside = replace(one, p_value=2 / 501)
    assert (inside.p_words, inside.p_clause) == ("0.399 %", "p-value 0.399 %")


def test_the_rule_says_how_the_level_is_shared() -> None:
    one = Verdict("views", 4, 0.5, 500, 1.0, 0.025, True, "")
    told = rule((one, replace(one, quantity="mtf")))
    assert "2 properties share the level of 5 %" in told
    assert "rejected below 2.5 %" in told


def test_sweep_says_what_was_recorded_as_json(run: Run) -> None:
    assert json.loads(json.dumps(numbers_of(run))) == {
        "run": str(run.folder.resolve()), "study": "first", "complete": run.complete, "frames": 9,
        "configurations": 3, "accuracy": [],
    }  # fmt: skip
