"""Rays of some pixels through one microlens: the same few points of the pupil in every pixel, where
they cross the main lens, and where they meet a target.

A pixel's part of the pupil is common to the unit disc and the main lens's shadow. Along the line
through both centres lies x, across it y = H z (3 - z^2) / 2 with z from -1 to 1, H half the part's
height: this spreads points evenly where the chords are short. A point counts by its chord.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.effects.distortion import Distortion
from flflab.image.fast.share import STEEP, share_over
from flflab.image.landing import own_axes
from flflab.image.microlenses import Record
from flflab.image.scene import Plane

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

# By how much the midpoints of n parts are drawn together so that their y has the disc's variance.
DRAWN = (0.0, 0.595, 0.682, 0.737, 0.774, 0.802, 0.822, 0.839)
MORE_DRAWN = 0.865  # for more points


class Flat(NamedTuple):
    """A plane as ``land`` takes it; the distance is 0 at infinity, the axes are ``own_axes``."""

    distance: float
    vergence: float
    centre: Array
    tilt: Array
    axes: Array
    distortion: float


class Points(NamedTuple):
    """Points of a pupil, each for a ray of every pixel; shape (N,).

    Attributes:
        across: z, from -1 to 1.
        along: place on the chord, from 0 to 1.
        column: place on the pixel, of its side from the middle.
        row: the same.
        exact: whether shares come from the vignetting edge's closed form rather than from points.
    """

    across: Array
    along: Array
    column: Array
    row: Array
    exact: bool


class Rays(NamedTuple):
    """Rays of P pixels, N each; shape (N, P) unless said.

    Attributes:
        pupil_x: pupil point.
        pupil_y: the same along y.
        sensor_x: sensor point, mm from the micro-image's centre.
        sensor_y: the same along y.
        weight: what each counts, of white; over a pixel the sum is its share of the full cone.
        share: of the full cone, shape (P,).
    """

    pupil_x: Array
    pupil_y: Array
    sensor_x: Array
    sensor_y: Array
    weight: Array
    share: Array


def grid(side: int) -> Points:
    """A grid of so many points a side, the same in every pixel, at the pixel's centre."""
    middles = (np.arange(side) + 0.5) / side
    drawn = DRAWN[side - 1] if side <= len(DRAWN) else MORE_DRAWN
    across, along = np.meshgrid(drawn * (2 * middles - 1), middles, indexing="ij")
    still = np.zeros(side * side)
    return Points(across.ravel(), along.ravel(), still, still, True)


def shifted_grid(side: int, rng: np.random.Generator) -> Points:
    """A grid over the pupil for each quarter of the pixel, each shifted at random: an unbiased
    estimate of every pixel.
    """
    parts: list[Array] = []
    for column, row in ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)):
        first, second = rng.random(2)
        across, along = np.meshgrid(
            2 * ((np.arange(side) + first) / side) - 1, (np.arange(side) + second) / side
        )
        place = np.full(side * side, column), np.full(side * side, row)
        parts.append(np.stack([across.ravel(), along.ravel(), *place]))
    across, along, column, row = np.ascontiguousarray(np.concatenate(parts, axis=1))
    return Points(across, along, column, row, False)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lit_pixels(
    lens: Record, xs: Array, ys: Array, pixel: float, band: tuple[int, int]
) -> tuple[Whole, Whole]:
    """Rows and columns of the pixels in a band of rows that light of a microlens can reach."""
    first, end = max(lens.first_row, band[0]), min(lens.end_row, band[1])
    rows = np.empty(max(end - first, 0) * (lens.end_column - lens.first_column), dtype=np.int64)
    columns = np.empty_like(rows)
    reach, count = lens.reach + abs(lens.slope) + math.sqrt(0.5) * pixel, 0
    for row in range(first, end):
        for column in range(lens.first_column, lens.end_column):
            ex, ey = xs[column] - lens.x, ys[row] - lens.y
            if ex * ex + ey * ey < reach * reach:
                rows[count], columns[count] = row, column
                count += 1
    return rows[:count], columns[:count]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def rays_of(
    lens: Record, points: Points, sensor_x: Array, sensor_y: Array, pixel: float, weighted: bool
) -> Rays:
    """The rays of pixels through a microlens.

    Args:
        lens: the microlens.
        points: of its pupil.
        sensor_x: middles of the pixels, mm from the micro-image's centre, shape (P,).
        sensor_y: the same along y.
        pixel: side over which a pixel gathers light, mm.
        weighted: whether rays count by cos^4 of their slopes at the sensor.
    """
    count, pixels = points.across.size, sensor_x.size
    shape = (count, pixels)
    tx, ty, ex, ey = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    weight, share, whole = np.zeros(shape), np.zeros(pixels), np.zeros(pixels)
    slope = lens.slope
    if points.exact and 2 * abs(slope) < STEEP * pixel:  # the edge moves within the pixel
        slope = math.copysign(math.sqrt(slope * slope + pixel * pixel / 3), slope)
    for index in range(pixels):
        if points.exact:
            share[index] = share_over(
                sensor_x[index], sensor_y[index], pixel, lens.slope, lens.reach
            )
    for point in range(count):
        for index in range(pixels):
            x = sensor_x[index] + points.column[point] * pixel
            y = sensor_y[index] + points.row[point] * pixel
            away = math.sqrt(x * x + y * y)
            ex[point, index], ey[point, index] = x, y
            at_x, at_y, area = _pupil_point(
                away, slope, lens.reach, points.across[point], points.along[point]
            )
            cos, sin = (x / away, y / away) if away > 0.0 else (1.0, 0.0)
            tx[point, index] = at_x * cos - at_y * sin
            ty[point, index] = at_x * sin + at_y * cos
            weight[point, index] = area
            whole[index] += area
    for point in range(count):
        for index in range(pixels):
            if points.exact:
                area = whole[index]
                weight[point, index] *= share[index] / area if area > 0.0 else 0.0
            else:
                weight[point, index] /= count * math.pi
            if weighted:
                slant_x = lens.slant_x + lens.slant_scale * ex[point, index]
                slant_y = lens.slant_y + lens.slant_scale * ey[point, index]
                slant_x += lens.slant_spread * tx[point, index]
                slant_y += lens.slant_spread * ty[point, index]
                weight[point, index] /= (1.0 + slant_x * slant_x + slant_y * slant_y) ** 2
    return Rays(tx, ty, ex, ey, weight, share)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pupil_point(
    away: float, slope: float, reach: float, z: float, part: float
) -> tuple[float, float, float]:
    """A point of the part of the pupil seen from a distance, along the line through both centres
    and across it, and the area it stands for in the mean over z from -1 to 1 and chords.
    """
    off, radius = 0.0, 2.0
    if slope != 0.0:
        radius = reach / abs(slope)
        off = min(away / abs(slope), (radius + 1.0) * (1.0 - 1e-6))
    elif away > reach:
        return 0.0, 0.0, 0.0
    high = 1.0
    if off * off + 1.0 > radius * radius:
        corner = (1.0 + (off - radius) * (off + radius)) / (2.0 * off)
        high = math.sqrt(max(0.0, 1.0 - corner * corner))
    y = high * z * (3.0 - z * z) * 0.5
    own = math.sqrt(max(0.0, 1.0 - y * y))
    other = math.sqrt(max(0.0, radius * radius - y * y))
    left, right = max(-own, off - other), min(own, off + other)
    chord = max(0.0, right - left)
    x = left + part * chord
    sign = -1.0 if slope < 0.0 else 1.0
    return sign * x, sign * y, 3.0 * high * chord * (1.0 - z * z)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def aberrate(rays: Rays, lens: Record, gap: float, rim: float, marginal: float) -> None:
    """Put rays' sensor points, in place, where first order leads rays that land there by third: a
    ray through p radii ``rim`` of its microlens lands ``marginal`` |p|^2 p aside.
    """
    by_sensor, by_pupil = (1.0 - gap * lens.slant_scale) / rim, -gap * lens.slant_spread / rim
    for point in range(rays.weight.shape[0]):
        for index in range(rays.weight.shape[1]):
            x = by_sensor * rays.sensor_x[point, index] + by_pupil * rays.pupil_x[point, index]
            y = by_sensor * rays.sensor_y[point, index] + by_pupil * rays.pupil_y[point, index]
            rays.sensor_x[point, index] -= marginal * (x * x + y * y) * x
            rays.sensor_y[point, index] -= marginal * (x * x + y * y) * y


def flat_of(plane: Plane, distortion: Distortion | None) -> Flat:
    """A plane as ``land`` takes it."""
    away = plane.distance if math.isfinite(plane.distance) else 0.0
    coefficient = 0.0 if distortion is None else distortion.coefficient
    centre, tilt = (np.array(pair, dtype=np.float64) for pair in (plane.offset, plane.tilt))
    return Flat(away, 1 / plane.distance, centre, tilt, own_axes(plane), coefficient)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def land(lens: Record, plane: Flat, rays: Rays, moved: tuple[float, float]) -> tuple[Array, Array]:
    """Where rays meet a plane that has moved aside by so many mm, in the target's own axes; rad at
    infinity.

    Args:
        lens: the microlens, made for the plane's distance.
        plane: the plane.
        rays: the rays.
        moved: across the axis, mm.
    """
    u, v = np.empty_like(rays.weight), np.empty_like(rays.weight)
    x, y = plane.centre[0] + moved[0], plane.centre[1] + moved[1]
    tilt_x, tilt_y = plane.tilt[0], plane.tilt[1]
    xx, xy, yx, yy = plane.axes[0, 0], plane.axes[0, 1], plane.axes[1, 0], plane.axes[1, 1]
    for point in range(u.shape[0]):
        for index in range(u.shape[1]):
            ex, ey = rays.sensor_x[point, index], rays.sensor_y[point, index]
            tx, ty = rays.pupil_x[point, index], rays.pupil_y[point, index]
            aim_x = lens.spread * tx + lens.scale * ex + lens.direction_x
            aim_y = lens.spread * ty + lens.scale * ey + lens.direction_y
            bent = 1.0 + plane.distortion * (aim_x * aim_x + aim_y * aim_y)
            if plane.vergence == 0.0:
                at_x, at_y = bent * aim_x, bent * aim_y
            else:
                cross_x = lens.lens_spread * tx + lens.lens_scale * ex
                cross_y = lens.lens_spread * ty + lens.lens_scale * ey
                slope_x = plane.vergence * cross_x - bent * aim_x
                slope_y = plane.vergence * cross_y - bent * aim_y
                depth = plane.distance + tilt_x * (cross_x - x) + tilt_y * (cross_y - y)
                depth /= 1.0 + tilt_x * slope_x + tilt_y * slope_y
                at_x, at_y = cross_x - depth * slope_x - x, cross_y - depth * slope_y - y
            u[point, index] = xx * at_x + xy * at_y
            v[point, index] = yx * at_x + yy * at_y
    return u, v
