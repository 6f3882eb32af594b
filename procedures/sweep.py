"""Do the steps of a study one after the other: home, turn the iris, show the target, move, expose, take frames."""

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from bluesky import Msg
from bluesky import plan_stubs as bps

from drivers.bench import ConnectedBench
from procedures.capture import FIRST_GUESS_S, expose, keep, take
from procedures.devices import NO_CONFIGURATION, Frames, Shot, Stages
from procedures.home import home
from procedures.steps import Capture, CaptureDark, Expose, Home, Move, SetIris, ShowTarget, Step, durations

Plan = Generator[Msg, Any, Any]


@dataclass(frozen=True)
class Progress:
    """How far a procedure has come: steps done, of how many, what begins now, s left as far as known, the last frame in words."""

    done: int
    total: int
    step: str
    seconds_left: float
    last: str


Tell = Callable[[Progress], None]


def sweep(bench: ConnectedBench, frames: Frames, stages: Stages, steps: tuple[Step, ...], level: float, tell: Tell) -> Plan:
    """Do steps in their order.

    Args:
        bench: the connected bench.
        frames: its camera, recording.
        stages: its axes.
        steps: what to do.
        level: share of full scale for the brightest view.
        tell: called when a step begins, and at the end.

    Raises:
        DeviceError: an instrument failed.
        MeasurementError: no exposure fits.
    """
    exposures: dict[int, float] = {}
    guess = FIRST_GUESS_S
    devices = (frames, stages, bench.iris, bench.target)
    expected, began = durations(steps, bench.described), time.monotonic()
    for done, step in enumerate(steps):
        tell(Progress(done, len(steps), str(step), _left(expected, done, time.monotonic() - began), describe_last(frames)))
        match step:
            case Home():
                yield from home(bench.axes, step)
            case SetIris(f_number):
                yield from bps.mv(bench.iris, f_number)
            case ShowTarget(kind):
                yield from bps.mv(bench.target, kind)
            case Move(_, groups):
                for group in groups:
                    yield from bps.mv(*(item for name, mm in group.items() for item in (bench.axes[name], mm)))
            case Expose(configuration):
                guess = yield from expose(frames, level, guess, step.key, configuration.index)
                exposures[configuration.index] = guess
                yield from keep(*devices)
            case Capture(configuration, _, repeat):
                yield from take(frames, Shot(step.key, configuration.index, repeat, exposures[configuration.index]))
                yield from keep(*devices)
            case CaptureDark(repeats):
                for exposure in sorted(set(exposures.values())):
                    for repeat in range(repeats):
                        yield from take(frames, Shot(f"dark/{exposure:.6g}s/{repeat}", NO_CONFIGURATION, repeat, exposure))
                        yield from keep(*devices)
    tell(Progress(len(steps), len(steps), "done", 0.0, describe_last(frames)))


def describe_last(frames: Frames) -> str:
    """The last frame in a few words."""
    shot, frame = frames.shot, frames.latest
    return f"{shot.key}: {frame.exposure_s * 1e3:.3g} ms" if shot and frame else ""


def _left(expected: tuple[float, ...], done: int, elapsed: float) -> float:
    """Seconds left: what was expected, corrected by how the steps so far went."""
    before, after = sum(expected[:done]), sum(expected[done:])
    return after * (elapsed / before if before > 0 else 1.0)
