"""The microlenses as seen from their micro-images: which part of each pupil sends light to a sensor
point, and from where.

Pupil points are t in the unit disc of the narrower aperture (the microlens where d |kappa| <= A
b/L, else the main lens). From a sensor point at e from the micro-image's centre the other aperture
lets through |slope t - e| <= reach, and the ray meets the object plane, in angle, at o V = spread t
+ scale e + direction. Source: physics.md, "Exact image of a flat target".
"""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.image.effects.scatter import Scatter
from flflab.optics.camera import Camera, Sensor, pixel_positions
from flflab.optics.smms import Smms, array_vergence, camera_smms

Array = npt.NDArray[np.float64]
Lenses = npt.NDArray[np.void]
Record = Any  # one of them: numba reads its fields as attributes, which numpy's types do not know

MICROLENS = np.dtype(
    [
        (name, np.float64)
        for name in (
            "x",  # centre of the micro-image on the sensor, mm
            "y",
            "slope",  # mm on the sensor per unit of pupil, signed
            "reach",  # radius on the sensor of the wider aperture's shadow, mm
            "level",  # irradiance at full pupil, of the white level
            "lens_spread",  # where the ray crosses the main lens, mm per unit of pupil
            "lens_scale",  # the same per mm on the sensor
            "spread",  # angle on the object side per unit of pupil, rad
            "scale",  # the same per mm on the sensor
            "direction_x",  # object direction of the ray through both centres, rad
            "direction_y",
            "slant_x",  # slope at the sensor of the ray through both centres
            "slant_y",
            "slant_scale",  # change of a ray's slope per mm on the sensor
            "slant_spread",  # the same per unit of pupil
        )
    ]
    + [(name, np.int64) for name in ("first_column", "end_column", "first_row", "end_row")]
)


def axis_microlens(smms: Smms) -> int:
    """Index of the microlens nearest the axis, the lower one of equals; its micro-image sets the
    white level.
    """
    squared = smms.centre_x**2 + smms.centre_y**2
    return int(np.flatnonzero(squared <= squared.min() * (1 + 1e-9))[0])


def draws_of(scatter: Scatter, count: int) -> Array:
    """Standard normal numbers of every microlens, shape (count, 6): focal length, place x, y,
    brightness, decentre of the aperture x, y.

    Philox keyed by the seed, so that they depend on the seed and the microlens's index alone.
    """
    key = np.random.Philox(key=scatter.seed)
    placed = np.random.Generator(key).standard_normal((count, 3))
    bright = np.random.Generator(key.jumped()).standard_normal((count, 1))
    decentred = np.random.Generator(key.jumped(2)).standard_normal((count, 2))
    return np.concatenate([placed, bright, decentred], axis=1)


def scattered(smms: Smms, scatter: Scatter) -> Smms:
    """Microlenses with errors of their own in focal length and place; the place is that of the
    aperture.
    """
    draws = draws_of(scatter, len(smms.focal))
    aside = scatter.position * draws[:, 1:3] + scatter.aperture_decentre * draws[:, 4:6]
    return replace(
        smms,
        focal=smms.focal * (1 + scatter.focal_length * draws[:, 0]),
        centre_x=smms.centre_x + aside[:, 0],
        centre_y=smms.centre_y + aside[:, 1],
    )


def camera_lenses(
    camera: Camera, vergence: float, scatter: Scatter | None = None, overlap: bool = True
) -> Lenses:
    """All microlenses, row by row, for a target of this vergence (1/mm, 0 at infinity).

    The white level is that of the camera without scatter.

    Args:
        camera: the camera.
        vergence: of the target.
        scatter: errors of the microlenses.
        overlap: whether a micro-image reaches as far as its light; else it ends half-way to its
            nearest neighbour, along columns and rows.

    Returns:
        ``MICROLENS`` records; a window is empty where no light meets the sensor.

    Raises:
        InputError: a tilted array reaches through the sensor.
    """
    ideal = camera_smms(camera)
    white = axis_microlens(ideal)
    white_level = (ideal.limiting_radius[white] / ideal.gap[white]) ** 2
    smms = ideal if scatter is None else scattered(ideal, scatter)
    ratio = smms.gap / smms.distance
    w = array_vergence(smms, vergence)
    by_microlens = smms.microlens_width <= smms.lens_width
    kappa = np.where(by_microlens, 1.0, smms.kappa)  # not used where it may be 0
    radius = np.where(by_microlens, smms.aperture, smms.lens_aperture) / 2
    found = np.zeros(len(smms.focal), MICROLENS)
    found["x"] = smms.centre_x * smms.image_scale
    found["y"] = smms.centre_y * smms.image_scale
    slope = radius * np.where(by_microlens, smms.kappa, -ratio)
    found["slope"] = np.where(np.abs(slope) < 1e-6 * camera.sensor.pixel, 0.0, slope)
    found["reach"] = np.where(by_microlens, smms.lens_width, smms.microlens_width) / 2
    found["slant_x"] = smms.centre_x / smms.distance
    found["slant_y"] = smms.centre_y / smms.distance
    found["level"] = (smms.limiting_radius / smms.gap) ** 2 / white_level
    if scatter is not None:
        draws = draws_of(scatter, len(found))
        found["level"] *= 1 + scatter.brightness * draws[:, 3]
        # A lens that stands aside of its aperture bends all rays that it passes alike.
        bend = -scatter.aperture_decentre * draws[:, 4:6] / smms.focal[:, None]
        for axis, name in enumerate("xy"):
            found[name] += smms.gap * bend[:, axis]
            found[f"slant_{name}"] += bend[:, axis]
    found["lens_spread"] = radius * np.where(by_microlens, smms.kappa / ratio, 1.0)
    found["lens_scale"] = np.where(by_microlens, -1 / ratio, 0.0)
    found["spread"] = radius * np.where(
        by_microlens,
        smms.kappa * w / ratio - 1 / smms.distance,
        w - ratio / (smms.distance * kappa),
    )
    found["scale"] = np.where(by_microlens, -w / ratio, -1 / (smms.distance * kappa))
    found["direction_x"] = -smms.centre_x / smms.distance
    found["direction_y"] = -smms.centre_y / smms.distance
    found["slant_scale"] = np.where(by_microlens, 1, 1 - 1 / kappa) / smms.gap
    found["slant_spread"] = -radius * np.where(
        by_microlens, 1 / smms.gap, 1 / (smms.distance * kappa)
    )
    set_windows(found, camera.sensor, overlap)
    return found


def outside(lenses: Lenses) -> Array:
    """Radii of the micro-images, mm: no light beyond."""
    return np.asarray(lenses["reach"] + np.abs(lenses["slope"]), dtype=np.float64)


def is_lit(lenses: Lenses) -> npt.NDArray[np.bool_]:
    """Which microlenses' light meets the sensor."""
    columns = lenses["first_column"] < lenses["end_column"]
    return columns & (lenses["first_row"] < lenses["end_row"])


def set_windows(lenses: Lenses, sensor: Sensor, overlap: bool) -> None:
    """The columns and rows of pixels that each micro-image can light."""
    half = outside(lenses) + sensor.pixel
    if not overlap and len(half) > 1:
        centres = np.stack([lenses["x"], lenses["y"]], axis=1)
        half = np.minimum(half, KDTree(centres).query(centres, k=2)[0][:, 1] / 2)
    for axis, (name, positions) in enumerate(
        zip(("column", "row"), pixel_positions(sensor), strict=True)
    ):
        centre = lenses["xy"[axis]]
        place = (np.stack([centre - half, centre + half]) - positions[0]) / sensor.pixel
        lenses[f"first_{name}"] = np.clip(np.ceil(place[0]), 0, len(positions))
        lenses[f"end_{name}"] = np.clip(np.floor(place[1]) + 1, 0, len(positions))
