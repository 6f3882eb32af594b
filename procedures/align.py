"""Align the bench by white pictures: the array straight to the sensor's rows and parallel to the
sensor, then the sensor to its place.

Every picture tells roll, yaw and pitch at once; each axis is corrected by what was measured until
the measurement, or the stage, tells no more. Every correction is approached from one side, so that
backlash stays out of it. All moves go through the axes' own limits and interlocks.
"""

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from bluesky import Msg
from bluesky import plan_stubs as bps

from drivers.bench import ConnectedBench
from flflab.alignment import Attitude, Outcome
from flflab.bench import ANGLE, Bench, Moved
from flflab.digits import plus_minus
from flflab.errors import InputError, MeasurementError
from flflab.record import RECORD_SCHEMA, Recording, versions
from flflab.study import Configuration
from procedures.align_sensor import expected_sensor, place_sensor
from procedures.devices import Frames, Stages
from procedures.engine import perform
from procedures.home import home
from procedures.steps import WHITE, home_steps, homed_readings, move_step, unsure_when_homed
from procedures.white_pictures import Looking, Seen, Tell, approach, sensor_noise, straight

Plan = Generator[Msg, Any, Any]

MOST_PICTURES = 6  # an axis
DOUBLED = 1.75, 2.25  # what is left over what was there, of a correction the wrong way
MOVED: dict[str, Moved] = {"roll": "array.roll", "yaw": "array.yaw", "pitch": "array.pitch"}


@dataclass(frozen=True)
class Request:
    """What to align for.

    Attributes:
        f_number: of the iris while white pictures are taken.
        overlap: of neighbouring micro-images in mm (negative: a gap) that the sensor is moved to.
        exit_pupil: whether the sensor is moved into the exit pupil, where nothing is vignetted.
        level: share of full scale for the brightest view.
    """

    f_number: float
    overlap: float | None = None
    exit_pupil: bool = False
    level: float = 0.7

    @property
    def moves_sensor(self) -> bool:
        """Whether the sensor is to be placed."""
        return self.exit_pupil or self.overlap is not None


def align(
    bench: ConnectedBench, request: Request, recording: Recording, tell: Tell
) -> tuple[Outcome, ...]:
    """Home, take white pictures and move until everything stands as asked; recorded like any run.

    Args:
        bench: the connected bench.
        request: what to align for.
        recording: where pictures go, with room for ``most_frames``.
        tell: called with a sentence for each step and picture.

    Raises:
        RunInterruptedError: the operator asked for the end; every axis stands.
        LimitError: an axis would have to leave its limits.
        InterlockError: array and sensor would come too near to each other.
        MeasurementError: no exposure fits, no lattice is seen, or an axis turns the other way than
            its sign says.
        DeviceError: an instrument failed; every axis was told to stop.
    """
    outcomes: list[Outcome] = []

    def plan(tell: Tell) -> Plan:
        frames, stages = Frames(bench.camera, recording), Stages(bench.axes, bench.described)
        return _plan(
            Looking(bench, frames, stages, request.f_number, request.level, tell), request, outcomes
        )

    metadata = {
        "record_schema": RECORD_SCHEMA, "plan_name": "align", "axes": list(bench.axes),
        "f_number": request.f_number,
        "overlap_mm": request.overlap,
        "exit_pupil": request.exit_pupil, "devices": [row._asdict() for row in bench.identities()],
        "sensor_noise": vars(sensor_noise(bench)),
        "seed": bench.described.description.simulated.seed, "software": versions(),
    }  # fmt: skip
    perform(plan(tell), plan(lambda _: None), metadata, bench, recording)
    return tuple(outcomes)


def most_frames(request: Request) -> int:
    """How many frames are recorded at most."""
    return MOST_PICTURES * (1 + request.moves_sensor)


def _plan(looking: Looking, request: Request, outcomes: list[Outcome]) -> Plan:
    bench, described = looking.bench, looking.bench.described
    for step in home_steps(described):
        looking.tell(str(step))
        yield from home(bench.axes, step)
    yield from bps.mv(bench.iris, request.f_number)
    yield from bps.mv(bench.target, WHITE)
    start = move_step(
        _start(request, described),
        described,
        homed_readings(described),
        unsure_when_homed(described),
    )
    for group in start.groups:
        for name, reading in group.items():
            yield from approach(described, bench.axes[name], reading)
    last = yield from _straighten(looking, outcomes)
    if last is not None and request.moves_sensor:
        outcomes.append((yield from place_sensor(looking, last, request.overlap)))


def _straighten(looking: Looking, outcomes: list[Outcome]) -> Plan:
    """Correct roll, yaw and pitch; returns what the last picture showed, None in a rehearsal."""
    axes = {angle: looking.bench.axis_of(moved) for angle, moved in MOVED.items()}
    why: dict[str, str] = {
        angle: "no axis turns it; measured only" for angle, axis in axes.items() if axis is None
    }
    attitudes: list[Attitude] = []
    pictures: dict[str, int] = dict.fromkeys(MOVED, 1)
    last: Seen | None = None
    while last is None or len(why) < len(MOVED):
        last = yield from looking.look()
        if last is None:
            return None
        attitudes.append(last.attitude)
        looking.tell(
            f"picture {looking.pictures}: "
            + ", ".join(_shown(angle, *values) for angle, values in last.attitude.angles.items())
        )
        for angle, axis in axes.items():
            if angle in why or axis is None:
                continue
            pictures[angle] = len(attitudes)
            deviations, doubt = (
                [one.angles[angle][0] for one in attitudes],
                last.attitude.angles[angle][1],
            )
            require_corrected(angle, axis.name, deviations, doubt + axis.resolution)
            if reason := why_stop(deviations, doubt, axis.resolution):
                why[angle] = reason
                continue
            sign = looking.bench.described.description.axes[axis.name].sign
            yield from approach(
                looking.bench.described, axis, axis.position() - sign * deviations[-1]
            )
    for angle, axis in axes.items():
        (before, _), (after, doubt) = attitudes[0].angles[angle], attitudes[-1].angles[angle]
        name, reading = ("", 0.0) if axis is None else (axis.name, axis.position())
        outcomes.append(
            Outcome(angle, name, before, after, doubt, reading, pictures[angle], why[angle])
        )
    return last


def why_stop(deviations: list[float], doubt: float, resolution: float) -> str:
    """Why there is nothing more to correct, empty where there is.

    Args:
        deviations: measured so far, one a picture.
        doubt: standard uncertainty of the last.
        resolution: how near to where it is sent the stage comes to rest.
    """
    now = abs(deviations[-1])
    if now <= 2 * doubt:
        return "within twice the measurement's uncertainty"
    if now <= resolution / 2:
        return "the stage makes no smaller step"
    if len(deviations) > 2 and max(now, abs(deviations[-2])) <= 2 * doubt + resolution:
        return "the stage comes to rest no nearer"
    if len(deviations) >= MOST_PICTURES:
        return f"{MOST_PICTURES} pictures were taken"
    return ""


def require_corrected(angle: str, name: str, deviations: list[float], doubt: float) -> None:
    """Refuse to go on with an axis that turns the other way: what it is to take away it doubles
    with every picture.

    Args:
        angle: what it turns.
        name: of the axis.
        deviations: measured so far, rad, one a picture.
        doubt: how far a correction may miss, rad.

    Raises:
        MeasurementError: the last correction doubled what it was to take away.
    """
    before, now = deviations[-2:] if len(deviations) > 1 else (0.0, 0.0)
    if abs(before) > 4 * doubt and DOUBLED[0] < now / before < DOUBLED[1]:
        show = ANGLE.show
        raise MeasurementError(
            f"{name}: a correction of the array's {angle} of {show(before, '+.4f')} made it"
            f" {show(now, '+.4f')}; the axis turns the other way than `sign` of the bench file"
            " says, or the camera turns or mirrors its pictures: correct that (with `sign`"
            " `home_towards`), then align again"
        )


def _start(request: Request, bench: Bench) -> Configuration:
    """Everything where the camera file has it; the target, of which nothing is to be seen but
    white, where it stands after homing.
    """
    optics, found = bench.optics, bench.description.axis_of("target.z")
    distance = 0.0 if found is None else -found[1].world(homed_readings(bench)[found[0]])
    return Configuration(
        0, request.f_number, distance, optics.array.distance, optics.sensor.distance
    )


def require_reachable(request: Request, bench: Bench) -> None:
    """Refuse before anything connects or moves what the description already says is out of reach.

    Raises:
        InputError: the wanted overlap is nowhere or as wide as the pitch, or an element would have
            to be moved that no axis moves.
        LimitError: an axis would have to leave its limits.
        InterlockError: array and sensor would come too near to each other.
    """
    pitch = min(bench.optics.array.pitch)
    if request.overlap is not None and not abs(request.overlap) < pitch:
        raise InputError(
            f"align: an overlap of {request.overlap:g} mm is impossible; microlenses {pitch:g} mm"
            f" apart allow one between {-pitch:g} and {pitch:g} mm, with more a micro-image reaches"
            " its neighbours' neighbours; give such a one"
        )
    start, now = _start(request, bench), homed_readings(bench)
    for group in move_step(start, bench, now).groups:
        now.update(group)
    if request.moves_sensor:
        goal = expected_sensor(straight(bench.optics, request.f_number), request.overlap)
        move_step(replace(start, sensor=goal), bench, now)


def _shown(angle: str, value: float, doubt: float) -> str:
    shown = plus_minus(float(np.degrees(value)), float(np.degrees(doubt)), "+")
    return f"{angle} ({shown}) deg"
