"""Random cameras on random benches through a validation without the wire: how often is an honest
one rejected, is a fault named.

``python benchmarks/bench_validation.py WHAT FIRST COUNT FILE`` adds a line of JSON a bench to FILE;
WHAT is ``ideal`` (lenses all alike, light as rays), ``waves`` (even seeds in light of a wavelength
that the bench file states), ``real`` (workmanship, halo, shading, distortion and saturation of a
workshop), ``bare`` (the same, whose bench file states workmanship alone: no floor, no uncertainty
of the model) or ``fault`` (a real bench and one fault of ``planted_faults.KINDS``;
``plain-fault``: an ideal one). ``table FILE ...`` prints what docs/report.md says.
"""

import json
import math
import sys
import time
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from planted_faults import KINDS, drawn_world, seen
from random_benches import Drawn, drawn_bench, drawn_camera, drawn_study

from flflab.bench import Bench
from flflab.bench_uncertainty import (
    LightDescription,
    MeasurementFloorDescription,
    ModelUncertaintyDescription,
    WorkmanshipDescription,
)
from flflab.errors import FlflabError
from flflab.verdict.diagnosis import likeliest
from flflab.verdict.evaluation import Evaluation, evaluate_measured

STATED = {  # of a real bench, as ``flflab new bench`` writes it
    "workmanship": WorkmanshipDescription.model_validate(
        {
            "microlens_position": "0.3 um", "aperture_decentre": "0.1 um",
            "microlens_focal_length": "1 %", "microlens_brightness": "1 %", "scale": 1e-5,
        }
    ),
    "model_uncertainty": ModelUncertaintyDescription.model_validate(
        {"contrast": "1 %", "widths": "1 %", "pitch": "0.02 %", "distance": "0.5 %"}
    ),
    "measurement_floor": MeasurementFloorDescription.model_validate(
        {"contrast": 0.002, "position": "0.02 px", "radius": "0.05 px"}
    ),
}  # fmt: skip


def described(bench: Bench, wavelength: float | None, what: str) -> Bench:
    """The bench whose file states its light and, where it is real, what workshops leave."""
    light = None
    if wavelength is not None:
        light = LightDescription.model_validate({"wavelength": f"{1e6 * wavelength} nm"})
    states = {"real": STATED, "fault": STATED, "bare": {"workmanship": STATED["workmanship"]}}
    stated = {"light": light, "wavelength": None} | states.get(what, {})
    return replace(bench, description=bench.description.model_copy(update=stated))


def one_trial(seed: int, what: str) -> dict[str, Any]:
    """One random bench, validated: what was drawn, verdicts, suspects, failures."""
    rng = np.random.default_rng((seed, 2026))
    drawn: Drawn = drawn_camera(rng)
    kind = list(KINDS)[seed % len(KINDS)] if what.endswith("fault") else ""
    real = what in ("real", "bare", "fault")
    bent = what == "waves" and seed % 2 == 0
    wavelength = float(rng.uniform(450e-6, 650e-6)) if bent else None
    bench, study = drawn_bench(rng, drawn), drawn_study(rng, drawn)
    bench = described(bench, None if kind == "light not stated" else wavelength, what)
    world = drawn_world(rng, bench, wavelength, real, kind)
    camera, array = drawn.camera, drawn.camera.array
    found: dict[str, Any] = {
        "seed": seed, "what": what, "fault": world.kind, "size": world.size,
        "wavelength": wavelength, "focal_length": camera.main_lens.focal_length,
        "f_number": camera.main_lens.f_number, "distance": drawn.distance, "layout": array.layout,
        "kinds": len(array.focal_lengths),
        "pitch": array.pitch[0], "pixel": camera.sensor.pixel, "gap": camera.gap,
        "array": array.distance, "virtual_depth": drawn.v,
        "resolution": camera.sensor.resolution,
        "behind_the_image": 1 / array.focal_lengths[0] > 1 / camera.gap,
        "settings": len(study.configurations),
    }  # fmt: skip
    start = time.process_time()
    try:
        places = range(len(study.configurations))
        measured = tuple(seen(rng, place, bench, study, world) for place in places)
        found["failures"] = [str(failure) for one in measured for failure in one.failures]
        found |= told(evaluate_measured(measured, study, bench, seed))
    except FlflabError as error:
        found["refused"] = str(error)
    except Exception:  # what a user would see as a traceback is what is looked for
        found["traceback"] = traceback.format_exc()
    return found | {"cpu_s": time.process_time() - start}


def told(run: Evaluation) -> dict[str, Any]:
    """What an evaluation says, in numbers."""
    comparison = run.comparison
    return {
        "p": {one.quantity: one.p_value for one in comparison.verdicts},
        "rejected": [one.quantity for one in comparison.verdicts if not one.accepted],
        "suspects": [
            (one.what, one.size, one.chi2, one.chi2_before, one.numbers) for one in run.suspects
        ],
        "named": [one.what for one in likeliest(run.suspects) if one.explains],
        "z": {
            quantity: [round(row.z, 3) for row in comparison.rows if row.quantity == quantity]
            for quantity in dict.fromkeys(row.quantity for row in comparison.rows)
        },
        "counts": [
            (row.measured, row.predicted) for row in comparison.rows if row.quantity == "views"
        ],
        "odd": [
            str(row)
            for row in comparison.rows
            if not all(map(math.isfinite, (row.measured, row.uncertainty, row.predicted, row.z)))
        ],
    }


def table(files: list[str]) -> None:
    """Rejections, and how the p-values of each property are spread; of faults, which were named."""
    benches = [json.loads(line) for file in files for line in Path(file).read_text().splitlines()]
    judged = [one for one in benches if "p" in one]
    print(
        f"{len(benches)} benches, {sum('refused' in one for one in benches)} refused, "
        f"{sum('traceback' in one for one in benches)} tracebacks"
    )
    print(f"{sum(bool(one['rejected']) for one in judged)} of {len(judged)} rejected")
    for quantity in dict.fromkeys(quantity for one in judged for quantity in one["p"]):
        p = np.array([one["p"][quantity] for one in judged if quantity in one["p"]])
        fifths = np.histogram(p, np.linspace(0, 1, 6))[0].tolist()
        z = [z for one in judged for name in one["z"] if name == quantity for z in one["z"][name]]
        rms = f", rms z {np.sqrt(np.mean(np.square(z))):.2f}" if z else ""
        print(
            f"{quantity}: {len(p)}, below 0.05 {100 * np.mean(p < 0.05):.0f} %, median"
            f" {np.median(p):.2f}, fifths {fifths}{rms}"
        )
    planted = [one for one in benches if one["fault"]]
    for one in planted:
        says = one.get("named", one.get("refused", "traceback"))
        print(f"{one['seed']} {one['fault']} {one['size']:.3g}: {says}")
    shown = [one for one in planted if one.get("rejected") or "refused" in one]
    right = [
        one
        for one in planted
        if any(what.startswith(KINDS[one["fault"]][2]) for what in one.get("named", ()))
    ]
    wrong = [one for one in planted if one.get("named") and one not in right]
    print(
        f"of {len(planted)} faults {len(shown)} detected, {len(right)} named right,"
        f" {len(wrong)} wrong"
    )


def main() -> None:
    """See the file's head."""
    if sys.argv[1] == "table":
        table(sys.argv[2:])
        return
    what, first, count, file = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])
    for seed in range(first, first + count):
        line = json.dumps(one_trial(seed, what))
        with file.open("a") as out:
            out.write(line + "\n")


if __name__ == "__main__":
    main()
