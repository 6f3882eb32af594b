"""The kernel that sums single rays over the parts of pixels and over rows and columns of the lit part of the pupil."""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.neighbourhood import boxes_round, card_share, radiance_round, seen_jointly
from flflab.image.rim import lit_middle, steep_share
from flflab.optics.discs import lens_chord, lens_rows, two_disc_area

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

STEEP = 6.0  # a rim narrower than this many parts of a pixel is averaged over them
MOST_CROSSED = 3  # cards whose edges are told apart within one neighbourhood


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _end(mx: float, my: float, ax: float, ay: float, vergence: float, surface: Array, coefficient: float) -> tuple[float, float]:
    """Where a ray through (mx, my) of the main lens that heads for the direction a (seen from the lens, at a vergence) meets a surface.

    See ``flflab.image.rays`` for the formulas; the answer is in the surface's own axes.
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
def _lit_share(away: float, slope: float, reach: float) -> float:
    """Share of the full cone at a sensor point."""
    if slope > 0.0:
        return two_disc_area(1.0, reach / slope, away / slope) / math.pi
    return 1.0 if away <= reach else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _mean(
    ex: float,
    ey: float,
    lens: Array,
    surfaces: Array,
    maps: Array,
    aligned: Chosen,
    places: Array,
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
    """Mean light over the part of the pupil that lights a sensor point."""
    slope, reach = lens[2], lens[3]
    x, y, other = 0.0, 0.0, 2.0
    if slope != 0.0 and ex * ex + ey * ey > max(0.0, reach - abs(slope)) ** 2:
        x, y, other = ex / slope, ey / slope, reach / abs(slope)
        shrink = min(1.0, (1.0 + other) * (1.0 - 1e-9) / math.sqrt(x * x + y * y))
        x *= shrink
        y *= shrink
    low, high = lens_rows(x, y, other)
    light = 0.0
    area = 0.0
    for row in range(rows):  # of equal steps of an angle, for the rows' lengths rise from 0 like a circle's
        angle = math.pi * (row + 0.5) / rows
        ty = 0.5 * (low + high) - 0.5 * (high - low) * math.cos(angle)
        height = 0.5 * (high - low) * math.sin(angle) * math.pi / rows
        left, right = lens_chord(x, y, other, ty)
        if right <= left:
            continue
        width = (right - left) / rows
        for step in range(rows):
            tx = left + width * (step + 0.5)
            mx, my = lens[4] * tx + lens[5] * ex, lens[4] * ty + lens[5] * ey
            ax, ay = lens[6] * tx + lens[7] * ex + lens[8], lens[6] * ty + lens[7] * ey + lens[9]
            seen = 1.0
            crossed = 0
            for index in range(surfaces.shape[0] - 1, 0, -1):
                surface = surfaces[index]
                px, py = _end(mx, my, ax, ay, surfaces[0, 1], surface, coefficient)
                by = maps[index]
                box_x, box_y = boxes_round(by, parts, width, height)
                share = card_share(px, py, surface, box_x, box_y)
                if share == (0.0 if surface[12] > 0.0 else 1.0):
                    seen = 0.0
                    break
                if 0.0 < share < 1.0:
                    if crossed < MOST_CROSSED and aligned[index]:
                        places[crossed, 0], places[crossed, 1], places[crossed, 2] = px, py, index
                        crossed += 1
                    else:
                        seen *= share if surface[12] > 0.0 else 1.0 - share
            if seen == 0.0:
                area += width * height
                continue
            px, py = _end(mx, my, ax, ay, surfaces[0, 1], surfaces[0], coefficient)
            if crossed == 0:
                by = maps[0]
                box_x, box_y = boxes_round(by, parts, width, height)
                seen *= radiance_round(px, py, box_x, box_y, kind, numbers, table, law, sums)
            else:
                seen *= seen_jointly(px, py, surfaces, maps, places, crossed, parts, width, height, kind, numbers, table, law, sums)
            area += width * height
            if falloff and seen > 0.0:
                sx = lens[11] + lens[13] * ex + lens[14] * tx
                sy = lens[12] + lens[13] * ey + lens[14] * ty
                seen /= (1.0 + sx * sx + sy * sy) ** 2
            light += width * height * seen
    return light / area if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_rays(
    image: Array,
    band: tuple[int, int],
    windows: Whole,
    lenses: Array,
    surfaces: Array,
    maps: Array,
    aligned: Chosen,
    parts: Whole,
    rows: Whole,
    coefficient: float,
    falloff: bool,
    nodes: Array,
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
    """Add the light of all windows to the rows of a band; see ``add_single_rays``."""
    places = np.empty((MOST_CROSSED, 3))
    for entry in range(windows.shape[0]):
        lens, count = lenses[entry], parts[entry]
        part = pixel_width / count
        slope, reach = abs(lens[2]), lens[3]
        for row in range(max(band[0], windows[entry, 2]), min(band[1], windows[entry, 3])):
            for column in range(windows[entry, 0], windows[entry, 1]):
                if wanted.shape[0] > 0 and not wanted[row, column]:
                    continue
                dx, dy = xs[column] - lens[0], ys[row] - lens[1]
                if math.hypot(dx, dy) > reach + slope + pixel:
                    continue
                light = 0.0
                for j in range(count):
                    y = dy + ((j + 0.5) / count - 0.5) * pixel_width
                    for i in range(count):
                        x = dx + ((i + 0.5) / count - 0.5) * pixel_width
                        away = math.sqrt(x * x + y * y)
                        look = 1.0
                        if part > 0.0 and 2.0 * slope < STEEP * part:
                            share = steep_share(x, y, part, lens[2], reach, nodes)
                            look = lit_middle(away, part, reach)
                        else:
                            share = _lit_share(away, slope, reach)
                        if share > 0.0:
                            light += share * _mean(
                                look * x,
                                look * y,
                                lens,
                                surfaces,
                                maps[entry],
                                aligned[entry],
                                places,
                                count,
                                rows[entry],
                                coefficient,
                                falloff,
                                kind,
                                numbers,
                                table,
                                law,
                                sums,
                            )
                image[row, column] += lens[10] * light / (count * count)
