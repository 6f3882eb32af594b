"""White pictures on the way of a closed loop: exposed, recorded, measured; and how an axis arrives
without backlash.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Any

from bluesky import Msg
from bluesky import plan_stubs as bps

from drivers.base import Axis
from drivers.bench import ConnectedBench
from flflab.alignment import Attitude, attitude_of
from flflab.bench import Bench
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from procedures.capture import FIRST_GUESS_S, expose, keep
from procedures.devices import Frames, Stages
from procedures.steps import WHITE

Plan = Generator[Msg, Any, Any]
Tell = Callable[[str], None]

RUN_UP = {"mm": 0.05, "rad": 0.01}  # more than any backlash here


@dataclass(frozen=True)
class Seen:
    """The camera where the stages said it stood, and of a white picture the lattice and how the
    array is turned.
    """

    camera: Camera
    lattice: Lattice
    attitude: Attitude


@dataclass
class Looking:
    """A connected bench that takes white pictures, recorded one after the other.

    Attributes:
        bench: the bench.
        frames: its camera, recording.
        stages: its axes.
        f_number: at which the iris stands.
        level: share of full scale for the brightest view.
        tell: called with a sentence for each step and picture.
        pictures: recorded so far.
        exposure_s: of the last one.
    """

    bench: ConnectedBench
    frames: Frames
    stages: Stages
    f_number: float
    level: float
    tell: Tell
    pictures: int = 0
    exposure_s: float = FIRST_GUESS_S

    def look(self) -> Plan:
        """Take, record and measure a picture; returns what was ``Seen``, None in a rehearsal."""
        yield from bps.trigger(self.stages.before, wait=True)
        self.exposure_s = yield from expose(
            self.frames, self.level, self.exposure_s, f"align/{WHITE}/{self.pictures}", 0
        )
        if self.frames.latest is None:
            return None
        yield from keep(self.frames, self.stages, self.bench.iris, self.bench.target)
        self.pictures += 1
        picture, camera, noise = self.frames.latest.picture, self.camera, sensor_noise(self.bench)
        lattice = lattice_behind(camera, picture, noise)
        return Seen(camera, lattice, attitude_of(lattice))

    @property
    def camera(self) -> Camera:
        """The nominal camera, its array straight, the sensor where its stage says that it
        stands.
        """
        optics = straight(self.bench.described.optics, self.f_number)
        if self.bench.axis_of("sensor.z") is None:
            return optics
        return replace(optics, sensor=replace(optics.sensor, distance=self.bench.world("sensor.z")))


def straight(optics: Camera, f_number: float) -> Camera:
    """A camera at an f-number, its array neither rolled nor tilted."""
    lens, array = (
        replace(optics.main_lens, f_number=f_number),
        replace(optics.array, roll=0.0, tilt=(0.0, 0.0)),
    )
    return replace(optics, main_lens=lens, array=array)


def sensor_noise(bench: ConnectedBench) -> SensorNoise:
    """What the camera says of its noise."""
    camera = bench.camera
    return SensorNoise(
        camera.dn_per_electron, camera.read_noise_dn, camera.offset_dn, float(camera.full_scale)
    )


def approach(bench: Bench, axis: Axis, reading: float) -> Plan:
    """Go to a reading, the last stretch always in the same direction.

    Array and sensor arrive towards each other, so that no run-up narrows the gap; other axes arrive
    upwards in readings.
    """
    described = bench.description.axes[axis.name]
    side = {"sensor.z": -described.sign, "array.z": described.sign}.get(described.moves, 1)
    run_up = RUN_UP[axis.coordinate.unit]
    if (
        not axis.is_homed() or side * (reading - axis.position()) < run_up
    ):  # in the rehearsal no axis has a reference yet
        yield from bps.mv(axis, reading - side * run_up)
    yield from bps.mv(axis, reading)
