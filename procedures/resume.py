"""Go on with a run that was cut short: home what lost its reference, see that the bench still shows
the same, take what is missing.

The pictures of the point at which the run stopped are taken again and compared with those recorded.
That they are all taken, not one, brings a simulated camera, whose noise is keyed by a point and the
number of its frame, to where it was: the finished run is then the same, number by number, as one
that was never interrupted.
"""

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from bluesky import Msg

from drivers.bench import ConnectedBench
from flflab.bench import Bench
from flflab.errors import InputError, MeasurementError
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.sequential import Look, frames_due
from flflab.record import FrameRecord, Recording, Run
from flflab.study import Configuration, Study
from procedures.capture import take
from procedures.devices import NO_CONFIGURATION, Shot
from procedures.engine import perform
from procedures.steps import (
    Capture,
    CaptureDark,
    CaptureUntil,
    Expose,
    Home,
    SetIris,
    ShowTarget,
    Step,
    home_steps,
    homed_readings,
    move_step,
    steps,
)  # fmt: skip
from procedures.study import metadata, tell_nobody
from procedures.sweep import Course, Instruments, Tell, instruments, sweep

Plan = Generator[Msg, Any, Any]
RESUMABLE = ("sweep", "validate", "calibrate")
LIT, FEWEST_LIT = 5.0, 100  # standard deviations of a dark block's mean above it; pixels
BLOCK = 9  # pixels a side: a pixel chosen for its own noise would be one of more light than it has
MOST_DIFFERENCE = 1.2  # rms over the noise's; 1 % less light where views are brightest makes it


@dataclass
class Standing:
    """How a bench stood after a step, so that it can stand so again."""

    f_number: float | None = None
    target: str | None = None
    configuration: Configuration | None = None


@dataclass(frozen=True)
class Rest:
    """What a run still needs: how the bench stood when its last frame was taken, that point's
    frames, and the steps after them.
    """

    standing: Standing
    frames: tuple[FrameRecord, ...]
    steps: tuple[Step, ...]
    looks: dict[int, tuple[Look, ...]] = field(default_factory=dict[int, tuple[Look, ...]])


def require_unfinished(run: Run) -> None:
    """Refuse what cannot be gone on with.

    Raises:
        InputError: it was taken to its end, or is no run of a study.
    """
    if run.start.get("plan_name") not in RESUMABLE:
        raise InputError(
            f"{run.folder}: a run of {run.start.get('plan_name', 'something else')} cannot be"
            " continued; start it again"
        )
    if run.complete:
        raise InputError(
            f"{run.folder}: this run was taken to its end, there is nothing to continue; `flflab"
            " report` measures it again"
        )


def rest_of(run: Run, study: Study, bench: Bench) -> Rest:
    """What is left of a run.

    Raises:
        InputError: its last frame is none of its study.
    """
    to_do = steps(study, bench)
    looks: dict[int, tuple[Look, ...]] = {}
    for one in run.accuracy:
        looks[one.configuration] = (
            *looks.get(one.configuration, ()),
            Look(one.frames, one.mtf_standard_uncertainty),
        )
    if not run.frames:
        return Rest(Standing(), (), to_do, looks)
    last = run.frames[-1]
    point = last.key.rpartition("/")[0]
    standing = Standing()
    for number, step in enumerate(to_do):
        match step:
            case SetIris(f_number):
                standing.f_number = f_number
            case ShowTarget(kind):
                standing.target = kind
            case Expose(configuration) | Capture(configuration) | CaptureUntil(configuration):
                standing.configuration = configuration
            case _:
                pass
        if _belongs(last, step):
            done = not isinstance(step, CaptureDark) and (
                not isinstance(step, CaptureUntil) or _finished(step, looks)
            )
            frames = tuple(frame for frame in run.frames if frame.key.rpartition("/")[0] == point)
            return Rest(standing, frames, to_do[number + done :], looks)
    raise InputError(
        f"{run.folder}: its last frame, {last.key}, is none of its study; study.yaml or bench.yaml"
        " were changed"
    )


def _belongs(frame: FrameRecord, step: Step) -> bool:
    match step:
        case Expose() | Capture():
            return frame.key == step.key
        case CaptureUntil():
            return frame.key == step.key(frame.repeat)
        case CaptureDark():
            return frame.configuration is None
        case _:
            return False


def _finished(step: CaptureUntil, looks: dict[int, tuple[Look, ...]]) -> bool:
    mine = looks.get(step.configuration.index, ())
    return (
        bool(mine) and frames_due(mine, step.mtf_standard_uncertainty, step.most) == mine[-1].frames
    )


def way_back(rest: Rest, bench: ConnectedBench) -> tuple[Step, ...]:
    """Home the axes without a reference, then stand as when the last frame was taken; errors as
    ``move_step``.

    Every axis is sent there, one that stands there too: it has to stay where it was sent.
    """
    lost = {name for name, axis in bench.axes.items() if not axis.is_homed()}
    homes = (
        Home(tuple(name for name in step.axes if name in lost))
        for step in home_steps(bench.described)
    )
    found: list[Step] = [step for step in homes if step.axes]
    if rest.standing.f_number is not None:
        found.append(SetIris(rest.standing.f_number))
    if rest.standing.target is not None:
        found.append(ShowTarget(rest.standing.target))
    if rest.standing.configuration is not None:
        ends = homed_readings(bench.described)
        now = {
            name: ends[name] if name in lost else axis.position()
            for name, axis in bench.axes.items()
        }
        move = move_step(rest.standing.configuration, bench.described, now, frozenset(bench.axes))
        found += [move] if move.groups else []
    return tuple(found)


def resume(
    bench: ConnectedBench, study: Study, run: Run, rest: Rest, recording: Recording, tell: Tell
) -> None:
    """Take what a run still needs into its record.

    Args:
        bench: the connected bench.
        study: as recorded.
        run: as read before ``recording`` began.
        rest: what is left of it.
        recording: a ``ContinuedRecording`` of the run.
        tell: called when a step begins.

    Raises:
        MeasurementError: the bench shows something else than when the run stopped.
        RunInterruptedError: the operator asked for the end; every axis stands.
        DeviceError: an instrument failed; every axis was told to stop.
        RecordError: the disk does not take the record.
    """
    to_do, back = (
        rest.steps,
        way_back(rest, bench) if run.frames else (),
    )  # with nothing recorded the steps begin with homing
    noise = SensorNoise(**run.sensor_noise)

    def plan(tell: Tell) -> Plan:
        here = instruments(
            bench, study, recording, {frame.key: frame.index for frame in run.frames}
        )
        here.accuracy.looks.update(rest.looks)
        course = _course(run)
        yield from sweep(here, back, course, tell)
        yield from _check(run, rest, here, noise)
        yield from sweep(here, to_do, course, tell)

    about = metadata(bench, study, len(back) + len(to_do)) | {
        "plan_name": run.start["plan_name"],
        "resumes": _latest(run),
        **({"retakes": list(run.lost)} if run.lost else {}),
    }
    perform(plan(tell), plan(tell_nobody), about, bench, recording)


def _latest(run: Run) -> str:
    return str((run.resumed[-1] if run.resumed else run.start)["uid"])


def _course(run: Run) -> Course:
    """The exposures found so far, the last one last."""
    exposures = {
        frame.configuration: frame.exposure_s
        for frame in run.frames
        if frame.configuration is not None and frame.target == "white"
    }
    course = Course(exposures)
    if exposures:
        course.guess = list(exposures.values())[-1]
    return course


def _check(run: Run, rest: Rest, here: Instruments, noise: SensorNoise) -> Plan:
    """Take the frames of the last point again; refuse to go on where they differ by more than
    noise.
    """
    for frame in rest.frames:
        shot = Shot(f"check of {frame.key}", NO_CONFIGURATION, frame.repeat, frame.exposure_s)
        yield from take(here.frames, shot)
        if here.frames.latest is None:  # a rehearsal
            return
        require_same(frame.key, run.picture(frame), here.frames.latest.picture, noise)


def require_same(
    key: str, recorded: npt.NDArray[np.uint16], again: npt.NDArray[np.uint16], noise: SensorNoise
) -> None:
    """Refuse a bench that does not show what it showed.

    Raises:
        MeasurementError: two pictures of one point differ by more than noise.
    """
    ratio = difference_over_noise(recorded, again, noise)
    if ratio > MOST_DIFFERENCE:
        raise MeasurementError(
            f"{key}: taken again it differs from the recorded picture {ratio:.2f} times as much as"
            f" noise does, allowed is {MOST_DIFFERENCE}; the bench is not as it was (light, target,"
            " stages): put it back and resume again, or begin a new run"
        )


def difference_over_noise(
    recorded: npt.NDArray[np.uint16], again: npt.NDArray[np.uint16], noise: SensorNoise
) -> float:
    """Root mean square difference of two pictures over that of two with the same light; 1 for noise
    alone.

    Of unsaturated pixels, and of those only the ones in lit surroundings where there are a hundred:
    what changes changes there.
    """
    first, second = recorded.astype(np.float64), again.astype(np.float64)
    mean, good = (first + second) / 2, ~(noise.saturated(first) | noise.saturated(second))
    lit = good & (
        cv2.blur(mean, (BLOCK, BLOCK)) > noise.offset_dn + LIT * noise.dark_variance**0.5 / BLOCK
    )
    chosen = lit if np.count_nonzero(lit) >= FEWEST_LIT else good
    differences = (first[chosen] - second[chosen]) ** 2 / (2 * noise.variance(mean[chosen]))
    return float(np.sqrt(np.mean(differences))) if chosen.any() else 0.0
