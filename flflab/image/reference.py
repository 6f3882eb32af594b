"""The slow reference of ``render``: rays traced one by one from points of a pixel through the thin lenses to the target.

It shares no formula with the fast path: each ray is refracted at the microlens and at the main lens, asked whether both stops let
it through, and takes the target's own radiance where it lands. Points are a low-discrepancy sequence in four dimensions.
"""

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import Camera, microlens_centres, microlens_types, pixel_positions
from flflab.targets import Target

Array = npt.NDArray[np.float64]

GOLDEN = 1.1673039782614187  # the root of x^5 = x + 1: its powers give the additive sequence in four dimensions


def trace_pixels(
    camera: Camera,
    target: Target,
    distance: float,
    pixels: npt.NDArray[np.int64],
    *,
    rays: int = 65536,
    target_offset: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Trace single pixels of the image.

    Args:
        camera: the camera, with round apertures.
        target: what stands in front of it.
        distance: main lens to target, mm; finite.
        pixels: (column, row) of each, shape (K, 2).
        rays: rays a pixel and microlens; the error falls about as their power -0.7.
        target_offset: where the target's centre stands, mm.

    Returns:
        Irradiance in units of the white level, shape (K,).
    """
    points = (0.5 + np.arange(rays)[:, None] * GOLDEN ** -np.arange(1.0, 5.0)) % 1.0
    radius, angle = np.sqrt(points[:, 2]), 2 * np.pi * points[:, 3]
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    centres, types = microlens_centres(camera.array), microlens_types(camera.array)
    xs, ys = pixel_positions(camera.sensor)
    nearest = int(np.argmin(np.round(np.hypot(centres[:, 0], centres[:, 1]), 9)))
    middle = np.broadcast_to(_behind(camera, centres[nearest]), (rays, 2))
    white = _light(camera, centres[nearest], types[nearest], disc, middle, None, distance, (0.0, 0.0))
    reach = np.array([_reach(camera, centre) for centre in centres])
    behind = np.array([_behind(camera, centre) for centre in centres])
    image = np.zeros(len(pixels))
    for index, (column, row) in enumerate(pixels):
        place = np.array([xs[column], ys[row]])
        sensor_points = place + (points[:, :2] - 0.5) * camera.sensor.pixel
        for lens in np.flatnonzero(np.hypot(*(behind - place).T) < reach):
            image[index] += _light(camera, centres[lens], types[lens], disc, sensor_points, target, distance, target_offset) / white
    return image


def _depth_and_gap(camera: Camera, centre: Array) -> tuple[float, float]:
    """Main lens to this microlens of a perhaps tilted array, and from there to the sensor, mm."""
    rise = float(centre @ np.asarray(camera.array.tilt))
    return camera.optical_distance + rise, camera.optical_gap - rise


def _behind(camera: Camera, centre: Array) -> Array:
    """Where the ray through the centres of main lens and microlens meets the sensor."""
    depth, gap = _depth_and_gap(camera, centre)
    return centre * (depth + gap) / depth


def _reach(camera: Camera, centre: Array) -> float:
    """A radius round that place beyond which no ray through the microlens and the main lens's stop lands."""
    depth, gap = _depth_and_gap(camera, centre)
    bend = camera.array.aperture / 2 / min(abs(f) for f in camera.array.focal_lengths)
    return camera.array.aperture + gap * ((camera.main_lens.aperture + camera.array.aperture) / 2 / depth + bend)


def _light(
    camera: Camera,
    centre: Array,
    kind: int,
    disc: Array,
    sensor_points: Array,
    target: Target | None,
    distance: float,
    target_offset: tuple[float, float],
) -> float:
    """Mean radiance over rays from the sensor points through all of the microlens, over the gap squared; no target means white."""
    depth, gap = _depth_and_gap(camera, centre)
    on_lens = centre + camera.array.aperture / 2 * disc
    after = (sensor_points - on_lens) / gap
    before = after + (on_lens - centre) / camera.array.focal_lengths[kind]
    on_main = on_lens - depth * before
    passes = np.hypot(on_main[:, 0], on_main[:, 1]) <= camera.main_lens.aperture / 2
    slope = before + on_main / camera.main_lens.focal_length
    on_target = on_main - distance * slope - np.asarray(target_offset)
    seen = 1.0 if target is None else target.radiance(on_target[:, 0], on_target[:, 1])
    return float(np.mean(passes * seen)) / gap**2
