"""Light of micro-images whose rays all pass but end crookedly: that of linear maps, and what the
bends change of it, ray by ray.

The bends change little, so that few rays tell by how much: each is followed to where it ends and to
where the map says, and the difference of what its neighbourhood sees there is summed over the lit
part of the pupil. Bars, dots and motion stay exact.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.cards.single_ray_sums import lit_rows, lit_share, ray_end
from flflab.image.cards.surfaces import lens_numbers, surface_numbers
from flflab.image.cards.windows import Card
from flflab.image.effects.distortion import Distortion
from flflab.image.flat_target.moving import add_moving_plane
from flflab.image.geometry.rays import Landing, land
from flflab.image.geometry.setup import Setup
from flflab.image.geometry.tiles import RIM, middles
from flflab.image.light.orders import in_bands
from flflab.image.radiance.askew import radiance_askew
from flflab.image.radiance.neighbourhood import (
    DOTS,
    PICTURE,
    RULED,
    boxes_round,
    described,
    radiance_round,
    way_round,
)
from flflab.image.radiance.parallelogram import stands_askew
from flflab.image.scene import Plane
from flflab.optics.camera import pixel_positions
from flflab.optics.discs import lens_strip

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

BAND = 8  # rows that a core sums at a time
# What few rays leave of the most that bends change, measured on all kinds of targets in blurs of
# 0.3 to 43 pixels:
# times the square of the number of rows, as many cells in each, in blurs from WIDE pixels on; the
# less the less blur
ROWS_LEAVE = 8.0
PARTS_LEAVE = 0.25  # times the square of the number of parts a side of a pixel in a rim
WIDE = 6.0
SHARE = 0.15  # of the tolerance, for either
MOST_ROWS, MOST_PARTS = 96, 32


def add_bent(
    image: Array,
    setup: Setup,
    plane: Plane,
    distortion: Distortion | None,
    wanted: Chosen | None = None,
) -> None:
    """Add the light of a plane that no card hides, whose rays end where no linear map says.

    Args:
        image: picture to add to, [row, column], in units of the white level.
        setup: made for the plane.
        plane: the target.
        distortion: of the main lens.
        wanted: the pixels to compute; None for all.
    """
    if not len(setup.blur):
        return
    add_moving_plane(image, setup, plane.target, wanted)
    sensor, pupils = setup.sensor, setup.pupils
    pixel = setup.pixel_width
    maps = np.column_stack(
        [setup.origin, setup.by_pupil.reshape(-1, 4), setup.by_sensor.reshape(-1, 4)]
    )
    sides = np.column_stack([setup.by_pupil.reshape(-1, 4), setup.by_sensor.reshape(-1, 4) * pixel])
    orders = _orders(setup, _bent(setup, plane, distortion))
    surface, kinds = surface_numbers(Card(plane, False)), described(plane.target)
    motion = (
        np.zeros((2, 2))
        if setup.motion is None
        else np.array([setup.motion.drift, setup.motion.vibration])
    )
    coefficient = 0.0 if distortion is None else distortion.coefficient
    chosen = np.zeros((0, 0), dtype=np.bool_) if wanted is None else wanted
    known, places = lens_numbers(pupils), pixel_positions(sensor)

    def add(band: tuple[int, int]) -> None:
        add_bends(
            image,
            band,
            setup.window,
            known,
            surface,
            maps,
            sides,
            orders,
            motion,
            coefficient,
            setup.falloff,
            *places,
            pixel,
            *kinds,
            chosen,
        )

    in_bands(add, setup.window, BAND)


def _bent(setup: Setup, plane: Plane, distortion: Distortion | None) -> Array:
    """The most that the bends change of a sharp edge's picture, of white, shape (N,)."""
    middle = middles(setup.sensor, setup.pupils, setup.window)[0][:, None]
    by_map = Landing(setup.origin, setup.by_pupil, setup.by_sensor, setup.by_motion)
    truth = land(setup.pupils, plane, distortion, RIM[None], middle)
    return by_map.error(by_map.at(RIM[None], middle), truth, setup.sensor.pixel)


def _orders(setup: Setup, bent: Array) -> Whole:
    """Parts a side of a pixel in a rim, and rows of the pupil, for each entry, shape (N, 2)."""
    demand = bent / (
        SHARE * setup.tolerance / np.sqrt(setup.overlap)
    )  # errors of either sign on the way
    parts = np.clip(
        np.ceil(np.sqrt(PARTS_LEAVE * demand)), 2, MOST_PARTS if setup.pixel_width > 0 else 2
    )
    rows = np.clip(
        np.ceil(np.sqrt(ROWS_LEAVE * np.minimum(setup.blur / WIDE, 1.0) * demand)), 2, MOST_ROWS
    )
    return np.column_stack([parts if setup.pixel_width > 0 else np.ones_like(parts), rows]).astype(
        np.int64
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bend_mean(
    ex: float,
    ey: float,
    lens: Array,
    surface: Array,
    to: Array,
    by: Array,
    boxes: Array,
    parts: int,
    rows: int,
    coefficient: float,
    falloff: bool,
    kind: int,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
) -> float:
    """What the bends change of the mean light over the part of the pupil that lights a sensor
    point.
    """
    slope, reach = lens[2], lens[3]
    x, y, other, low, high = lit_rows(ex, ey, slope, reach)
    askew = kind in (DOTS, RULED, PICTURE) and stands_askew(by)
    at_x, at_y = to[0] + to[6] * ex + to[7] * ey, to[1] + to[8] * ex + to[9] * ey
    light, area = 0.0, 0.0
    for row in range(rows):
        middle, ty, width, height = lens_strip(
            x, y, other, low, high, math.pi * row / rows, math.pi * (row + 1) / rows
        )
        if width <= 0.0:
            continue
        width /= rows
        boxes_round(by, parts, width, height, boxes)
        for step in range(rows):
            tx = middle + width * (step + 0.5 - 0.5 * rows)
            mx, my = lens[4] * tx + lens[5] * ex, lens[4] * ty + lens[5] * ey
            ax, ay = lens[6] * tx + lens[7] * ex + lens[8], lens[6] * ty + lens[7] * ey + lens[9]
            px, py = ray_end(mx, my, ax, ay, surface[1], surface, coefficient)
            qx, qy = at_x + to[2] * tx + to[3] * ty, at_y + to[4] * tx + to[5] * ty
            if askew:
                change = radiance_askew(
                    px, py, by, boxes, parts, width, height, kind, numbers, table, law, sums
                )
                change -= radiance_askew(
                    qx, qy, by, boxes, parts, width, height, kind, numbers, table, law, sums
                )
            else:
                change = radiance_round(px, py, boxes, kind, numbers, table, law, sums)
                change -= radiance_round(qx, qy, boxes, kind, numbers, table, law, sums)
            area += width * height
            if falloff:
                sx, sy = (
                    lens[11] + lens[13] * ex + lens[14] * tx,
                    lens[12] + lens[13] * ey + lens[14] * ty,
                )
                change /= (1.0 + sx * sx + sy * sy) ** 2
            light += width * height * change
    return light / area if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_bends(
    image: Array,
    band: tuple[int, int],
    windows: Whole,
    lenses: Array,
    surface: Array,
    maps: Array,
    sides: Array,
    orders: Whole,
    motion: Array,
    coefficient: float,
    falloff: bool,
    xs: Array,
    ys: Array,
    pixel: float,
    kind: int,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
    wanted: Chosen,
) -> None:
    """Add what the bends change to the rows of a band; see ``add_bent``.

    Args:
        image: picture to add to, [row, column].
        band: first row, and row after the last.
        windows: of each entry, (N, 4).
        lenses: see ``lens_numbers``.
        surface: see ``surface_numbers``.
        maps: linear maps to the target, (N, 10): origin, by pupil, by sensor, row by row.
        sides: the same by pupil, and by sensor for the side of a pixel, (N, 8).
        orders: parts a side of a pixel in a rim, and rows of the pupil; (N, 2).
        motion: drift and vibration, mm.
        coefficient: of the distortion.
        falloff: whether rays count by cos^4 of their slopes at the sensor.
        xs: places of columns on the sensor, mm.
        ys: the same of rows.
        pixel: side of the square over which a pixel gathers light, mm.
        kind: of the target, see ``described``.
        numbers: the same.
        table: the same.
        law: the same.
        sums: the same.
        wanted: the pixels to compute; an empty array for all.
    """
    boxes = np.zeros(8)
    way_round(surface, motion, 1, 1, boxes)
    for entry in range(windows.shape[0]):
        lens = lenses[entry]
        slope, reach = abs(lens[2]), lens[3]
        for row in range(max(band[0], windows[entry, 2]), min(band[1], windows[entry, 3])):
            for column in range(windows[entry, 0], windows[entry, 1]):
                if wanted.shape[0] > 0 and not wanted[row, column]:
                    continue
                dx, dy = xs[column] - lens[0], ys[row] - lens[1]
                away = math.hypot(dx, dy)
                if away > reach + slope + pixel:
                    continue
                parts = 1 if away + 0.75 * pixel < reach - slope else orders[entry, 0]
                light = 0.0
                for part in range(parts * parts):
                    x = dx + ((part % parts + 0.5) / parts - 0.5) * pixel
                    y = dy + ((part // parts + 0.5) / parts - 0.5) * pixel
                    share = lit_share(math.hypot(x, y), slope, reach)
                    if share > 0.0:
                        light += share * _bend_mean(
                            x,
                            y,
                            lens,
                            surface,
                            maps[entry],
                            sides[entry],
                            boxes,
                            parts,
                            orders[entry, 1],
                            coefficient,
                            falloff,
                            kind,
                            numbers,
                            table,
                            law,
                            sums,
                        )
                image[row, column] += lens[10] * light / (parts * parts)
