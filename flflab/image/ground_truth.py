"""What is true of a picture, by the model and not by measurement: for the JSON file beside it."""

import math
from dataclasses import fields
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import root_scalar

from flflab.errors import InputError
from flflab.image.effects.distortion import Distortion
from flflab.image.landing import own_axes
from flflab.image.microlenses import axis_microlens, scattered
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import Camera, Sensor, microlens_indices
from flflab.optics.focus import magnification, sharp_vergence
from flflab.optics.neighbours import neighbours_of
from flflab.optics.smms import Smms, camera_smms
from flflab.optics.useful import SensorFields, fields_of, select
from flflab.optics.views import chief_crossings, seen_by
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]

MM = (
    *("aperture", "diameter", "distance", "focal_length", "focal_lengths", "height", "offset"),
    *("pitch", "pixel", "size", "spacing", "width"),
)
UNITS = {**dict.fromkeys(MM, "mm"), "resolution": "px", "angle": "deg", "roll": "deg"}


def ground_truth(scene: Scene) -> dict[str, Any]:
    """Camera, lattice of micro-images, and where every dot is seen; (x, y) throughout, pixel (0, 0)
    at its centre.

    Returns:
        Numbers, strings, lists and dictionaries, ready for JSON:

        ``camera``: ``focal_length_mm``, ``f_number``, ``aperture_shape``, ``array`` {``layout``,
            ``count``, ``pitch_mm``, ``aperture_mm``,
        ``focal_lengths_mm``, ``distance_mm``, ``offset_mm``, ``roll_deg``, ``tilt`` (slopes)},
        ``sensor`` {``resolution_px``, ``pixel_mm``, ``distance_mm``, ``offset_mm``},
        ``sharp_distance_mm``.

        ``lattice``: ``layout``, ``pitch_px`` and ``angle_deg`` as described, without scatter;
            ``centres_px`` of all micro-images of which
        any part is on the sensor, with the ``microlenses`` [column, row] they belong to and their
        ``inside_radii_px`` and ``outside_radii_px``; ``origin_px``, ``inside_radius_px`` and
        ``outside_radius_px`` of the one nearest the sensor's middle.

        ``planes``, a list: ``target`` {``kind``, its sizes}, ``distance_mm``, ``offset_mm``,
            ``roll_deg``, ``tilt``, ``size_mm``,
        ``magnification`` (at its distance, target to micro-image), and ``dots`` of a four-dot
        target: ``dot``, ``position_mm`` [x, y, distance], ``views`` {``total``, ``bright``,
        ``chief``}, and ``images``, one for each of the total views: ``microlens`` [column, row],
        ``bright``, ``chief``, ``place_px`` (where the ray through the middle of what limits the
        dot's light lands; in the middle of the exposure).

        ``reasons`` {key: sentence} for what is null.
    """
    reasons: dict[str, str] = {}
    smms = camera_smms(scene.camera)
    if scene.scatter is not None:
        smms = scattered(smms, scene.scatter)
    return {
        "camera": _camera(scene.camera, reasons),
        "lattice": _lattice(scene.camera, smms),
        "planes": [_plane(scene, index, smms, reasons) for index in range(len(scene.planes))],
        "reasons": reasons,
    }


def sharp_distance(camera: Camera) -> float:
    """Distance of the target in focus, mm.

    Raises:
        InputError: no real target distance is.
    """
    smms = camera_smms(camera)
    sharp = float(sharp_vergence(smms)[axis_microlens(smms)])
    if not 0 < sharp < math.inf:
        raise InputError(
            "camera: no real target distance is in focus on the sensor; give a scene with its"
            " target's distance"
        )
    return 1 / sharp


def _camera(camera: Camera, reasons: dict[str, str]) -> dict[str, Any]:
    smms = camera_smms(camera)
    sharp = float(sharp_vergence(smms)[axis_microlens(smms)])
    if sharp == 0:
        reasons["camera.sharp_distance_mm"] = "the camera is focused at infinity"
    elif not 0 < sharp < math.inf:
        reasons["camera.sharp_distance_mm"] = "no real target distance is in focus on the sensor"
    array = ("layout", "count", "pitch", "aperture", "focal_lengths", "distance", "offset", "roll")
    return {
        **_told(camera.main_lens, "focal_length", "f_number"),
        **_told(camera, "aperture_shape"),
        "array": _told(camera.array, *array, "tilt"),
        "sensor": _told(camera.sensor, "resolution", "pixel", "distance", "offset"),
        "sharp_distance_mm": 1 / sharp if 0 < sharp < math.inf else None,
    }


def _told(part: object, *names: str) -> dict[str, Any]:
    """Fields of a part, by name and unit; null where infinite."""
    found: dict[str, Any] = {}
    for name in names:
        value, unit = getattr(part, name), UNITS.get(name)
        if isinstance(value, tuple):
            value = list(value)
        elif unit == "deg":
            value = math.degrees(value)
        found[name if unit is None else f"{name}_{unit}"] = None if value == math.inf else value
    return found


def _pixels(sensor: Sensor, position: Array) -> Array:
    """Positions (x, y) on the sensor in mm as pixels, shape (n, 2)."""
    return (position - np.asarray(sensor.offset)) / sensor.pixel + (
        np.asarray(sensor.resolution) - 1
    ) / 2


def _lattice(camera: Camera, smms: Smms) -> dict[str, Any]:
    pixel, size = camera.sensor.pixel, np.asarray(camera.sensor.resolution)
    centres = _pixels(
        camera.sensor, np.stack([smms.centre_x, smms.centre_y], axis=1) * smms.image_scale[:, None]
    )
    inside, outside = smms.inside_radius / pixel, smms.outside_radius / pixel
    seen = np.flatnonzero(np.hypot(*(centres - np.clip(centres, -0.5, size - 0.5)).T) < outside)
    middle = int(np.argmin(np.hypot(*(centres - (size - 1) / 2).T)))
    turn = 90.0 if camera.array.layout == "square" else 60.0
    return {
        "layout": camera.array.layout,
        "pitch_px": (
            math.sqrt(math.prod(camera.array.pitch)) * float(smms.image_scale[middle]) / pixel
        ),
        "angle_deg": (math.degrees(camera.array.roll) + turn / 2) % turn - turn / 2,
        "origin_px": centres[middle].tolist(),
        "inside_radius_px": float(inside[middle]),
        "outside_radius_px": float(outside[middle]),
        "microlenses": microlens_indices(camera.array)[seen].tolist(),
        "centres_px": centres[seen].tolist(),
        "inside_radii_px": inside[seen].tolist(),
        "outside_radii_px": outside[seen].tolist(),
    }


def _plane(scene: Scene, index: int, smms: Smms, reasons: dict[str, str]) -> dict[str, Any]:
    plane, key = scene.planes[index], f"planes[{index}]"
    infinite = math.isinf(plane.distance)
    dots, why = None, None
    if not isinstance(plane.target, FourDot):
        why = "the target has no dots"
    elif infinite:
        why = "what has a size in mm is a point, and dark, at infinity"
    elif index > 0:
        why = "nearer cards hide parts of it; the model's views know nothing of cards"
    elif plane.size is not None and np.any(
        np.abs(plane.target.centres) > np.asarray(plane.size) / 2
    ):
        why = "a dot lies off its card"
    else:
        useful = fields_of(smms, neighbours_of(smms, scene.camera), scene.camera)
        dots = [
            _dot(scene, plane, dot, place, useful) for dot, place in enumerate(plane.target.centres)
        ]
    scale = float(magnification(smms, 1 / plane.distance)[axis_microlens(smms)])
    if math.isinf(scale):
        reasons[f"{key}.magnification"] = "the target's image lies on the array"
    if infinite:
        reasons[f"{key}.distance_mm"] = "the target is at infinity"
    if plane.size is None:
        reasons[f"{key}.size_mm"] = "it is boundless"
    if why is not None:
        reasons[f"{key}.dots"] = why
    parts = (one.name for one in fields(plane.target) if one.name != "values")
    return {
        "target": {"kind": plane.target.kind, **_told(plane.target, *parts)},
        **_told(plane, "distance", "offset", "roll", "tilt", "size"),
        "magnification": scale if math.isfinite(scale) else None,
        "dots": dots,
    }


def _dot(
    scene: Scene, plane: Plane, dot: int, place: Array, useful: SensorFields
) -> dict[str, Any]:
    camera = scene.camera
    position = dot_position(plane, place)
    vergence = 1 / position[2]
    angle = paraxial_angle(position[:2] * vergence, scene.distortion)
    members = np.arange(len(useful.smms.focal))
    total, bright, chief = seen_by(
        useful, members, vergence, np.broadcast_to(angle, (len(members), 2))
    )
    indices, seen = microlens_indices(camera.array), np.flatnonzero(total)
    lenses = select(useful.smms, seen)
    centre = np.stack([lenses.centre_x, lenses.centre_y], axis=1)
    landing = _pixels(
        camera.sensor, chief_crossings(lenses, vergence, angle, centre, camera.aperture_shape)[2]
    )
    return {
        "dot": dot,
        "position_mm": position.tolist(),
        "views": {
            "total": int(total.sum()),
            "bright": int(bright.sum()),
            "chief": int(chief.sum()),
        },
        "images": [
            {
                "microlens": indices[i].tolist(),
                "bright": bool(bright[i]),
                "chief": bool(chief[i]),
                "place_px": place.tolist(),
            }
            for i, place in zip(seen, landing, strict=True)
        ],
    }


def dot_position(plane: Plane, place: Array) -> Array:
    """Where a place (x, y) mm in a target's own axes stands in the world: x, y, and the distance
    before the main lens; mm, shape (3,).

    ``own_axes`` leads from places seen along the axis to the target's own.
    """
    seen = np.linalg.solve(own_axes(plane), place)
    away = plane.distance + float(np.dot(plane.tilt, seen))
    return np.array([*(seen + np.asarray(plane.offset)), away])


def paraxial_angle(angle: Array, distortion: Distortion | None) -> Array:
    """The direction a (rad, shape (2,)) under which a lens without distortion shows what lies under
    ``angle`` = a (1 + k |a|^2).
    """
    seen = float(np.hypot(*angle))
    if distortion is None or seen == 0:
        return angle
    coefficient = distortion.coefficient
    found = root_scalar(
        lambda away: away * (1 + coefficient * away**2) - seen,
        fprime=lambda away: 1 + 3 * coefficient * away**2,
        x0=seen,
        method="newton",
    ).root
    return angle * (found / seen)
