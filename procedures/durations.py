"""How long steps take: from the stages' speeds, the exposures, and the habits of cameras, iris
wheels and people.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from flflab.bench import Bench, DeviceDescription
from flflab.image.sensor.exposure import white_irradiance
from flflab.optics.camera import Camera
from procedures.capture import FIRST_GUESS_S, MOST_TRIALS, better_exposure, fits, quantise
from procedures.steps import (
    Capture,
    CaptureDark,
    CaptureUntil,
    Expose,
    Home,
    Move,
    Readings,
    SetIris,
    ShowTarget,
    Step,
    homed_readings,
)  # fmt: skip

BY_HAND_S = 30.0  # a person turns an iris or swaps a target
F_NUMBERS_PER_S = 8.0
PLACES_PER_S = 2.0  # of a wheel of targets
START_S = 0.5  # the process that watches over the axes starts before the first motion
SETTLE_S = 0.05  # a motor speeds up and slows down, and is asked whether it rests
READOUT_S = 0.05
HANDLING_S = (
    0.03,
    0.012,
)  # of a frame, and of each of its megapixels: over the wire, checksum, disk
ANALYSIS_S = (0.3, 0.3)  # of a look at the accuracy reached, and of each megapixel
UNEXPECTED_S = 3.0  # by which a first frame may be late without the estimate being withheld
MOTIONS = (Home, SetIris, ShowTarget, Move)
WHEEL = ("four-dot", "bars", "white", "black", "chirp", "edge", "texture", "bars-y")


@dataclass(frozen=True)
class Expected:
    """What is expected of the frames: exposures by configuration, s, and how many an accuracy takes
    where one is asked for.
    """

    exposures: Mapping[int, float] = field(default_factory=dict[int, float])
    frames: Mapping[int, int] = field(default_factory=dict[int, int])


def left_at(bench: Bench) -> dict[str, float]:
    """Readings where the bench is expected to stand before: everything where the camera file has
    it, else in the middle of its limits.
    """
    optics = bench.optics
    worlds = {
        "main_lens.z": 0.0, "array.z": optics.array.distance, "sensor.z": optics.sensor.distance,
        "array.pitch": math.atan(optics.array.tilt[1]),
        "array.yaw": math.atan(optics.array.tilt[0]), "array.roll": optics.array.roll,
    }  # fmt: skip
    found: dict[str, float] = {}
    for name, axis in bench.description.axes.items():
        low, high = axis.limits
        reading = axis.reading(worlds[axis.moves]) if axis.moves in worlds else math.nan
        found[name] = reading if low <= reading <= high else (low + high) / 2
    return found


def durations(
    steps: tuple[Step, ...],
    bench: Bench,
    expected: Expected | None = None,
    start: Readings | None = None,
    rate: float = 1.0,
) -> tuple[float, ...]:
    """How long each step takes, s.

    Args:
        steps: in their order.
        bench: on what.
        expected: of the frames; without, exposures are guessed from the bench file's light.
        start: where every axis stands before, readings; by default where ``left_at`` expects it.
        rate: how many times faster than real the stages and the camera run, as those of a simulated
            bench.
    """
    return tuple(
        _Timing(bench, expected or Expected(), dict(start or left_at(bench)), rate).of(steps)
    )


def seconds_left(steps: tuple[Step, ...], expected: tuple[float, ...], spent: list[float]) -> float:
    """How long the steps that are not done yet take, s: what is expected, and what others took more
    or less so far.

    Motions and frames are kept apart: a camera that takes long over its frames does not slow the
    stages. The first of either does not count, since it pays for a start (a kernel compiled, a
    camera woken); nan while that is all there is and it took much longer than expected.

    Args:
        steps: all of them.
        expected: of each.
        spent: on each of the first ones, which are done.
    """
    more = dict.fromkeys((True, False), 0.0)
    for moves in more:
        timed = [
            (took - due, due)
            for step, due, took in zip(steps, expected, spent, strict=False)
            if isinstance(step, MOTIONS) == moves
        ]
        if len(timed) > 1:
            more[moves] = sum(excess for excess, _ in timed[1:]) / (len(timed) - 1)
        elif timed and not moves and timed[0][0] > UNEXPECTED_S + 2 * timed[0][1]:
            return math.nan
    ahead = zip(steps[len(spent) :], expected[len(spent) :], strict=True)
    return sum(max(0.0, due + more[isinstance(step, MOTIONS)]) for step, due in ahead)


class _Timing:
    """Time as it goes by while steps are done; what a frame still needs after its light is in goes
    on while things move.
    """

    def __init__(
        self, bench: Bench, expected: Expected, now: dict[str, float], rate: float
    ) -> None:
        self._bench, self._expected, self._now, self._rate = bench, expected, now, rate
        columns, rows = bench.optics.sensor.resolution
        megapixels = columns * rows / 1e6
        self._handling = HANDLING_S[0] + HANDLING_S[1] * megapixels
        self._analysis = ANALYSIS_S[0] + ANALYSIS_S[1] * megapixels
        self._f_number, self._target = bench.optics.main_lens.f_number, "white"
        self._guess, self._exposures, self._owed, self._start = (
            FIRST_GUESS_S,
            dict[int, float](),
            0.0,
            START_S,
        )

    def of(self, steps: tuple[Step, ...]) -> list[float]:
        return [self._takes(step) for step in steps]

    def _takes(self, step: Step) -> float:
        match step:
            case Home(axes):
                ends = homed_readings(self._bench)
                longest = max(self._motion(name, ends[name]) for name in axes)
                start, self._start = self._start, 0.0
                return start + self._moving(longest)
            case SetIris(f_number):
                change = (
                    BY_HAND_S * self._rate
                    if self._bench.description.iris.driver == "manual"
                    else abs(f_number - self._f_number) / F_NUMBERS_PER_S
                )
                self._f_number = f_number
                return self._moving(change)
            case ShowTarget(kind):
                change, self._target = (
                    abs(WHEEL.index(kind) - WHEEL.index(self._target)) / PLACES_PER_S,
                    kind,
                )
                return self._moving(self._by_hand(self._bench.description.target, change))
            case Move(_, groups):
                return sum(
                    self._moving(
                        max(self._motion(name, reading) for name, reading in group.items())
                    )
                    for group in groups
                )
            case Expose(configuration):
                exposure = self._exposure(
                    configuration.index, configuration.camera(self._bench.optics)
                )
                trials = self._trials(exposure)
                self._exposures[configuration.index] = exposure
                return self._frames(trials)
            case Capture(configuration):
                return self._frames([self._exposures.get(configuration.index, FIRST_GUESS_S)])
            case CaptureUntil(configuration):
                count = self._expected.frames.get(configuration.index, step.least)
                looks = 1 if count == step.least else 2
                taken = self._frames(
                    [self._exposures.get(configuration.index, FIRST_GUESS_S)] * count
                )
                return taken + self._flush() + looks * self._analysis
            case CaptureDark(frames):
                return (
                    self._frames(
                        [
                            exposure
                            for exposure in sorted(set(self._exposures.values()))
                            for _ in range(frames)
                        ]
                    )
                    + self._flush()
                )

    def _by_hand(self, device: DeviceDescription, otherwise: float) -> float:
        return (
            BY_HAND_S * self._rate if device.driver == "manual" else otherwise
        )  # a person is no faster on a simulated bench

    def _motion(self, name: str, reading: float) -> float:
        way = abs(reading - self._now[name])
        self._now[name] = reading
        return way / self._bench.description.axes[name].speed

    def _moving(self, seconds: float) -> float:
        """A motion of so many seconds on the real bench, during which the last frame is read out
        and recorded.
        """
        lasting = max(seconds / self._rate + SETTLE_S, self._owed)
        self._owed = 0.0
        return lasting

    def _frames(self, exposures: list[float]) -> float:
        total = 0.0
        for exposure in exposures:
            total += self._flush() + exposure / self._rate
            self._owed = READOUT_S / self._rate + self._handling
        return total

    def _flush(self) -> float:
        owed, self._owed = self._owed, 0.0
        return owed

    def _exposure(self, index: int, camera: Camera) -> float:
        if index in self._expected.exposures:
            return quantise(self._expected.exposures[index])
        sensor = self._bench.description.simulated
        light = white_irradiance(camera) / white_irradiance(self._bench.optics)
        return quantise(0.7 * sensor.full_well_electrons / (sensor.electrons_per_second * light))

    def _trials(self, exposure: float) -> list[float]:
        """The exposures that the rule tries until it fits."""
        tried = [quantise(self._guess)]
        while not fits(tried[-1], exposure) and len(tried) < MOST_TRIALS:
            tried.append(better_exposure(tried[-1], min(0.7 * tried[-1] / exposure, 1.0), 0.7))
        self._guess = tried[-1]
        return tried
