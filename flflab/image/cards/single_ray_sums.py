"""The kernel that sums single rays over the parts of pixels and over rows and columns of the lit
part of the pupil.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.rim import inside
from flflab.image.radiance.askew import radiance_askew
from flflab.image.radiance.neighbourhood import (
    DOTS,
    PICTURE,
    RULED,
    boxes_round,
    card_share,
    leads_alike,
    moves_little,
    radiance_round,
    seen_jointly,
    seen_on_card,
    way_round,
)
from flflab.image.radiance.parallelogram import stands_askew
from flflab.optics.discs import lens_rows, lens_strip, two_disc_area

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

COARSER = 4  # how much coarser than asked for a pixel is first summed
FEWEST_PARTS = (
    2  # of a pixel in a rim: with one or two of them rim and cards agree by chance too often
)
FEWEST_ROWS = (
    8  # with five and ten of them an edge between two rows was 0.004 of white off, and they agreed
)
# two of them, twice as many rows and a divided pixel each missed by chance a sliver of light past a
# card
FEWEST_CELLS = 4
# orders: parts of the pixel, rows of the pupil, cells of a row, moments of drift, of vibration
AXES = 5
MOST_CROSSED = 3  # cards whose edges are told apart within one neighbourhood


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ray_end(
    mx: float, my: float, ax: float, ay: float, vergence: float, surface: Array, coefficient: float
) -> tuple[float, float]:
    """Where a ray through (mx, my) of the main lens that heads for the direction a (seen from the
    lens, at a vergence) meets a surface.

    See ``flflab.image.geometry.rays`` for the formulas; the answer is in the surface's own axes.
    """
    distance = surface[0]
    ax += (surface[1] - vergence) * mx
    ay += (surface[1] - vergence) * my
    bend = 1.0 + coefficient * (ax * ax + ay * ay)
    x, y = ax * bend, ay * bend
    if surface[1] > 0.0:
        if surface[4] == 0.0 and surface[5] == 0.0:
            x = distance * x - surface[2]
            y = distance * y - surface[3]
        else:
            sx, sy = surface[1] * mx - x, surface[1] * my - y
            along = distance + surface[4] * (mx - surface[2]) + surface[5] * (my - surface[3])
            depth = along / (1.0 + surface[4] * sx + surface[5] * sy)
            x = mx - depth * sx - surface[2]
            y = my - depth * sy - surface[3]
    return surface[6] * x + surface[7] * y, surface[8] * x + surface[9] * y


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lit_share(away: float, slope: float, reach: float) -> float:
    """Share of the full cone at a sensor point."""
    if slope > 0.0:
        return two_disc_area(1.0, reach / slope, away / slope) / math.pi
    return 1.0 if away <= reach else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lit_rows(
    ex: float, ey: float, slope: float, reach: float
) -> tuple[float, float, float, float, float]:
    """The part of the pupil, a disc of radius 1, that lights a sensor point.

    Returns:
        Centre and radius of the circle that cuts it, of radius 2 about its middle where none does;
        lowest and highest y of the part.
    """
    x, y, other = 0.0, 0.0, 2.0
    if slope != 0.0 and ex * ex + ey * ey > max(0.0, reach - abs(slope)) ** 2:
        x, y, other = ex / slope, ey / slope, reach / abs(slope)
        shrink = min(1.0, (1.0 + other) * (1.0 - 1e-9) / math.sqrt(x * x + y * y))
        x *= shrink
        y *= shrink
    low, high = lens_rows(x, y, other)
    return x, y, other, low, high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _mean(
    ex: float,
    ey: float,
    rim: float,
    lens: Array,
    surfaces: Array,
    maps: Array,
    aligned: Chosen,
    places: Array,
    boxes: Array,
    parts: int,
    rows: int,
    cells: int,
    coefficient: float,
    falloff: bool,
    kind: int,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
) -> float:
    """Mean light over the part of the pupil that lights a sensor point; ``places`` and ``boxes``
    are scratch.

    ``rim`` is the side of the square round the point that a steep rim cuts, mm: for each ray of the
    whole pupil it cuts it elsewhere, and the light is the mean over the whole pupil and the square.
    0 where the rim cuts the pupil.
    """
    slope, reach = lens[2], lens[3]
    x, y, other, low, high = lit_rows(
        ex if rim == 0.0 else 0.0, ey if rim == 0.0 else 0.0, slope, reach
    )
    askew = kind in (DOTS, RULED, PICTURE) and stands_askew(maps[0])
    light, area, own = 0.0, 0.0, 0
    for row in range(
        rows
    ):  # of equal steps of an angle, for the rows' lengths rise from 0 like a circle's
        middle, ty, width, height = lens_strip(
            x, y, other, low, high, math.pi * row / rows, math.pi * (row + 1) / rows
        )
        if width <= 0.0:
            continue
        left = middle - 0.5 * width
        width /= cells
        for index in range(surfaces.shape[0]):
            boxes_round(maps[index], parts, width, height, boxes[index])
        for step in range(cells):
            tx = left + width * (step + 0.5)
            seen, own_share = 1.0, 1.0
            at_x, at_y = ex, ey
            if rim > 0.0:
                side = math.sqrt(
                    rim * rim + 0.5 * slope * slope * (width * width + height * height)
                )  # the cell's shadow beside the part
                seen, look = inside(ex - slope * tx, ey - slope * ty, side, reach)
                if seen == 0.0:
                    area += width * height
                    continue
                aside = (look - 1.0) * rim * rim / (side * side)
                at_x, at_y = ex + aside * (ex - slope * tx), ey + aside * (ey - slope * ty)
            mx, my = lens[4] * tx + lens[5] * at_x, lens[4] * ty + lens[5] * at_y
            ax, ay = (
                lens[6] * tx + lens[7] * at_x + lens[8],
                lens[6] * ty + lens[7] * at_y + lens[9],
            )
            crossed = 0
            for index in range(surfaces.shape[0] - 1, 0, -1):
                surface = surfaces[index]
                px, py = ray_end(mx, my, ax, ay, surfaces[0, 1], surface, coefficient)
                share = card_share(px, py, surface, boxes[index])
                if share == (0.0 if surface[12] > 0.0 else 1.0):
                    seen = 0.0
                    break
                if 0.0 < share < 1.0:
                    alike = aligned[index] and leads_alike(
                        maps[index], maps[0], parts, width, height
                    )
                    if surface[12] > 0.0:
                        own, own_share = index, share
                    elif (
                        crossed < MOST_CROSSED
                        and alike
                        and moves_little(boxes[index])
                        and moves_little(boxes[0])
                    ):
                        places[crossed, 0], places[crossed, 1], places[crossed, 2] = px, py, index
                        crossed += 1
                    else:
                        seen *= 1.0 - share
            if seen == 0.0:
                area += width * height
                continue
            px, py = ray_end(mx, my, ax, ay, surfaces[0, 1], surfaces[0], coefficient)
            if crossed > 0 and own_share < 1.0 and crossed < MOST_CROSSED:
                places[crossed, 0], places[crossed, 1], places[crossed, 2] = px, py, own
                crossed += 1
            elif crossed > 0:
                seen *= own_share
            if crossed > 0:
                seen *= seen_jointly(
                    px,
                    py,
                    surfaces,
                    maps,
                    places,
                    boxes[surfaces.shape[0]],
                    crossed,
                    parts,
                    width,
                    height,
                    kind,
                    numbers,
                    table,
                    law,
                    sums,
                )
            elif own_share < 1.0:
                seen *= seen_on_card(
                    px,
                    py,
                    surfaces[own],
                    boxes[0],
                    boxes[surfaces.shape[0]],
                    kind,
                    numbers,
                    table,
                    law,
                    sums,
                )
            elif askew:
                seen *= radiance_askew(
                    px, py, maps[0], boxes[0], parts, width, height, kind, numbers, table, law, sums
                )
            else:
                seen *= radiance_round(px, py, boxes[0], kind, numbers, table, law, sums)
            area += width * height
            if falloff and seen > 0.0:
                sx = lens[11] + lens[13] * at_x + lens[14] * tx
                sy = lens[12] + lens[13] * at_y + lens[14] * ty
                seen /= (1.0 + sx * sx + sy * sy) ** 2
            light += width * height * seen
    return light / area if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pixel_light(
    dx: float,
    dy: float,
    lens: Array,
    surfaces: Array,
    maps: Array,
    aligned: Chosen,
    places: Array,
    boxes: Array,
    moved: Array,
    orders: Whole,
    steep: bool,
    motion: Array,
    coefficient: float,
    falloff: bool,
    pixel_width: float,
    kind: int,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
) -> float:
    """Mean light of a pixel at (dx, dy) from a micro-image's centre, summed with these orders along
    the ``AXES``; see ``add_rays``.
    """
    parts, rows, cells, drifts, swings = orders[0], orders[1], orders[2], orders[3], orders[4]
    part = pixel_width / parts
    slope, reach = abs(lens[2]), lens[3]
    light = 0.0
    for index in range(surfaces.shape[0]):
        way_round(surfaces[index], motion, drifts, swings, boxes[index])
    for moment in range(drifts * swings):
        at = (moment % drifts + 0.5) / drifts - 0.5
        sway = math.cos(math.pi * (moment // drifts + 0.5) / swings) if swings > 1 else 0.0
        for index in range(surfaces.shape[0]):
            moved[index, 2] = surfaces[index, 2] + at * motion[0, 0] + sway * motion[1, 0]
            moved[index, 3] = surfaces[index, 3] + at * motion[0, 1] + sway * motion[1, 1]
        for j in range(parts):
            y = dy + ((j + 0.5) / parts - 0.5) * pixel_width
            for i in range(parts):
                x = dx + ((i + 0.5) / parts - 0.5) * pixel_width
                away = math.sqrt(x * x + y * y)
                rim = 0.0
                if away + part + slope < reach:
                    share = 1.0
                elif steep and part > 0.0:
                    share, rim = (0.0 if away > reach + slope + part else 1.0), part
                else:
                    share = lit_share(away, slope, reach)
                if share > 0.0:
                    light += share * _mean(
                        x,
                        y,
                        rim,
                        lens,
                        moved,
                        maps,
                        aligned,
                        places,
                        boxes,
                        parts,
                        rows,
                        cells,
                        coefficient,
                        falloff,
                        kind,
                        numbers,
                        table,
                        law,
                        sums,
                    )
    return light / (parts * parts * drifts * swings)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _first_orders(most: Whole, fewest: Whole, whole: bool, along: bool, orders: Whole) -> None:
    """With what a pixel is first summed: a whole one in the bright field undivided, rows along all
    surfaces' axes in few cells.

    Between two rows aslant an edge moves by more than a cell: few cells and few rows err, and no
    more of either alone shows it.
    """
    orders[0] = 1 if whole else max((most[0] + COARSER - 1) // COARSER, min(most[0], FEWEST_PARTS))
    orders[1] = max((most[1] + COARSER - 1) // COARSER, min(most[1], FEWEST_ROWS))
    orders[2] = min(most[2], FEWEST_CELLS) if along else orders[1]
    orders[3:] = fewest


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_rays(
    image: Array,
    band: tuple[int, int],
    windows: Whole,
    lenses: Array,
    surfaces: Array,
    maps: Array,
    aligned: Chosen,
    along: Chosen,
    orders: Whole,
    moments: Whole,
    steep: Chosen,
    enough: Array,
    motion: Array,
    coefficient: float,
    falloff: bool,
    xs: Array,
    ys: Array,
    pixel: float,
    pixel_width: float,
    kind: int,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
    wanted: Chosen,
) -> None:
    """Add the light of all windows to the rows of a band; see ``add_single_rays``.

    ``orders`` are the most along each of the ``AXES`` for each window; a pixel's are doubled, each
    for itself, until that changes it by less than is ``enough`` for the window. ``moments`` are
    those of drift and of vibration to begin with. Where ``steep``, the rim cuts the parts of a
    pixel, for each ray elsewhere; else it cuts the pupil that a part looks through. Where
    ``along``, rows and columns of the pupil run along the axes of target and cards.
    """
    places, boxes, moved = (
        np.empty((MOST_CROSSED, 7)),
        np.zeros((surfaces.shape[0] + 1, 8)),
        surfaces.copy(),
    )
    now, seen, gains = np.empty(AXES, dtype=np.int64), np.empty(AXES), np.empty(AXES)
    rough = np.zeros(AXES, dtype=np.bool_)
    for entry in range(windows.shape[0]):
        lens, most = lenses[entry], orders[entry]
        for row in range(max(band[0], windows[entry, 2]), min(band[1], windows[entry, 3])):
            for column in range(windows[entry, 0], windows[entry, 1]):
                if wanted.shape[0] > 0 and not wanted[row, column]:
                    continue
                dx, dy = xs[column] - lens[0], ys[row] - lens[1]
                away = math.hypot(dx, dy)
                if away > lens[3] + abs(lens[2]) + pixel:
                    continue
                _first_orders(
                    most,
                    moments[entry],
                    away + 0.75 * pixel < lens[3] - abs(lens[2]),
                    along[entry],
                    now,
                )
                first, settled, refined = 0.0, False, AXES
                while not settled:
                    known = refined == 1  # the one step taken was looked at before
                    for axis in range(
                        -1, AXES
                    ):  # with the orders as they are, then with twice the orders along each axis
                        before = now[max(axis, 0)]
                        if axis >= 0:
                            now[axis] = min(2 * before, most[axis])
                            if now[axis] == before:
                                gains[axis] = 0.0
                                continue
                        elif known:
                            continue
                        light = lens[10] * _pixel_light(
                            dx,
                            dy,
                            lens,
                            surfaces,
                            maps[entry],
                            aligned[entry],
                            places,
                            boxes,
                            moved,
                            now,
                            steep[entry],
                            motion,
                            coefficient,
                            falloff,
                            pixel_width,
                            kind,
                            numbers,
                            table,
                            law,
                            sums,
                        )
                        if axis < 0:
                            first = light
                            continue
                        now[axis] = before
                        seen[axis], gains[axis] = light, light - first
                        rough[axis] = abs(gains[axis]) > enough[entry]
                    refined = 0
                    for axis in range(AXES):
                        if rough[axis]:
                            now[axis], rough[axis], refined = (
                                min(2 * now[axis], most[axis]),
                                False,
                                refined + 1,
                            )
                            gains[axis], first = 0.0, seen[axis]
                    settled = refined == 0
                image[row, column] += first + gains.sum()
