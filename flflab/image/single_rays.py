"""Light of pixels whose rays do not all fare alike: past the edges of cards, or too crooked for a linear map; summed ray by ray.

Over the pixel's parts and over rows and columns of the lit part of the pupil, each ray stands for its neighbourhood: steps of target
and cards are smoothed by what a part of the pixel and a cell of the pupil cover there.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.cards import Card, pupils_before
from flflab.image.effects.distortion import Distortion
from flflab.image.neighbourhood import card_share, described, radiance_round, seen_jointly, two_boxes
from flflab.image.orders import in_bands
from flflab.image.rays import linearised, own_axes
from flflab.image.rim import disc_nodes, lit_middle, steep_share
from flflab.image.scene import Plane
from flflab.image.setup import Setup
from flflab.image.tiles import blur_of, middles
from flflab.optics.camera import pixel_positions
from flflab.optics.discs import lens_chord, lens_rows, two_disc_area
from flflab.targets import White

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

STEEP = 6.0  # a rim narrower than this many parts of a pixel is averaged over them
MOST_PARTS = 8
MOST_ROWS = 96
MOST_CROSSED = 3  # cards whose edges are told apart within one neighbourhood
SKEW = 0.2  # angle, in rad, above which edges of cards and targets do not count as parallel
TURNED_ERROR = 0.1  # error, of white, times the square of the number of parts, where the edges of two surfaces cross under an angle
ROWS_ERROR = 0.6  # twice the error, of white, times the square of the number of rows; measured on dots, pictures, edges and bars


def add_single_rays(
    image: Array,
    setup: Setup,
    plane: Plane,
    distortion: Distortion | None,
    cards: tuple[Card, ...],
    wanted: Chosen | None = None,
) -> None:
    """Add the light of a plane to the pixels of the setup's windows.

    Args:
        image: picture to add to, [row, column], in units of the white level.
        setup: made for the plane; its maps are not used.
        plane: the target.
        distortion: of the main lens.
        cards: those that stop rays.
        wanted: the pixels to compute; None for all.
    """
    if not len(setup.blur):
        return
    pupils, pixel = setup.pupils, setup.sensor.pixel
    middle = middles(setup.sensor, pupils, setup.window)[0]
    surfaces = np.array([_surface(Card(plane, False)), *(_surface(card) for card in cards)])
    maps = np.empty((len(setup.blur), len(surfaces), 8))
    blurs = np.zeros((len(setup.blur), len(surfaces)))
    for index, before in enumerate((plane, *(card.plane for card in cards))):
        landing = linearised(pupils_before(pupils, 1 / plane.distance, 1 / before.distance), before, distortion, middle)
        maps[:, index, :4] = landing.by_pupil.reshape(-1, 4)
        maps[:, index, 4:] = landing.by_sensor.reshape(-1, 4) * setup.pixel_width
        blurs[:, index] = blur_of(landing.by_pupil, landing.by_sensor, pixel)
    width = np.maximum(2 * np.abs(pupils.slope) / pixel, 1e-9)
    tolerance, blur = setup.tolerance / setup.overlap, blurs.max(axis=1)
    steps = np.array([not (isinstance(plane.target, White) and card.own) for card in cards], dtype=np.float64)
    change = 0.34 / width + 0.25 * (steps / np.maximum(blurs[:, 1:], 1.0)).sum(axis=1)  # of rim and cards within a pixel, against a step
    parts = np.clip(np.ceil(np.sqrt(change / (tolerance * np.sqrt(np.maximum(blurs[:, 0], 1.0))))), 1, MOST_PARTS)
    parts = np.where(width * parts < STEEP, MOST_PARTS, parts)
    by_pupil, by_sensor = np.linalg.norm(maps[:, :, :4], axis=2), np.linalg.norm(maps[:, :, 4:], axis=2)
    turned = _turned(np.where((by_sensor >= by_pupil)[:, :, None], maps[:, :, 4:], maps[:, :, :4]))
    crossing = (turned & (by_sensor >= by_pupil)).any(axis=1)
    parts = np.where(crossing, np.maximum(parts, np.minimum(np.ceil(np.sqrt(TURNED_ERROR / tolerance)), MOST_PARTS)), parts)
    rows = ROWS_ERROR * np.minimum(blur / 3, 1.0) / tolerance
    if setup.falloff:  # rays count by a square of their slope
        rows = np.maximum(rows, 8 * pupils.slant_spread**2 / tolerance)
    rows = np.clip(np.ceil(np.sqrt(rows)), np.where(blur == 0, 1, 2), MOST_ROWS)
    if setup.pixel_width == 0:
        parts = np.ones_like(parts)
    leads = by_sensor / parts[:, None] >= by_pupil * (2 / rows)[:, None]
    aligned: Chosen = (leads == leads[:, :1]) & ~turned
    known = np.column_stack(
        [
            pupils.centre_x,
            pupils.centre_y,
            pupils.slope,
            pupils.reach,
            pupils.lens_spread,
            pupils.lens_scale,
            pupils.spread,
            pupils.scale,
            pupils.direction_x,
            pupils.direction_y,
            pupils.level,
            pupils.slant_x,
            pupils.slant_y,
            pupils.slant_scale,
            pupils.slant_spread,
        ]
    )
    kind, numbers, table, law, sums = described(plane.target)
    xs, ys = pixel_positions(setup.sensor)
    coefficient = 0.0 if distortion is None else distortion.coefficient
    chosen = np.zeros((0, 0), dtype=np.bool_) if wanted is None else wanted
    nodes = disc_nodes(8, 8)

    def add(band: tuple[int, int]) -> None:
        _add(
            image,
            band,
            setup.window,
            known,
            surfaces,
            maps,
            aligned,
            parts.astype(np.int64),
            rows.astype(np.int64),
            coefficient,
            setup.falloff,
            nodes,
            xs,
            ys,
            pixel,
            setup.pixel_width,
            kind,
            numbers,
            table,
            law,
            sums,
            chosen,
        )

    in_bands(add, setup.window)


def _turned(maps: Array) -> Chosen:
    """Whether the axes of each surface do not count as parallel to the target's, the first one's; maps (T, K, 4), answer (T, K)."""
    rows = maps.reshape(*maps.shape[:2], 2, 2)
    rows = rows / np.maximum(np.linalg.norm(rows, axis=3, keepdims=True), 1e-300)
    first = rows[:, :1]
    aside = np.maximum(np.abs((rows[:, :, 0] * first[:, :, 1]).sum(axis=2)), np.abs((rows[:, :, 1] * first[:, :, 0]).sum(axis=2)))
    return np.any(aside[:, :, None] > SKEW, axis=2, keepdims=False)


def _surface(card: Card) -> Array:
    """A plane as numbers: distance, vergence, offset, tilt, own axes, half its card's size, whether rays must end on the card."""
    plane = card.plane
    size = plane.size or (math.inf, math.inf)
    return np.array(
        [
            plane.distance,
            1 / plane.distance,
            *plane.offset,
            *plane.tilt,
            *own_axes(plane).ravel(),
            size[0] / 2,
            size[1] / 2,
            float(card.own),
        ]
    )


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
                box_x = two_boxes(by[4] / parts, by[5] / parts, by[0] * width, by[1] * height)
                box_y = two_boxes(by[6] / parts, by[7] / parts, by[2] * width, by[3] * height)
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
                box_x = two_boxes(by[4] / parts, by[5] / parts, by[0] * width, by[1] * height)
                box_y = two_boxes(by[6] / parts, by[7] / parts, by[2] * width, by[3] * height)
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
def _add(
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
