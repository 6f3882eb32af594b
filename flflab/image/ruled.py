"""Images of targets that vary along one direction (bars, chirp), end at a straight line (edge), or are plain white.

The radiance is profile(x') times a window in y', where x' and y' are target axes turned as the target asks. Over the pupil, strips
along the gradient of x' are summed; along each strip the mean of the profile is exact, and so is the mean over the pixel.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.profile import profile_mean
from flflab.image.rim import lit_middle, rim_share, steep_share
from flflab.image.strips import clipped_mean, full_mean, lens_span, prepare, slanted_mean, weighted_mean, window_mean
from flflab.optics.discs import lens_chord

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

WIDE = 10.0  # half the width in pixels of a rim whose shape within a pixel does not matter
GAUSS = ((-math.sqrt(0.6), 5 / 18), (0.0, 8 / 18), (math.sqrt(0.6), 5 / 18))  # on a chord from -1 to 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def shrink(wanted: Chosen, start: int, end: int, first: int, last: int) -> tuple[int, int, int, int]:
    """The smallest part of a window of columns and rows that holds all its wanted pixels."""
    left, right, bottom, top = end, start, last, first
    for row in range(first, last):
        for column in range(start, end):
            if wanted[row, column]:
                left, right = min(left, column), max(right, column + 1)
                bottom, top = min(bottom, row), max(top, row + 1)
    return left, right, bottom, top


@numba.njit(cache=True, nogil=True, error_model="numpy")
def clip(ex: float, ey: float, along_x: float, along_y: float, slope: float, reach: float) -> tuple[float, float, float, float]:
    """Where the wider aperture's shadow lies over the pupil, seen from a sensor point (mm) along the strips and across, and its span.

    A pixel whose centre is dark but whose edge is lit gets the last sliver of the pupil.
    """
    away = math.sqrt(ex * ex + ey * ey)
    size = abs(slope)
    if size == 0.0 or away <= reach - size:
        return 0.0, 0.0, -1.0, 1.0
    inward = min(1.0, (reach + size) * (1.0 - 1e-9) / away) / slope
    x, y = (along_x * ex + along_y * ey) * inward, (along_x * ey - along_y * ex) * inward
    low, high = lens_span(x, y, reach / size)
    return x, y, low, high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_weight(
    x: float,
    y: float,
    radius: float,
    low: float,
    high: float,
    strips: Array,
    count: int,
    slant: tuple[float, float, float],
) -> float:
    """Mean of cos^4 of the slope at the sensor over the pupil from ``low`` to ``high`` inside the disc at (x, y).

    ``slant`` is the slope of the ray through the pupil's centre along the strips and across them, and its change over the radius.
    """
    light, area = 0.0, 0.0
    for strip in range(count):
        at = 0.5 * (low + high) + 0.5 * (high - low) * strips[0, strip]
        start, end = lens_chord(x, y, radius, at)
        if end <= start:
            continue
        weight = strips[1, strip] * (end - start)
        across = slant[1] + slant[2] * at
        area += weight
        for node, share in GAUSS:
            along = slant[0] + 0.5 * slant[2] * ((end + start) + (end - start) * node)
            light += weight * share / (1.0 + along * along + across * across) ** 2
    return light / area if area > 0.0 else 1.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_weights(
    left: float,
    bottom: float,
    step: float,
    weights: Array,
    slope: float,
    reach: float,
    slants: Array,
    strips: Array,
    count: int,
) -> None:
    """The same at sensor points ``step`` mm apart from (left, bottom) on, into ``weights`` [row, column]."""
    radius = reach / abs(slope) if slope != 0.0 else 2.0
    for row in range(weights.shape[0]):
        for column in range(weights.shape[1]):
            ex, ey = left + column * step, bottom + row * step
            x, y, low, high = clip(ex, ey, 1.0, 0.0, slope, reach)
            slant = (slants[0] + slants[2] * ex, slants[1] + slants[2] * ey, slants[3])
            weights[row, column] = mean_weight(x, y, radius, low, high, strips, count, slant)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def between(column: float, row: float, weights: Array) -> float:
    """A table [row, column] between its places."""
    i, j = int(column), int(row)
    u, v = column - i, row - j
    low = (1.0 - u) * weights[j, i] + u * weights[j, i + 1]
    return (1.0 - v) * low + v * ((1.0 - u) * weights[j + 1, i] + u * weights[j + 1, i + 1])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_ruled(
    image: Array,
    rows: tuple[int, int],
    windows: Whole,
    kinds: Whole,
    centres: Array,
    cones: Array,
    maps: Array,
    slants: Array,
    levels: Array,
    sharp: Chosen,
    parts: Whole,
    counts: Whole,
    strips: Array,
    chunks: int,
    steps: int,
    rims: Array,
    nodes: Array,
    xs: Array,
    ys: Array,
    pixel: float,
    width: float,
    fine: float,
    table: Array,
    law: Array,
    bounds: Array,
    wanted: Chosen,
) -> None:
    """Add the light of every entry to the rows from rows[0] to below rows[1] of an image.

    Args:
        image: picture to add to, [row, column].
        rows: the band.
        windows: first column, column after the last, first row, row after the last, of every entry; shape (N, 4).
        kinds: kind of rim of every entry.
        centres: centre of every micro-image, mm, shape (N, 2).
        cones: slope and reach of every entry, mm, shape (N, 2).
        maps: x', y' = (0, 1) + [[2, 3], [4, 5]] pupil + [[6, 7], [8, 9]] sensor, target mm, shape (N, 10).
        slants: slope (x, y) of the middle ray at the sensor, its change per mm on the sensor and per unit of pupil, shape (N, 4).
        levels: light at full pupil.
        sharp: entries whose blur is negligible.
        parts: parts a side of a pixel in the rim, for each kind of rim.
        counts: number of strips for each kind, (K, 2): of most pixels, and where the window ends.
        strips: see ``strip_nodes``; (K, 2, 3, most strips).
        chunks: pieces of a strip for the fall-off; 0 for no fall-off.
        steps: steps over a micro-image of the fall-off's table.
        rims: see ``rim_tables``; steep kinds start with a negative distance.
        nodes: pupil points for steep rims.
        xs: positions of the columns, mm.
        ys: positions of the rows, mm.
        pixel: distance of the pixels, mm.
        width: side of a pixel that gathers light, mm.
        fine: largest error of the antiderivatives' tables.
        table: profile, see ``profile_table``; no row where the target does not vary along x'.
        law: its law.
        bounds: lower and upper end of the window, target mm.
        wanted: which pixels to compute, [row, column]; empty for all.
    """
    varies = table.shape[0] > 0
    window = np.empty(4)
    window[:2] = bounds
    places = np.zeros((3, 4))
    whole, clear, cut = places[0], places[1], places[2]
    boxes = np.zeros((3, 2))
    sums = np.zeros(2)
    for entry in range(windows.shape[0]):
        first, last = max(rows[0], windows[entry, 2]), min(rows[1], windows[entry, 3])
        start, end = windows[entry, 0], windows[entry, 1]
        if wanted.size > 0:
            start, end, first, last = shrink(wanted, start, end, first, last)
        if first >= last or start >= end:
            continue
        kind = kinds[entry]
        slope, reach = cones[entry, 0], cones[entry, 1]
        origin_x, origin_y, xx, xy, yx, yy, cxx, cxy, cyx, cyy = maps[entry]
        spread = math.hypot(xx, xy)
        along_x, along_y = (xx / spread, xy / spread) if spread > 0.0 else (1.0, 0.0)
        up_along, up_across = yx * along_x + yy * along_y, yy * along_x - yx * along_y
        rim = rims[kind]
        steep = rim[0] < 0.0
        strip, strip_edge = strips[kind, 0], strips[kind, 1]
        count, count_edge = int(counts[kind, 0]), int(counts[kind, 1])
        blurred = varies and not sharp[entry]
        unslope = 1.0 / slope if slope != 0.0 else 0.0
        radius = reach * abs(unslope) if slope != 0.0 else 2.0
        lit = (reach + abs(slope)) * (1.0 - 1e-9)
        level, lower, upper = levels[entry], bounds[0], bounds[1]
        rim_parts = int(parts[kind])
        per_part = 1.0 / rim_parts
        part = width * per_part
        for axis in range(2):
            boxes[0, axis] = abs(maps[entry, 6 + axis]) * width
            boxes[1, axis] = abs(maps[entry, 6 + axis]) * part
            moved = 0.0 if steep or slope == 0.0 else maps[entry, 2 + axis] / slope
            boxes[2, axis] = abs(maps[entry, 6 + axis] + moved) * part
        if blurred:
            middle_x = 0.5 * (xs[start] + xs[end - 1]) - centres[entry, 0]
            middle_y = 0.5 * (ys[first] + ys[last - 1]) - centres[entry, 1]
            middle = origin_x + cxx * middle_x + cxy * middle_y
            half = 0.5 * (abs(cxx) * ((end - start) * pixel) + abs(cxy) * ((last - first) * pixel))
            sums = prepare(middle - half, middle + half, spread, boxes, fine, table, law, places)
        simple = blurred and chunks == 0 and rim_parts == 1 and not steep
        outside = reach + abs(slope) + 0.75 * width
        deep = reach - abs(slope) - 0.75 * width
        felt = abs(up_along) + abs(up_across) + (abs(cyx) + abs(cyy)) * width
        # Where neither pupil nor row matters, the mean of a column is the same all the way down.
        level_rows = not blurred and (cxy == 0.0 or not varies)
        quick = level_rows and not steep and (rim_parts == 1 or abs(slope) > WIDE * width)
        steady = np.ones((1 + rim_parts, end - start if level_rows else 0))
        if level_rows and varies:
            for column in range(start, end):
                at = origin_x + cxx * (xs[column] - centres[entry, 0])
                steady[0, column - start] = profile_mean(at, boxes[0, 0], 0.0, table, law)
                for i in range(rim_parts):
                    shifted = at + cxx * ((i + 0.5) / rim_parts - 0.5) * width
                    steady[1 + i, column - start] = profile_mean(shifted, boxes[1, 0], 0.0, table, law)
        falls = chunks > 0 and not blurred
        apart = max(2.0 * outside / steps, 0.5 * pixel)
        corner_x, corner_y = xs[start] - centres[entry, 0] - 0.5 * pixel, ys[first] - centres[entry, 1] - 0.5 * pixel
        weights = np.ones((int((last - first) * pixel / apart) + 2, int((end - start) * pixel / apart) + 2) if falls else (1, 1))
        if falls:
            mean_weights(corner_x, corner_y, apart, weights, slope, reach, slants[entry], strip, count)
        for row in range(first, last):
            dy = ys[row] - centres[entry, 1]
            room = outside * outside - dy * dy
            if room <= 0.0:
                continue
            half = math.sqrt(room)
            left = max(start, math.ceil((centres[entry, 0] - half - xs[0]) / pixel))
            right = min(end, math.floor((centres[entry, 0] + half - xs[0]) / pixel) + 1)
            for column in range(left, right):
                if wanted.size > 0 and not wanted[row, column]:
                    continue
                dx = xs[column] - centres[entry, 0]
                height = origin_y + cyx * dx + cyy * dy
                if height < lower - felt or height > upper + felt:
                    continue
                inside = height > lower + felt and height < upper - felt
                distance = math.sqrt(dx * dx + dy * dy)
                full = distance <= deep
                weight = level * between((dx - corner_x) / apart, (dy - corner_y) / apart, weights) if falls else level
                if inside and full and (level_rows or (blurred and chunks == 0)):
                    x = origin_x + cxx * dx + cxy * dy
                    seen = steady[0, column - start] if level_rows else full_mean(x, spread, strip, count, sums, whole)
                    image[row, column] += weight * seen
                    continue
                if inside and quick:
                    light = 0.0
                    for i in range(rim_parts):
                        x = dx + ((i + 0.5) * per_part - 0.5) * width
                        light += rim_share(math.sqrt(x * x + dy * dy), rim) * steady[1 + i, column - start]
                    image[row, column] += weight * per_part * light
                    continue
                if inside and simple:
                    share = rim_share(distance, rim)
                    if share > 0.0:
                        base = origin_x + cxx * dx + cxy * dy
                        inward = unslope if distance < lit else unslope * lit / distance
                        clip_x, clip_y = (along_x * dx + along_y * dy) * inward, (along_x * dy - along_y * dx) * inward
                        low, high = lens_span(clip_x, clip_y, radius)
                        seen = clipped_mean(base, spread, clip_x, clip_y, radius, low, high, strip, count, sums, clear, cut)
                        image[row, column] += level * share * min(max(seen, 0.0), 1.0)
                    continue
                divide = 1 if full else rim_parts
                side = width / divide
                window[2], window[3] = abs(cyx) * side, abs(cyy) * side
                light = 0.0
                for j in range(divide):
                    y = dy + ((j + 0.5) / divide - 0.5) * width
                    for i in range(divide):
                        x = dx + ((i + 0.5) / divide - 0.5) * width
                        share, look = 1.0, 1.0
                        if not full:
                            distance = math.sqrt(x * x + y * y)
                            if steep:
                                share = steep_share(x, y, side, slope, reach, nodes)
                                look = lit_middle(distance, side, reach)
                            else:
                                share = rim_share(distance, rim)
                            if share <= 0.0:
                                continue
                        if inside and level_rows:
                            light += share * steady[1 + i, column - start]
                            continue
                        ex, ey = look * x, look * y
                        base = origin_x + cxx * ex + cxy * ey
                        value = 1.0
                        if varies and not blurred:
                            value = profile_mean(base, boxes[0 if full else 1, 0], boxes[0 if full else 1, 1], table, law)
                        if not blurred and not inside:
                            value *= window_mean(origin_y + cyx * ex + cyy * ey, lower, upper, window[2], window[3])
                        if blurred:
                            clip_x, clip_y, low, high = clip(ex, ey, along_x, along_y, slope, reach)
                            slant_x, slant_y = slants[entry, 0] + slants[entry, 2] * ex, slants[entry, 1] + slants[entry, 2] * ey
                            tilted = slant_x * along_x + slant_y * along_y
                            slant = (tilted, slant_y * along_x - slant_x * along_y, slants[entry, 3])
                            near, far = (whole, whole) if full else (clear, cut)
                            if not inside:
                                across = (origin_y + cyx * ex + cyy * ey, up_along, up_across)
                                value = weighted_mean(
                                    base,
                                    spread,
                                    clip_x,
                                    clip_y,
                                    radius,
                                    low,
                                    high,
                                    strip_edge,
                                    count_edge,
                                    sums,
                                    near,
                                    far,
                                    max(chunks, 1),
                                    slant if chunks > 0 else (0.0, 0.0, 0.0),
                                    across,
                                    window,
                                )
                            elif chunks == 0:
                                value = clipped_mean(base, spread, clip_x, clip_y, radius, low, high, strip, count, sums, near, far)
                            else:
                                value = slanted_mean(
                                    base, spread, clip_x, clip_y, radius, low, high, strip, count, sums, near, far, chunks, slant
                                )
                        light += share * min(max(value, 0.0), 1.0)
                image[row, column] += weight * light / (divide * divide)
