"""A study taken on a bench as one recorded run: home, then sweep; rehearsed before anything
moves.
"""

from collections.abc import Generator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bluesky import Msg

from drivers.bench import ConnectedBench
from flflab.record import RECORD_SCHEMA, TEMPERATURES, Recording, versions
from flflab.simulated_light import drawings, is_simulated
from flflab.study import Study
from procedures.engine import perform
from procedures.steps import most_frames, steps
from procedures.sweep import Course, Progress, Tell, instruments, sweep


def take_study(
    bench: ConnectedBench, study: Study, recording: Recording, tell: Tell, name: str
) -> None:
    """Home every axis and take every frame of a study; the record is complete when this returns,
    and intact when it raises.

    Args:
        bench: the connected bench.
        study: what to take.
        recording: where it goes, from ``begin_recording``.
        tell: called when a step begins.
        name: of the procedure, recorded: ``sweep`` or ``validate``.

    Raises:
        RunInterruptedError: the operator asked for the end; every axis stands.
        DeviceError: an instrument failed; every axis was told to stop.
        MeasurementError: no exposure fits.
        LimitError: a step is not possible on this bench; nothing moved.
        RecordError: the disk does not take the record.
    """
    to_do = steps(study, bench.described)

    def plan(tell: Tell) -> Generator[Msg, Any, Any]:
        return sweep(instruments(bench, study, recording), to_do, Course(), tell)

    perform(
        plan(tell),
        plan(tell_nobody),
        {"plan_name": name} | metadata(bench, study, len(to_do)),
        bench,
        recording,
    )


def tell_nobody(progress: Progress) -> None:
    """Keep progress to oneself."""


def begin_recording(bench: ConnectedBench, study: Study, folder: Path) -> Recording:
    """A record in a run's folder, with room for every frame of a study."""
    columns, rows = bench.described.optics.sensor.resolution
    return Recording(folder, most_frames(steps(study, bench.described)), (rows, columns))


def metadata(bench: ConnectedBench, study: Study, count: int) -> dict[str, Any]:
    """What the start document of a study's run says beside the procedure's name."""
    camera, described = bench.camera, bench.described
    warmth = described.description.temperature.range
    simulated = is_simulated(described.description.camera.address)
    return {
        "record_schema": RECORD_SCHEMA,
        TEMPERATURES: None if warmth is None else list(warmth),
        "study": study.description.name,
        "steps": count,
        "axes": list(bench.axes),
        "configurations": [asdict(configuration) for configuration in study.configurations],
        "sensor_noise": {
            "dn_per_electron": camera.dn_per_electron, "read_noise_dn": camera.read_noise_dn,
            "offset_dn": camera.offset_dn, "full_scale_dn": camera.full_scale,
        },
        "devices": [row._asdict() for row in bench.identities()],
        "seed": described.description.simulated.seed,
        "software": versions(),
        "simulated_light": (
            [asdict(one) for one in drawings(described, study)] if simulated else None
        ),
    }  # fmt: skip
