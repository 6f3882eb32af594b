"""Do the steps of a study one after the other: home, turn the iris, show the target, move, expose,
take frames.
"""

import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from bluesky import Msg
from bluesky import plan_stubs as bps

from drivers.bench import ConnectedBench
from flflab.digits import two_digits
from flflab.record import Recording
from flflab.study import Study
from procedures.accuracy import Accuracy
from procedures.capture import FIRST_GUESS_S, close_event, expose, open_event, shoot
from procedures.devices import NO_CONFIGURATION, Frames, Shot, Stages
from procedures.durations import durations, seconds_left
from procedures.glance import Glance
from procedures.home import home
from procedures.steps import (
    WHITE,
    Capture,
    CaptureDark,
    CaptureUntil,
    Expose,
    Home,
    Move,
    SetIris,
    ShowTarget,
    Step,
)

Plan = Generator[Msg, Any, Any]


@dataclass(frozen=True)
class Progress:
    """How far a procedure has come.

    Steps done, of how many, what begins now, s left as far as known, the last frame in words, and
    what the last one measured shows.
    """

    done: int
    total: int
    step: str
    seconds_left: float
    last: str
    shows: str


Tell = Callable[[Progress], None]


@dataclass(frozen=True)
class Instruments:
    """What a sweep uses: the bench, its camera recording, its axes, what measures accuracy and what
    shows; level of the brightest view.
    """

    bench: ConnectedBench
    frames: Frames
    stages: Stages
    accuracy: Accuracy
    glance: Glance
    level: float


def instruments(
    bench: ConnectedBench,
    study: Study,
    recording: Recording,
    places: Mapping[str, int] | None = None,
) -> Instruments:
    """The instruments of a study, knowing the places of the frames that were recorded before."""
    frames = Frames(bench.camera, recording, places)
    accuracy = Accuracy(study, bench.described, bench.camera, recording, frames.places)
    glance = Glance(study, bench.described, bench.camera)
    return Instruments(
        bench,
        frames,
        Stages(bench.axes, bench.described),
        accuracy,
        glance,
        study.description.exposure.level,
    )


@dataclass
class Course:
    """What the frames of a sweep are taken with so far: each configuration's exposure, s, and the
    last one found.
    """

    exposures: dict[int, float] = field(default_factory=dict[int, float])
    guess: float = FIRST_GUESS_S


def sweep(instruments: Instruments, steps: tuple[Step, ...], course: Course, tell: Tell) -> Plan:
    """Do steps in their order; what moves next moves while the last frame is read out, recorded and
    looked at.

    Args:
        instruments: of the study on the connected bench.
        steps: what to do; points recorded before are left out.
        course: exposures found before.
        tell: called when a step begins, and at the end.

    Raises:
        DeviceError: an instrument failed.
        MeasurementError: no exposure fits.
    """
    bench, frames, stages, accuracy = (
        instruments.bench,
        instruments.frames,
        instruments.stages,
        instruments.accuracy,
    )
    settings = bench.iris, bench.target
    asked = any(isinstance(step, CaptureUntil) for step in steps)
    white: int | None = None  # a configuration whose white frames are all taken
    expected, began = durations(steps, bench.described), [time.monotonic()]
    owed: Plan | None = None  # a frame whose light is in and that is not recorded yet

    def recorded() -> Plan:
        nonlocal owed
        if owed is not None:
            first, owed = owed, None
            yield from first

    def moved(*targets: Any) -> Plan:
        yield from bps.abs_set(*targets[:2], group="move")
        for device, value in zip(targets[2::2], targets[3::2], strict=True):
            yield from bps.abs_set(device, value, group="move")
        yield from recorded()
        if white is not None and asked:
            accuracy.seek_lattice(white)
        yield from bps.wait("move")

    def taken(shot: Shot) -> Plan:
        nonlocal owed
        yield from recorded()
        if shot.key not in frames.places:
            yield from shoot(frames, stages, shot, *settings)
            owed = close_event(frames)

    for done, step in enumerate(steps):
        instruments.glance.look_at(frames.arrived)
        bench.doing = f"step {done + 1} of {len(steps)}: {step}"
        left = seconds_left(steps, expected, [end - start for start, end in pairwise(began)])
        tell(
            Progress(
                done,
                len(steps),
                str(step),
                left,
                describe_last(instruments),
                instruments.glance.said,
            )
        )
        match step:
            case Home():
                yield from home(bench.axes, step)
                for name in step.axes:
                    stages.sent[name] = yield from bps.rd(bench.axes[name])
            case SetIris(f_number):
                yield from moved(bench.iris, f_number)
            case ShowTarget(kind):
                yield from moved(bench.target, kind)
            case Move(_, groups):
                for group in groups:
                    stages.sent |= group
                    yield from moved(
                        *(
                            item
                            for name, reading in group.items()
                            for item in (bench.axes[name], reading)
                        )
                    )
            case Expose(configuration):
                yield from recorded()
                yield from bps.trigger(stages.before, wait=True)
                course.guess = yield from expose(
                    frames, instruments.level, course.guess, step.key, configuration.index
                )
                course.exposures[configuration.index] = course.guess
                yield from open_event(stages, *settings)
                owed, white = close_event(frames), configuration.index
            case Capture(configuration, target, repeat):
                white = configuration.index if target == WHITE else None
                yield from taken(
                    Shot(
                        step.key, configuration.index, repeat, course.exposures[configuration.index]
                    )
                )
            case CaptureUntil():
                yield from _until(
                    step, course.exposures[step.configuration.index], accuracy, taken, recorded
                )
            case CaptureDark(repeats):
                for exposure in sorted(set(course.exposures.values())):
                    for repeat in range(repeats):
                        yield from taken(
                            Shot(step.key(exposure, repeat), NO_CONFIGURATION, repeat, exposure)
                        )
        began.append(time.monotonic())
    yield from recorded()
    instruments.glance.wait()
    tell(
        Progress(
            len(steps), len(steps), "done", 0.0, describe_last(instruments), instruments.glance.said
        )
    )


def _until(
    step: CaptureUntil,
    exposure_s: float,
    accuracy: Accuracy,
    taken: Callable[[Shot], Plan],
    recorded: Callable[[], Plan],
) -> Plan:
    """Take frames, look how sure they are, take as many more as that says; every look is
    recorded.
    """
    have = accuracy.seen(step)
    while (due := accuracy.due(step)) > have:
        for repeat in range(have, due):
            yield from taken(Shot(step.key(repeat), step.configuration.index, repeat, exposure_s))
        yield from recorded()
        have = due
        yield from bps.trigger(accuracy.look_at(step, have), wait=True)
        yield from bps.create("accuracy")
        yield from bps.read(accuracy)
        yield from bps.save()


def describe_last(instruments: Instruments) -> str:
    """The last frame that arrived in a few words, and how well its MTF is known where that was
    looked at.
    """
    if (last := instruments.frames.arrived) is None:
        return ""
    kind = last.shot.key.split("/")[0 if last.shot.configuration == NO_CONFIGURATION else 1]
    of = (
        ""
        if last.shot.configuration == NO_CONFIGURATION
        else f"configuration {last.shot.configuration}, "
    )
    said = f"{of}{kind}, frame {last.shot.repeat}: exposure {last.frame.exposure_s * 1e3:.3g} ms"
    said += f", {last.saturated} px saturated" if last.saturated else ""
    looks = instruments.accuracy.looks.get(last.shot.configuration)
    return said + (
        f", MTF known to {two_digits(looks[-1].uncertainty)} after {looks[-1].frames} frames"
        if looks
        else ""
    )
