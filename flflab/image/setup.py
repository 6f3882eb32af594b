"""What is to be formed of one flat target: the pupils, and where on the target every ray through them ends."""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.image.pupil import Pupils, camera_pupils
from flflab.image.rim import Rims, find_rims
from flflab.image.scene import ALL, Plane, Scene
from flflab.optics.camera import Camera, Sensor

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Setup:
    """A camera before one target, as a list of entries: each is a microlens, or a part of its micro-image.

    Within an entry the ray from the sensor point e (mm from the micro-image's centre) through the pupil point t ends on the target,
    in the target's own axes, at origin + by_pupil t + by_sensor e.

    Attributes:
        sensor: the sensor.
        pupils: the sensor side of every entry; N entries.
        origin: mm on the target (rad where it is at infinity), shape (N, 2).
        by_pupil: the same per unit of pupil, shape (N, 2, 2).
        by_sensor: the same per mm on the sensor, shape (N, 2, 2).
        window: the part of the sensor an entry may light: first column, column after the last, first row, row after the last; (N, 4).
        rims: the kinds of rims of the micro-images.
        blur: diameter on the sensor of the blur of a point, pixels, shape (N,).
        tolerance: largest error asked for.
        overlap: how many micro-images reach a sensor point, at least 1; the errors of their strips add up.
        pixel_width: side of the square over which a pixel gathers light, mm; 0 for its centre alone.
        falloff: whether rays count by cos^4 of their slopes at the sensor.
    """

    sensor: Sensor
    pupils: Pupils
    origin: Array
    by_pupil: Array
    by_sensor: Array
    window: Whole
    rims: Rims
    blur: Array
    tolerance: float
    overlap: float
    pixel_width: float
    falloff: bool = False

    def seen_from(self, x: float, y: float) -> "Setup":
        """The same with the target's coordinates counted from (x, y)."""
        return replace(self, origin=self.origin - np.array([x, y]))

    def kind_blur(self, largest: bool) -> Array:
        """The largest or smallest blur among the entries of each kind of rim, pixels."""
        choose = np.max if largest else np.min
        return np.array([choose(self.blur[self.rims.kind == kind]) for kind in range(len(self.rims.width))])


def make_setup(scene: Scene, plane: Plane, tolerance: float, effects: frozenset[str] = ALL) -> Setup:
    """Set up a scene's camera before one of its planes."""
    camera, pixel = scene.camera, scene.camera.sensor.pixel
    vergence = 1 / plane.distance
    unit = plane.distance if vergence > 0 else 1.0
    pupils = camera_pupils(camera, vergence)
    slope = np.where(np.abs(pupils.slope) < 1e-6 * pixel, 0.0, pupils.slope)
    spread = pupils.spread if "defocus" in effects else np.zeros_like(slope)
    pupils = replace(pupils, slope=slope if "vignetting" in effects else np.zeros_like(slope), spread=spread)
    with np.errstate(divide="ignore", invalid="ignore"):
        blur = np.where(pupils.spread == 0, 0.0, 2 * np.abs(pupils.spread / pupils.scale) / pixel)
    columns, rows = camera.sensor.resolution
    cos, sin = math.cos(plane.roll), math.sin(plane.roll)
    turned = np.array([[cos, sin], [-sin, cos]])
    origin = unit * np.stack([pupils.direction_x, pupils.direction_y], axis=1)
    return Setup(
        sensor=camera.sensor,
        pupils=pupils,
        origin=(origin - np.array(plane.offset if vergence > 0 else (0.0, 0.0))) @ turned.T,
        by_pupil=unit * pupils.spread[:, None, None] * turned,
        by_sensor=unit * pupils.scale[:, None, None] * turned,
        window=np.tile(np.array([0, columns, 0, rows], dtype=np.int64), (len(pupils.slope), 1)),
        rims=find_rims(pupils, pixel),
        blur=blur,
        tolerance=tolerance,
        overlap=max(1.0, _coverage(camera, pupils)),
        pixel_width=pixel if "pixel" in effects else 0.0,
        falloff=scene.falloff is not None,
    )


def _coverage(camera: Camera, pupils: Pupils) -> float:
    """How many micro-images reach a sensor point on average."""
    row = math.sqrt(3) / 2 if camera.array.layout == "hexagonal" else 1.0
    cell = camera.array.pitch[0] * camera.array.pitch[1] * row * (camera.sensor.distance / camera.array.distance) ** 2
    return math.pi * float(np.max(pupils.outside)) ** 2 / cell
