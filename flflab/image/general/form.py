"""Any scene by blocks of rays: textures, tilted targets, cards that hide others, a lens that
distorts, motion. A pilot on some pixels finds how many rays a pixel needs, and measures the error.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from flflab.image.bands import go_on, in_bands
from flflab.image.general.rays import (
    Flat,
    Points,
    Rays,
    aberrate,
    flat_of,
    grid,
    land,
    lit_pixels,
    rays_of,
    shifted_grid,
)
from flflab.image.general.targets import Boxes, Sight, add_light, covered, sight_of
from flflab.image.landing import Landing, linearised
from flflab.image.microlenses import Lenses, Record, outside
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import pixel_positions
from flflab.targets import Bars, FourDot, Picture

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Group = tuple[int, Whole, tuple[Array, Array]]

TOGETHER = 96  # squared, rays that are formed together: they stay in the cache
MOST_SIDE = 16  # points a side of the pupil
PILOT = 3000  # lit pixels
MORE = 8  # times as many are looked at: targets may be dark in most
LIT = 1e-3  # of white
PILOT_SIDE = 10  # points a side of the pupil, for each quarter of a pixel, in either reference
PILOT_TOLERANCE = 2e-3  # that they are good for; finer ones take more
SHARED = 8  # pixels of a reference that share their points
ALIKE = 64  # pixels that are tried together
STILL = 0.5  # of a pixel's footprint: motion up to it widens a ray's box
MOST_MOMENTS = 64
KEPT = 0.85  # of the tolerance: what the pilot's estimate must be within


@dataclass(frozen=True)
class Surface:
    """A target ready for rays.

    Attributes:
        plane: the target.
        flat: the plane as kernels take it.
        lenses: ``MICROLENS`` records made for its distance, the same microlenses for all targets.
        landing: first order of each microlens's map to it.
        see: what is seen of what is on it.
    """

    plane: Plane
    flat: Flat
    lenses: Lenses
    landing: Landing
    see: Sight


@dataclass(frozen=True)
class Blocks:
    """A scene ready to be formed by rays.

    Attributes:
        scene: what is pictured.
        surfaces: its targets, the nearest first; those that are no points at infinity.
        pixel: side over which a pixel gathers light, mm; 0 for its centre alone.
        defocus: whether rays through one pixel differ.
    """

    scene: Scene
    surfaces: tuple[Surface, ...]
    pixel: float
    defocus: bool


@dataclass(frozen=True)
class Pilot:
    """What a pilot found: points a side of the pupil, and the error's root mean square and 99th
    percentile over lit pixels, of white.
    """

    side: int
    rms: float
    percentile_99: float


def blocks_of(scene: Scene, lenses: tuple[Lenses, ...], *, defocus: bool, pixel: float) -> Blocks:
    """Prepare a scene; ``lenses`` are those that light the sensor, for each plane's distance."""
    surfaces: list[Surface] = []
    for plane, own in zip(scene.planes, lenses, strict=True):
        if math.isinf(plane.distance) and isinstance(plane.target, FourDot | Bars | Picture):
            continue
        if not defocus:
            own = own.copy()
            own["spread"] = own["lens_spread"] = 0.0
        landing = linearised(own, plane, scene.distortion)
        flat = flat_of(plane, scene.distortion)
        surfaces.append(Surface(plane, flat, own, landing, sight_of(plane.target)))
    return Blocks(scene, tuple(surfaces), pixel, defocus)


def add_rays(image: Array, blocks: Blocks, side: int) -> None:
    """Add the light of a scene to a picture, with so many points a side of every pupil."""
    if not blocks.surfaces:
        return
    xs, ys = pixel_positions(blocks.scene.camera.sensor)
    points, lenses = grid(side if blocks.defocus else 1), blocks.surfaces[0].lenses

    pixel, together = blocks.scene.camera.sensor.pixel, max(TOGETHER // side, 8) ** 2

    def form(first: int, last: int) -> Iterator[None]:
        for index, lens in enumerate(lenses):
            rows, columns = lit_pixels(lens, xs, ys, pixel, (first, last))
            for start in range(0, len(rows), together):
                y, x = rows[start : start + together], columns[start : start + together]
                rays = _rays(blocks, lens, points, (xs[x] - lens["x"], ys[y] - lens["y"]))
                light = _light(blocks, index, rays, points)
                add_light(image, y, x, light, rays.weight, float(lens["level"]))
                yield

    in_bands(form, image.shape[0])


def pilot(blocks: Blocks, tolerance: float, most_side: int = MOST_SIDE) -> Pilot:
    """The fewest points whose error stays within a tolerance, by a look at random lit pixels.

    Two independent references of each pixel are compared with the picture: the mean of (V - A)(V -
    B) is the mean squared error without bias; what it is uncertain by is counted.
    """
    if not blocks.surfaces:
        return Pilot(2, 0.0, 0.0)
    columns, rows = (
        np.random.default_rng(axis).integers(0, size, MORE * PILOT)
        for axis, size in enumerate(blocks.scene.camera.sensor.resolution)
    )
    every = _groups(blocks, rows, columns, ALIKE)
    lit = _summed(blocks, every, len(rows), partial(grid, 2)) > LIT
    rows, columns = rows[lit][:PILOT], columns[lit][:PILOT]
    if not len(rows):
        return Pilot(2, 0.0, 0.0)
    groups, few = (_groups(blocks, rows, columns, most) for most in (ALIKE, SHARED))
    fine = math.ceil(PILOT_SIDE * min(max(math.sqrt(PILOT_TOLERANCE / tolerance), 1.0), 3.0))
    first, second = (
        _summed(blocks, few, len(rows), partial(shifted_grid, fine, rng))
        for rng in np.random.default_rng(1).spawn(2)
    )
    found = Pilot(1, math.inf, math.inf)
    for side in range(2 if blocks.defocus else 1, most_side + 1):
        values = _summed(blocks, groups, len(rows), partial(grid, side))
        products = (values - first) * (values - second)
        unsure = float(products.std()) * math.sqrt(SHARED / len(products))
        squared = float(products.mean()) + unsure
        apart = np.abs(values - (first + second) / 2)
        rms = math.sqrt(max(squared, 0.0))
        found = Pilot(side, rms, float(np.percentile(apart, 99)))
        if rms <= KEPT * tolerance or not blocks.defocus:
            break
    return found


def light_at(blocks: Blocks, rows: Whole, columns: Whole, points: Callable[[], Points]) -> Array:
    """Light of single pixels through all microlenses, of white.

    Args:
        blocks: the scene.
        rows: of the pixels, shape (P,).
        columns: the same.
        points: gives points of the pupil, anew for each microlens and few pixels.
    """
    groups = _groups(blocks, rows, columns, SHARED)
    return _summed(blocks, groups, len(rows), points)


def _groups(blocks: Blocks, rows: Whole, columns: Whole, most: int) -> list[Group]:
    """Pixels, not more than ``most``, that one microlens lights: the microlens, which of them, and
    where they lie from its micro-image's centre, mm.
    """
    xs, ys = pixel_positions(blocks.scene.camera.sensor)
    lenses = blocks.surfaces[0].lenses
    reach = outside(lenses) + blocks.scene.camera.sensor.pixel
    order = np.argsort(ys[rows], kind="stable")
    down = ys[rows[order]]
    found: list[Group] = []
    for index, lens in enumerate(lenses):
        first, last = np.searchsorted(down, lens["y"] + reach[index] * np.array([-1.0, 1.0]))
        near = order[first:last]
        ex, ey = xs[columns[near]] - lens["x"], ys[rows[near]] - lens["y"]
        here = ex * ex + ey * ey < reach[index] ** 2
        near, ex, ey = near[here], ex[here], ey[here]
        for start in range(0, len(near), most):
            few = slice(start, start + most)
            found.append((index, near[few], (ex[few], ey[few])))
    return found


def _summed(blocks: Blocks, groups: list[Group], count: int, points: Callable[[], Points]) -> Array:
    """Light of so many pixels through all their microlenses: where micro-images overlap, errors
    add up.
    """
    total = np.zeros(count)
    for index, pixels, places in groups:
        total[pixels] += _values(blocks, index, points(), places)
    return total


def _rays(blocks: Blocks, lens: Record, points: Points, places: tuple[Array, Array]) -> Rays:
    scene, array = blocks.scene, blocks.scene.camera.array
    rays = rays_of(lens, points, *places, blocks.pixel, scene.falloff is not None)
    if scene.spherical_aberration is not None:
        marginal = scene.spherical_aberration.marginal
        aberrate(rays, lens, scene.camera.optical_gap, array.aperture / 2, marginal)
    return rays


def _values(blocks: Blocks, index: int, points: Points, places: tuple[Array, Array]) -> Array:
    """Light of single pixels through one microlens, of white."""
    go_on()
    lens = blocks.surfaces[0].lenses[index]
    rays = _rays(blocks, lens, points, places)
    return float(lens["level"]) * (rays.weight * _light(blocks, index, rays, points)).sum(axis=0)


def _light(blocks: Blocks, index: int, rays: Rays, points: Points) -> Array:
    """What every ray through a microlens sees, the nearest target first; shape (N, P)."""
    moments = _moments(blocks, index)
    total = np.zeros(rays.weight.shape)
    for moved, left_x, left_y in moments:
        light, free = np.zeros_like(total), np.ones_like(total)
        for place, surface in enumerate(blocks.surfaces):
            boxes = _boxes(blocks, surface, index, rays, points, (left_x, left_y))
            u, v = land(surface.lenses[index], surface.flat, rays, moved)
            size = surface.plane.size or (math.inf, math.inf)
            half = size[0] / 2, size[1] / 2
            here = surface.see(u, v, boxes, half)
            if surface.plane.size is not None:
                part = covered(u, v, boxes, *half)
                here *= part
                light += free * here
                free *= 1 - part
            else:
                light += free * here
            if place == len(blocks.surfaces) - 1:
                break
        total += light
    return total / len(moments)


def _boxes(
    blocks: Blocks,
    surface: Surface,
    index: int,
    rays: Rays,
    points: Points,
    motion: tuple[float, float],
) -> Boxes:
    """The box of each pixel's rays on a target: the pixel, the pupil's cell, what motion is left.

    Points that are shifted at random have no cell: their mean has no bias by its size.
    """
    by_sensor, by_pupil = surface.landing.by_sensor[index], surface.landing.by_pupil[index]
    by_motion = surface.landing.by_motion[index]
    side = blocks.pixel if points.exact else blocks.pixel / 2
    cell = np.zeros_like(rays.share)
    if points.exact:
        cell = math.pi * np.minimum(rays.share, 1.0) / len(points.across)
    pixel = side * np.sqrt((by_sensor**2).sum(axis=1))
    other = (by_pupil**2).sum(axis=1)[:, None] * cell
    other += ((by_motion**2) @ np.square(motion))[:, None]
    every = np.ones_like(cell)
    return Boxes(pixel[0] * every, pixel[1] * every, np.sqrt(other[0]), np.sqrt(other[1]))


def _moments(blocks: Blocks, index: int) -> list[tuple[tuple[float, float], float, float]]:
    """Moments of equal shares of the exposure: how far the targets have moved, and the sides of the
    box that the motion within each adds, mm.
    """
    motion = blocks.scene.motion
    finite = [one for one in blocks.surfaces if math.isfinite(one.plane.distance)]
    if motion is None or not finite:
        return [((0.0, 0.0), 0.0, 0.0)]
    footprint = min(
        math.hypot(
            blocks.pixel * float(np.abs(one.landing.by_sensor[index]).max()),
            float(np.abs(one.landing.by_pupil[index]).max()),
        )
        for one in finite
    )
    still = STILL * footprint or math.inf
    drift, swing = np.asarray(motion.drift), 2 * np.asarray(motion.vibration)
    counts = [
        int(np.clip(math.ceil(min(math.hypot(*way) / still, MOST_MOMENTS)), 1, MOST_MOMENTS))
        for way in (drift, swing)
    ]
    even, turned = ((np.arange(count) + 0.5) / count for count in counts)
    left = (drift / counts[0]) ** 2 + (1.5 if counts[1] == 1 else 1.0) * (swing / counts[1]) ** 2
    return [
        (tuple((first - 0.5) * drift + math.cos(math.pi * second) / 2 * swing), *np.sqrt(left))
        for first in even
        for second in turned
    ]
