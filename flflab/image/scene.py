"""What is to be formed, and how finely: where light can fall, how a pixel is divided, how many strips a blur needs."""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.image.pupil import Pupils, camera_pupils
from flflab.image.rim import STEEP, Rims, find_rims, rim_tables
from flflab.optics.camera import Camera, Sensor, pixel_positions

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

BAND_ROWS = 48
MOST_PARTS = 8
MOST_STRIPS = 128


@dataclass(frozen=True)
class Scene:
    """A camera before a target; the pupils' object side in mm on the target (rad where the target is at infinity).

    Attributes:
        sensor: the sensor.
        pupils: one a microlens.
        rims: the kinds of rims of their micro-images.
        blur: diameter on the sensor of the blur of a point, pixels, one a microlens.
        tolerance: largest error asked for.
        overlap: how many micro-images reach a sensor point, at least 1; the errors of their strips add up.
    """

    sensor: Sensor
    pupils: Pupils
    rims: Rims
    blur: Array
    tolerance: float
    overlap: float

    def seen_from(self, x: float, y: float) -> "Scene":
        """The same with the target's coordinates counted from (x, y)."""
        pupils = replace(self.pupils, direction_x=self.pupils.direction_x - x, direction_y=self.pupils.direction_y - y)
        return replace(self, pupils=pupils)

    def kind_blur(self, largest: bool) -> Array:
        """The largest or smallest blur among the microlenses of each kind of rim, pixels."""
        choose = np.max if largest else np.min
        return np.array([choose(self.blur[self.rims.kind == kind]) for kind in range(len(self.rims.width))])


def make_scene(camera: Camera, distance: float, tolerance: float, target_offset: tuple[float, float]) -> Scene:
    """Set up a camera before a target at a distance (mm, infinity allowed) that stands off the axis by an offset (mm)."""
    pixel = camera.sensor.pixel
    vergence = 1 / distance
    unit = distance if vergence > 0 else 1.0
    pupils = camera_pupils(camera, vergence)
    pupils = replace(
        pupils,
        slope=np.where(np.abs(pupils.slope) < 1e-6 * pixel, 0.0, pupils.slope),
        spread=pupils.spread * unit,
        scale=pupils.scale * unit,
        direction_x=pupils.direction_x * unit,
        direction_y=pupils.direction_y * unit,
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        blur = np.where(pupils.spread == 0, 0.0, 2 * np.abs(pupils.spread / pupils.scale) / pixel)
    scene = Scene(camera.sensor, pupils, find_rims(pupils, pixel), blur, tolerance, max(1.0, _coverage(camera, pupils)))
    return scene.seen_from(*target_offset) if vergence > 0 else scene


def _coverage(camera: Camera, pupils: Pupils) -> float:
    """How many micro-images reach a sensor point on average."""
    row = math.sqrt(3) / 2 if camera.array.layout == "hexagonal" else 1.0
    cell = camera.array.pitch[0] * camera.array.pitch[1] * row * (camera.sensor.distance / camera.array.distance) ** 2
    return math.pi * float(np.max(pupils.outside)) ** 2 / cell


def lit_windows(scene: Scene, half_x: float, half_y: float) -> Whole:
    """Where a microlens's light from a box on the target can fall.

    Args:
        scene: what is formed.
        half_x: half the box's width, target mm; infinity for no bounds.
        half_y: half its height.

    Returns:
        First column, column after the last, first row, row after the last; shape (N, 4).
    """
    pupils, pixel = scene.pupils, scene.sensor.pixel
    xs, ys = pixel_positions(scene.sensor)
    outside = pupils.outside + pixel
    limits: list[Array] = []
    for centre, direction, half, positions in (
        (pupils.centre_x, pupils.direction_x, half_x, xs),
        (pupils.centre_y, pupils.direction_y, half_y, ys),
    ):
        reach = half + np.abs(pupils.spread) + np.abs(pupils.scale) * pixel
        with np.errstate(divide="ignore", invalid="ignore"):
            middle = -direction / pupils.scale
            lowest = np.fmax(-outside, middle - reach / np.abs(pupils.scale))
            highest = np.fmin(outside, middle + reach / np.abs(pupils.scale))
        low, high = positions[0] - pixel, positions[-1] + pixel
        start = np.ceil((np.clip(centre + lowest, low, high) - positions[0]) / pixel)
        end = np.floor((np.clip(centre + highest, low, high) - positions[0]) / pixel) + 1
        limits += [start, np.where(lowest < highest, end, 0)]
    sizes = np.array([len(xs), len(xs), len(ys), len(ys)])
    return np.clip(np.stack(limits, axis=1), 0, sizes).astype(np.int64)


def pixel_parts(scene: Scene) -> tuple[Whole, npt.NDArray[np.bool_]]:
    """Into how many parts a side a pixel is divided for each kind of rim, and which kinds are steep.

    Inside a pixel light and rim vary together: a step of the target in a rim w pixels wide leaves an error of up to
    0.17 / (w n^2) of white, less where the step is blurred (found as the root of the blur in pixels).
    """
    width = np.maximum(scene.rims.width, 1e-9)
    blur = np.maximum(scene.kind_blur(largest=False), 1.0)
    parts = np.clip(np.ceil(np.sqrt(0.34 / (width * scene.tolerance * np.sqrt(blur)))), 1, MOST_PARTS)
    parts = np.where(width * parts < STEEP, MOST_PARTS, parts)
    return parts.astype(np.int64), width * parts < STEEP


def rim_rows(scene: Scene, parts: Whole, steep: npt.NDArray[np.bool_]) -> Array:
    """The tables of the rims' light; those of steep kinds start with a negative distance."""
    tables = rim_tables(scene.rims, scene.sensor.pixel / float(parts.max()), steep)
    tables[steep, 0] = -1.0
    return tables


def strip_counts(blur: Array, tolerance: float) -> Whole:
    """How many strips across the pupil a blur in pixels needs; 0 where the blur itself is below the tolerance.

    Measured on square bars: n strips leave 0.08 blur / n^2 of white for small blurs; for large ones 9 + 0.6 blur leave 0.0012.
    """
    allowed = 0.5 * tolerance
    small = np.sqrt(0.08 * blur / allowed)
    large = (9 + 0.6 * np.minimum(blur, 1e4)) * np.sqrt(0.0012 / allowed)
    counts = np.ceil(np.minimum(small, large))
    counts = np.where(0.42 * blur < allowed, 0, np.maximum(counts, 2))
    return np.clip(counts, 0, MOST_STRIPS).astype(np.int64)


def grid_counts(blur: Array, tolerance: float) -> Whole:
    """How many points a side across the pupil a blur in pixels needs; measured on dots: n of them leave 0.1 blur / n^2 of white."""
    return np.clip(np.ceil(np.sqrt(0.1 * blur / (0.6 * tolerance))), 1, MOST_STRIPS).astype(np.int64)


def spot_parts(blur: Array, tolerance: float) -> Whole:
    """Into how many parts a side a pixel is divided for the three-disc formula; n of them leave 0.07 / (n^2 sqrt(blur)) of white."""
    parts = np.ceil(np.sqrt(0.07 / (np.sqrt(np.maximum(blur, 0.1)) * 0.6 * tolerance)))
    return np.clip(parts, 2, 4 * MOST_PARTS).astype(np.int64)


def in_bands(add: Callable[[tuple[int, int]], None], windows: Whole) -> None:
    """Call ``add`` for bands of rows that hold light, on all cores; bands share no row, so overlapping light adds up safely."""
    lit = windows[(windows[:, 0] < windows[:, 1]) & (windows[:, 2] < windows[:, 3])]
    if not len(lit):
        return
    first, last = int(lit[:, 2].min()), int(lit[:, 3].max())
    bands = [(start, min(start + BAND_ROWS, last)) for start in range(first, last, BAND_ROWS)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(add, bands))
