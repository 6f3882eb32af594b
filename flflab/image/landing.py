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
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.effects.distortion import Distortion
from flflab.image.microlenses import Lenses
from flflab.image.scene import Plane

Array = npt.NDArray[np.float64]

OF_PUPIL, ON_SENSOR = 1e-2, 1e-3  # steps of differences: of the pupil's radius, mm


@dataclass(frozen=True)
class Landing:
    """Where rays of N microlenses end in the target's own axes: origin + by_pupil t + by_sensor e.

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

    def column(name: str) -> Array:
        return lenses[name][:, None, None]

    aimed = np.stack([lenses["direction_x"], lenses["direction_y"]], axis=1)[:, None]
    crossing = column("lens_spread") * pupil + column("lens_scale") * sensor
    direction = column("spread") * pupil + column("scale") * sensor + aimed
    coefficient = 0.0 if distortion is None else distortion.coefficient
    squared = np.sum(direction**2, axis=-1, keepdims=True)
    if float((1 + 3 * coefficient * squared).min(initial=1.0)) <= 0:
        steepest = math.sqrt(float(squared.max()))
        raise InputError(
            f"render: a distortion of {coefficient:g} 1/rad^2 folds the picture over at the"
            f" {steepest:.3g} rad that the sensor sees; above {-1 / (3 * steepest**2):.3g} 1/rad^2"
            " is allowed"
        )
    headed, axes = direction * (1 + coefficient * squared), own_axes(plane)
    if math.isinf(plane.distance):
        return headed @ axes.T
    tilt, centre = np.asarray(plane.tilt), np.asarray(plane.offset)
    if not tilt.any():
        return (plane.distance * headed - centre) @ axes.T
    slope = crossing / plane.distance - headed
    depth = (plane.distance + (crossing - centre) @ tilt) / (1 + slope @ tilt)
    if float(depth.min(initial=math.inf)) <= 0 or float((1 + slope @ tilt).min(initial=1.0)) <= 0:
        raise InputError(
            f"render: the target at {plane.distance:g} mm with the tilt {plane.tilt} reaches the"
            " main lens within what the sensor sees; a smaller tilt or offset is due"
        )
    return (crossing - depth[..., None] * slope - centre) @ axes.T


def linearised(lenses: Lenses, plane: Plane, distortion: Distortion | None) -> Landing:
    """The map round the pupil's centre and the middle of each micro-image, by differences of
    ``land``; raises the same.
    """
    steps = np.concatenate([np.eye(2), -np.eye(2)])
    still = np.zeros_like(steps)
    pupil = np.concatenate([np.zeros((1, 2)), OF_PUPIL * steps, still])[None]
    sensor = np.concatenate([np.zeros((1, 2)), still, ON_SENSOR * steps])[None]
    places = land(lenses, plane, distortion, pupil, sensor)
    origin = places[:, 0]

    def derivative(first: int, step: float) -> Array:
        ahead, behind = places[:, first : first + 2], places[:, first + 2 : first + 4]
        return ((ahead - behind) / (2 * step)).swapaxes(1, 2)

    moved = [
        land(lenses, replace(plane, offset=(plane.offset[0] + x, plane.offset[1] + y)), distortion,
             pupil[:, :1], sensor[:, :1])[:, 0]
        for x, y in np.eye(2).tolist()
    ]  # fmt: skip
    return Landing(
        origin=origin,
        by_pupil=derivative(1, OF_PUPIL),
        by_sensor=derivative(5, ON_SENSOR),
        by_motion=np.stack(moved, axis=2) - origin[:, :, None],
    )
