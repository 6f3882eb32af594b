"""Where rays end on a target that may be tilted, rolled and seen through a lens with distortion:
exactly, and linearised.

A ray is a pupil point t and a sensor point e (mm from the micro-image's centre). It crosses the
main lens at m = m_t t + m_e e and, without distortion, heads for the direction a = a_t t + a_e e +
a_0 as seen from the main lens (the object point over its distance D). With distortion it heads for
h(a) = a (1 + k |a|^2) instead: its slope is s = m/D - h(a), and it meets the plane that lies at D
on the axis and has the slopes g round c at the distance Z = (D + g . (m - c)) / (1 + g . s), in the
point m - Z s. On the card lengths along the slope are sqrt(1 + |g|^2) times as long, and the roll
turns its axes. At infinity the coordinates are angles, h(a).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.effects.distortion import Distortion
from flflab.image.microlenses import Lenses
from flflab.image.scene import Plane

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Landing:
    """Where rays end round a sensor point of each of N microlenses: at origin + by_pupil t +
    by_sensor e in the target's own axes.

    Attributes:
        origin: mm on the target (rad where it is at infinity), shape (N, 2).
        by_pupil: the same per unit of pupil, shape (N, 2, 2).
        by_sensor: the same per mm on the sensor, shape (N, 2, 2).
        by_motion: the same per mm that the target moves across the axis, along the world's axes,
            shape (N, 2, 2); 0 at infinity.
    """

    origin: Array
    by_pupil: Array
    by_sensor: Array
    by_motion: Array

    def at(self, pupil: Array, sensor: Array) -> Array:
        """Ends of the rays of pupil and sensor points, each of shape (N, S, 2)."""
        return (
            self.origin[:, None]
            + pupil @ self.by_pupil.swapaxes(1, 2)
            + sensor @ self.by_sensor.swapaxes(1, 2)
        )

    def error(self, places: Array, truth: Array, pixel: float) -> Array:
        """Largest change of a sharp edge's picture, of white, when rays end at places instead of
        where they do; (N, S, 2) to (N,).

        A step is no steeper on the sensor than the pixel and the blur let it be.
        """
        pixel_side = pixel * np.abs(self.by_sensor).max(axis=(1, 2))
        blur_slope = math.pi / 2 * np.abs(self.by_pupil).max(axis=(1, 2))
        return np.hypot(*np.moveaxis(places - truth, -1, 0)).max(axis=1) / np.maximum(
            np.maximum(pixel_side, blur_slope), 1e-300
        )


def own_axes(plane: Plane) -> Array:
    """What turns a place on the plane, seen along the axis from the target's centre, into the
    target's own coordinates; (2, 2).
    """
    cos, sin = math.cos(plane.roll), math.sin(plane.roll)
    steepness = math.hypot(*plane.tilt)
    downhill = np.array(plane.tilt) / steepness if steepness else np.zeros(2)
    return np.array([[cos, sin], [-sin, cos]]) @ (
        np.eye(2) + (math.hypot(1.0, steepness) - 1) * np.outer(downhill, downhill)
    )


def land(
    lenses: Lenses, plane: Plane, distortion: Distortion | None, pupil: Array, sensor: Array
) -> Array:
    """Where rays end, exactly, in the target's own axes.

    Args:
        lenses: N microlenses, made for the plane's distance.
        plane: the target.
        distortion: of the main lens.
        pupil: pupil points, shape (N, S, 2) or one that broadcasts to it.
        sensor: sensor points from the micro-images' centres, mm, the same.

    Raises:
        InputError: the distortion folds the field over, or the tilted plane reaches the main lens.
    """
    crossing, direction = _ray(lenses, pupil, sensor)
    return _end(plane, distortion, crossing, direction)[0]


def linearised(
    lenses: Lenses, plane: Plane, distortion: Distortion | None, sensor: Array
) -> Landing:
    """The map round the pupil's centre and one sensor point of each microlens, shape (N, 2);
    raises as ``land``.
    """
    crossing, direction = _ray(lenses, np.zeros((1, 1, 2)), sensor[:, None])
    place, depth, slope, stretch = _end(plane, distortion, crossing, direction)
    vergence, axes = 1 / plane.distance, own_axes(plane)
    along, across = np.asarray(plane.tilt), slope[:, 0]

    def derivative(of_crossing: Array, of_direction: Array) -> Array:
        if vergence == 0:
            return axes @ (of_direction[:, None, None] * stretch)
        at_depth = ((1 - depth * vergence) * of_crossing)[:, None, None] * np.eye(2) + (
            depth * of_direction
        )[:, None, None] * stretch
        lean = (along @ at_depth) / (1 + across @ along)[:, None]
        return axes @ (at_depth - across[:, :, None] * lean[:, None, :])

    by_sensor = derivative(lenses["lens_scale"], lenses["scale"])
    nearer = (
        across[:, :, None] * along / (1 + across @ along)[:, None, None]
    )  # a tilted plane that moves aside moves along the rays too
    return Landing(
        origin=place[:, 0] - (by_sensor @ sensor[:, :, None])[:, :, 0],
        by_pupil=derivative(lenses["lens_spread"], lenses["spread"]),
        by_sensor=by_sensor,
        by_motion=axes @ (nearer - np.eye(2)) if vergence else np.zeros_like(by_sensor),
    )


def _ray(lenses: Lenses, pupil: Array, sensor: Array) -> tuple[Array, Array]:
    """Crossing of the main lens and paraxial direction, shape (N, S, 2)."""

    def column(of_entry: Array) -> Array:
        return of_entry[:, None, None]

    aimed = np.stack([lenses["direction_x"], lenses["direction_y"]], axis=1)[:, None]
    return (
        column(lenses["lens_spread"]) * pupil + column(lenses["lens_scale"]) * sensor,
        column(lenses["spread"]) * pupil + column(lenses["scale"]) * sensor + aimed,
    )


def _end(
    plane: Plane, distortion: Distortion | None, crossing: Array, direction: Array
) -> tuple[Array, Array, Array, Array]:
    """Ends of rays in own coordinates (N, S, 2); of the first ray of each microlens the depth (N,);
    slopes (N, S, 2); dh/da (N, 2, 2).
    """
    coefficient = 0.0 if distortion is None else distortion.coefficient
    squared = np.sum(direction**2, axis=-1, keepdims=True)
    if float((1 + 3 * coefficient * squared).min(initial=1.0)) <= 0:
        steepest = math.sqrt(float(squared.max()))
        raise InputError(
            f"render: a distortion of {coefficient:g} 1/rad^2 folds the picture over at the"
            f" {steepest:.3g} rad that the sensor sees; above {-1 / (3 * steepest**2):.3g} 1/rad^2"
            " is allowed"
        )
    headed = direction * (1 + coefficient * squared)
    first = direction[:, 0]
    stretch = (1 + coefficient * squared[:, 0])[:, :, None] * np.eye(2) + 2 * coefficient * first[
        :, :, None
    ] * first[:, None, :]
    vergence, axes = 1 / plane.distance, own_axes(plane)
    slope = vergence * crossing - headed
    if vergence == 0:
        return headed @ axes.T, np.full(len(first), math.inf), slope, stretch
    tilt, centre = np.asarray(plane.tilt), np.asarray(plane.offset)
    if not tilt.any():
        return (
            (plane.distance * headed - centre) @ axes.T,
            np.full(len(first), plane.distance),
            slope,
            stretch,
        )
    depth = (plane.distance + (crossing - centre) @ tilt) / (1 + slope @ tilt)
    if float(depth.min(initial=math.inf)) <= 0 or float((1 + slope @ tilt).min(initial=1.0)) <= 0:
        raise InputError(
            f"render: the target at {plane.distance:g} mm with the tilt {plane.tilt} reaches the"
            " main lens within what the sensor sees; a smaller tilt or offset is due"
        )
    return (crossing - depth[..., None] * slope - centre) @ axes.T, depth[:, 0], slope, stretch
