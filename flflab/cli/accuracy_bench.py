"""``flflab accuracy bench``: a simulated bench is validated again and again, with pictures drawn
more and more finely and with more and more frames.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from flflab.accuracy.bench_page import BenchRow
from flflab.bench import fields_of, read_bench
from flflab.cli.run import run_study
from flflab.errors import InputError
from flflab.simulated_light import drawing_tolerance
from flflab.targets import Bars
from flflab.verdict.evaluation import Evaluation
from flflab.yaml_file import read_yaml
from procedures.validate import judged

# Times the accuracy that the noise of a frame calls for, and frames of every point; the first one's
# time may hold compiling.
SETTINGS = ((30.0, 1), (10.0, 1), (3.0, 1), (1.0, 1), (0.3, 1), (1.0, 4))


def bench_rows(bench: Path, study: Path, tell: Callable[[str], None]) -> tuple[BenchRow, ...]:
    """Validate at every setting; some ten seconds each on two quiet cores.

    Args:
        bench: file of a bench whose devices are all simulated.
        study: file of the study.
        tell: is told what is being done.

    Raises:
        InputError: a device is real, or a file is wrong.
    """
    described = read_bench(bench)
    own = drawing_tolerance(described, Bars())
    data, steps = fields_of(described), read_yaml(study)[0]
    data["optics"] = str((bench.parent / described.description.optics).resolve())
    devices = (*data["axes"].values(), data["camera"], data["iris"], data["target"])
    if any(device["address"] != "simulated" for device in devices):
        raise InputError(
            f"--bench {bench}: only a bench whose devices are all simulated is validated over and"
            " over; set their addresses to simulated"
        )
    return tuple(
        _validated(data, steps, own * factor, frames, factor == 1.0, tell)
        for factor, frames in SETTINGS
    )


def _validated(
    bench: dict[str, Any],
    study: Any,
    tolerance: float,
    frames: int,
    own: bool,
    tell: Callable[[str], None],
) -> BenchRow:
    """One validation in a folder of its own, which goes afterwards."""
    tell(f"drawn to {tolerance:.1g} of white, {frames} frames a point")
    drawn = bench.get("simulated", {}).get("effects", {}) | (
        {} if own else {"tolerance": tolerance}
    )
    simulated = bench.get("simulated", {}) | ({"effects": drawn} if drawn else {})
    exposed = study.get("exposure", {}) | {"frames": frames}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, data in (
            ("bench.yaml", bench | {"simulated": simulated}),
            ("study.yaml", study | {"exposure": exposed}),
        ):
            (folder / file).write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
        started = time.perf_counter()
        run = run_study(
            folder / "study.yaml", folder / "bench.yaml", folder / "run", None, _nobody, "validate"
        )
        recorded = time.perf_counter()
        evaluation, _ = judged(run)
        ended = time.perf_counter()
    return _row(evaluation, tolerance, frames, recorded - started, ended - recorded)


def _row(
    evaluation: Evaluation, tolerance: float, frames: int, recorded: float, judged_in: float
) -> BenchRow:
    comparison = evaluation.comparison
    scores = np.array([row.z for row in comparison.rows if np.isfinite(row.z)])
    contrasts = [row for row in comparison.rows if row.quantity == "mtf"]
    scored = np.array([row.z for row in contrasts if np.isfinite(row.z)])
    least = min(comparison.verdicts, key=lambda one: one.p_value / max(one.threshold, 1e-12))
    return BenchRow(
        tolerance=tolerance,
        frames=frames,
        recording_s=recorded,
        judging_s=judged_in,
        rms_z=float(np.sqrt(np.mean(scores**2))),
        rms_z_contrast=float(np.sqrt(np.mean(scored**2))) if len(scored) else 0.0,
        least_p=least.p_value,
        least_p_of=least.quantity,
        uncertainty_contrast=float(np.median([row.uncertainty for row in contrasts])),
        accepted=comparison.accepted,
    )


def _nobody(step: object) -> None:
    """Progress is said once a validation."""
