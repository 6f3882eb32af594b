"""Rays of the slow reference, by the definitions alone: two thin lenses refract them, stops and
cards stop them, targets shine.

Every array of positions or slopes has shape (..., 2); a slope is the change of (x, y) per mm along
the axis.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.effects.distortion import Distortion
from flflab.image.scene import Plane
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Path:
    """What a ray meets on its way from the sensor through a microlens to the object side; mm. One
    microlens, or N.

    Attributes:
        centre: of the microlens, shape (2,) or (N, 2).
        focal_length: of the microlens, shape (1,) or (N, 1).
        gap: microlens to sensor, the same.
        depth: main lens to microlens, the same.
        main_focal_length: of the main lens.
    """

    centre: Array
    focal_length: Array
    gap: Array
    depth: Array
    main_focal_length: float

    def of(self, index: int) -> "Path":
        """The path through one of N microlenses."""
        return Path(
            self.centre[index],
            self.focal_length[index],
            self.gap[index],
            self.depth[index],
            self.main_focal_length,
        )

    def slopes_and_crossing(self, on_sensor: Array, on_lens: Array) -> tuple[Array, Array, Array]:
        """Slope between microlens and sensor, where the ray crosses the main lens, and its slope
        before that.
        """
        behind = (on_sensor - on_lens) / self.gap
        between = behind + (on_lens - self.centre) / self.focal_length
        crossing = on_lens - self.depth * between
        return behind, crossing, between + crossing / self.main_focal_length

    def on_main_lens(self, on_sensor: Array, on_lens: Array) -> Array:
        """Where the ray crosses the main lens."""
        return self.slopes_and_crossing(on_sensor, on_lens)[1]


@dataclass(frozen=True)
class Bundle:
    """All rays from one pixel through one microlens.

    Attributes:
        camera: whose stops and pixel they pass.
        path: through the microlens.
        place: of the pixel's centre, world mm.
        along: the unit vector u.
    """

    camera: Camera
    path: Path
    place: Array
    along: Array

    @property
    def crossing(self) -> Array:
        """Where the ray through the middles of pixel and microlens crosses the main lens."""
        return self.path.on_main_lens(self.place, self.path.centre)

    @property
    def by_sensor(self) -> float:
        """How far a ray moves on the main lens per mm that it moves on the sensor."""
        return float(
            (self.path.on_main_lens(self.place + self.along, self.path.centre) - self.crossing)
            @ self.along
        )

    @property
    def by_lens(self) -> float:
        """The same per mm that it moves on the microlens."""
        return float(
            (self.path.on_main_lens(self.place, self.path.centre + self.along) - self.crossing)
            @ self.along
        )

    @property
    def pupil(self) -> float:
        """Radius of the part of the microlens that lights a point if both stops are seen one behind
        the other, mm.
        """
        stop, radius = self.camera.main_lens.aperture / 2, self.camera.array.aperture / 2
        return radius if abs(self.by_lens) * radius <= stop else stop / abs(self.by_lens)


def landing(
    plane: Plane, distortion: Distortion | None, on_main: Array, slope: Array, moved: Array
) -> Array:
    """Where rays meet a target's plane, in the target's own coordinates: mm along the card, rad
    where it is at infinity.

    Args:
        plane: the target; it may be tilted.
        distortion: of the main lens; the ray from its crossing of the main lens heads for the
            distorted point at the plane's distance.
        on_main: where the rays cross the main lens.
        slope: their slopes before it.
        moved: how far the target has moved, world mm; without meaning at infinity.
    """
    coefficient = 0.0 if distortion is None else distortion.coefficient
    if math.isinf(plane.distance):
        return _rolled(-slope * (1 + coefficient * squared(slope)[..., None]), plane.roll)
    if coefficient:
        paraxial = on_main - plane.distance * slope
        slope = (
            on_main - paraxial * (1 + coefficient * squared(paraxial / plane.distance)[..., None])
        ) / plane.distance
    centre, tilt = np.asarray(plane.offset) + moved, np.asarray(plane.tilt)
    if not tilt.any():
        return _rolled(on_main - plane.distance * slope - centre, plane.roll)
    distance = (plane.distance + _along(on_main - centre, tilt)) / (1 + _along(slope, tilt))
    aside = on_main - distance[..., None] * slope - centre
    downhill = tilt / np.hypot(*tilt)
    aside = aside + (math.sqrt(1 + tilt @ tilt) - 1) * _along(aside, downhill)[..., None] * downhill
    return _rolled(aside, plane.roll)


def covers(plane: Plane, place: Array) -> npt.NDArray[np.bool_]:
    """Whether the opaque card of a plane is at places given in its own coordinates."""
    if plane.size is None:
        return np.ones(place.shape[:-1], dtype=bool)
    return (np.abs(place[..., 0]) <= plane.size[0] / 2) & (
        np.abs(place[..., 1]) <= plane.size[1] / 2
    )


def squared(vectors: Array) -> Array:
    """Squares of the lengths of vectors of shape (..., 2)."""
    return vectors[..., 0] ** 2 + vectors[..., 1] ** 2


def _rolled(place: Array, roll: float) -> Array:
    cos, sin = math.cos(roll), math.sin(roll)
    rolled = np.stack(
        [cos * place[..., 0] + sin * place[..., 1], cos * place[..., 1] - sin * place[..., 0]]
    )
    return np.moveaxis(rolled, 0, -1)


def _along(vectors: Array, direction: Array) -> Array:
    """How far vectors of shape (..., 2) go along a direction."""
    return vectors[..., 0] * direction[0] + vectors[..., 1] * direction[1]
