"""Images of targets that vary along one direction (bars, chirp), end at a straight line (edge), or are plain white.

The radiance is profile(x') times a window in y', where x' and y' are target axes turned as the target asks. Over the pupil, strips
along the gradient of x' are summed; along each strip the mean of the profile is exact, and so is the mean over the pixel.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.profile import fill_antiderivative, profile_mean, step_mean
from flflab.image.rim import lit_middle, rim_share, steep_share

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

# Sums may be taken in any order; nothing here is infinite or not a number.
LOOSE = {"contract", "nsz", "nnan", "ninf", "reassoc", "arcp"}


def strip_nodes(counts: Whole) -> Array:
    """Heights, weights and half lengths of the strips of the unit disc for each count, shape (K, 3, most strips).

    They are Gauss's rule for the weight sqrt(1 - y^2).
    """
    nodes = np.zeros((len(counts), 3, max(int(counts.max()), 1)))
    for kind, count in enumerate(counts):
        angle = np.pi * np.arange(1, count + 1) / (count + 1)
        nodes[kind, :, :count] = np.cos(angle), np.pi / (count + 1) * np.sin(angle), np.sin(angle)
    return nodes


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lens_span(x: float, y: float, radius: float) -> tuple[float, float]:
    """Lowest and highest y common to the unit disc and a disc at (x, y) of a radius of at least 1 that cuts it."""
    squared = x * x + y * y
    low, high = -1.0, 1.0
    cut_top = squared - 2.0 * y + 1.0 > radius * radius
    cut_bottom = squared + 2.0 * y + 1.0 > radius * radius
    if cut_top or cut_bottom:
        inverse = 1.0 / squared
        along = 0.5 * (1.0 + squared - radius * radius) * inverse
        across = abs(x) * math.sqrt(max(0.0, inverse - along * along))
        if cut_top:
            high = y + radius if x * x + (y + radius) ** 2 < 1.0 else along * y + across
        if cut_bottom:
            low = y - radius if x * x + (y - radius) ** 2 < 1.0 else along * y - across
    return low, high


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE)
def full_mean(base: float, spread: float, strips: Array, count: int, sums: Array, place: Array) -> float:
    """Mean of a profile over the whole pupil.

    Args:
        base: x' at the pupil's centre, mm.
        spread: change of x' over the pupil's radius, mm.
        strips: see ``strip_nodes``.
        count: how many there are.
        sums: antiderivatives at even steps of x'.
        place: where in ``sums`` to look: first position, 1 / step, first index, last index.
    """
    start = (base - place[0]) * place[1] + place[2]
    slope = spread * place[1]
    low, high = place[2], place[3]
    total = 0.0
    for strip in range(count):
        right = min(max(start + slope * strips[2, strip], low), high)
        left = min(max(start - slope * strips[2, strip], low), high)
        i, j = np.int64(right), np.int64(left)
        at, to = np.uint64(i), np.uint64(j)
        above = sums[at] + (right - i) * (sums[at + np.uint64(1)] - sums[at])
        total += strips[1, strip] * (above - sums[to] - (left - j) * (sums[to + np.uint64(1)] - sums[to]))
    return total / (math.pi * spread)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE)
def clipped_mean(
    base: float,
    spread: float,
    x: float,
    y: float,
    radius: float,
    low: float,
    high: float,
    strips: Array,
    count: int,
    sums: Array,
    place: Array,
    clipped: Array,
) -> float:
    """The same over the part of the pupil from ``low`` to ``high`` inside the disc at (x, y); ``clipped`` is the place for its ends."""
    middle = 0.5 * (low + high)
    reach = 0.5 * (high - low)
    squared = radius * radius
    light = 0.0
    area = 0.0
    start1, slope1, low1, high1 = (base - place[0]) * place[1] + place[2], spread * place[1], place[2], place[3]
    start2, slope2, low2, high2 = (base - clipped[0]) * clipped[1] + clipped[2], spread * clipped[1], clipped[2], clipped[3]
    for strip in range(count):
        at = middle + reach * strips[0, strip]
        off = at - y
        own = math.sqrt(max(0.0, 1.0 - at * at))
        other = math.sqrt(max(0.0, squared - off * off))
        cut_right = x + other < own
        cut_left = x - other > -own
        right = x + other if cut_right else own
        left = x - other if cut_left else -own
        right = max(left, right)
        up = min(max(start2 + slope2 * right, low2), high2) if cut_right else min(max(start1 + slope1 * right, low1), high1)
        down = min(max(start2 + slope2 * left, low2), high2) if cut_left else min(max(start1 + slope1 * left, low1), high1)
        i, j = np.int64(up), np.int64(down)
        upper, lower = np.uint64(i), np.uint64(j)
        above = sums[upper] + (up - i) * (sums[upper + np.uint64(1)] - sums[upper])
        light += strips[1, strip] * (above - sums[lower] - (down - j) * (sums[lower + np.uint64(1)] - sums[lower]))
        area += strips[1, strip] * (right - left)
    return light / (spread * area) if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def antiderivative(at: float, sums: Array, place: Array) -> float:
    """The antiderivative at x' = ``at``, by straight lines between the steps."""
    where = min(max((at - place[0]) * place[1] + place[2], place[2]), place[3])
    index = int(where)
    return sums[index] + (where - index) * (sums[index + 1] - sums[index])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weighted_mean(
    base: float,
    spread: float,
    x: float,
    y: float,
    radius: float,
    low: float,
    high: float,
    strips: Array,
    count: int,
    sums: Array,
    place: Array,
    clipped: Array,
    chunks: int,
    slant: tuple[float, float, float],
    across: tuple[float, float, float],
    window: Array,
) -> float:
    """The mean of ``clipped_mean`` where rays count by cos^4 of their slope and by a window in y'.

    Args:
        base: x' at the pupil's centre, mm.
        spread: change of x' over the pupil's radius, mm; 0 leaves the profile out.
        x: centre of the clipping disc, in units of the pupil.
        y: the same across the strips.
        radius: of the clipping disc.
        low: where the strips begin.
        high: where they end.
        strips: see ``strip_nodes``.
        count: how many there are.
        sums: antiderivatives at even steps of x'.
        place: where in ``sums`` to look.
        clipped: the same for ends at the clipping disc.
        chunks: into how many pieces a strip is cut, each of one weight.
        slant: slope at the sensor of the ray through the pupil's centre along the strips and across them, its change over the radius.
        across: y' at the pupil's centre, its change over the radius along the strips and across them, mm.
        window: lower and upper end, and the widths of the two boxes that smooth it.
    """
    middle = 0.5 * (low + high)
    reach = 0.5 * (high - low)
    light = 0.0
    area = 0.0
    for strip in range(count):
        at = middle + reach * strips[0, strip]
        off = at - y
        own = math.sqrt(max(0.0, 1.0 - at * at))
        other = math.sqrt(max(0.0, radius * radius - off * off))
        right = min(own, x + other)
        left = max(-own, x - other)
        if right <= left:
            continue
        area += strips[1, strip] * (right - left)
        thick = abs(across[2]) * reach * strips[1, strip]
        second = (
            math.sqrt(window[3] * window[3] + thick * thick)
            if window[2] > thick
            else math.sqrt(window[3] * window[3] + window[2] * window[2])
        )
        height = across[0] + across[1] * 0.5 * (left + right) + across[2] * at
        seen = window_mean(height, window[0], window[1], max(window[2], thick), second)
        if seen == 0.0:
            continue
        steep = slant[1] + slant[2] * at
        before = antiderivative(base + spread * left, sums, clipped if x - other > -own else place) if spread != 0.0 else 0.0
        part = (right - left) / chunks
        total = 0.0
        for chunk in range(chunks):
            end = left + part * (chunk + 1)
            step = part
            if spread != 0.0:
                last = chunk == chunks - 1 and x + other < own
                after = antiderivative(base + spread * end, sums, clipped if last else place)
                step = (after - before) / spread
                before = after
            along = slant[0] + slant[2] * (end - 0.5 * part)
            total += step / (1.0 + along * along + steep * steep) ** 2
        light += strips[1, strip] * seen * total
    return light / area if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def window_mean(y: float, lower: float, upper: float, box: float, other: float) -> float:
    """A window from ``lower`` to ``upper`` at y, smoothed by boxes of two widths."""
    return step_mean(y - lower, box, other) - step_mean(y - upper, box, other)


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
def prepare(
    low: float,
    high: float,
    spread: float,
    boxes: Array,
    fine: float,
    table: Array,
    law: Array,
    places: Array,
) -> Array:
    """Antiderivatives of the profile from ``low`` to ``high`` (x' at the pupil's centre), one behind the other for each pair of boxes.

    The straight lines between their steps change a mean over the pupil by up to ``fine``.

    Args:
        low: lowest x' of a ray through the pupil's centre, mm.
        high: highest.
        spread: change of x' over the pupil's radius, mm; above 0.
        boxes: widths of the two boxes, shape (3, 2).
        fine: largest error.
        table: see ``profile_table``.
        law: its law.
        places: filled with first position, 1 / step, first and last index of each, shape (3, 4).
    """
    counts = np.zeros(3, dtype=np.int64)
    steps = np.empty(3)
    total = 0
    for kind in range(3):
        same = -1
        for earlier in range(kind):
            if boxes[earlier, 0] == boxes[kind, 0] and boxes[earlier, 1] == boxes[kind, 1]:
                same = earlier
        if same >= 0:
            places[kind] = places[same]
            continue
        wide = max(boxes[kind, 0], boxes[kind, 1])
        steps[kind] = max(math.sqrt(fine * wide * spread / 0.16), fine * spread / 0.3)
        if steps[kind] < wide:
            steps[kind] = wide / math.ceil(wide / steps[kind])  # then the box's ends fall on steps
        first = max(low - spread, law[0] - 2.0 * wide)
        last = max(min(high + spread, law[1] + 2.0 * wide), first)
        counts[kind] = int((last - first) / steps[kind]) + 3
        places[kind, 0] = first - 0.5 * steps[kind]
        places[kind, 1] = 1.0 / steps[kind]
        places[kind, 2] = total
        places[kind, 3] = total + counts[kind] - 2
        total += counts[kind]
    sums = np.empty(total)
    for kind in range(3):
        if counts[kind] > 0:
            start, step = int(places[kind, 2]), steps[kind]
            fill_antiderivative(sums, start, counts[kind], places[kind, 0], step, boxes[kind, 0], boxes[kind, 1], table, law)
    return sums


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
    parts: Whole,
    counts: Whole,
    strips: Array,
    chunks: int,
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
        parts: parts a side of a pixel in the rim, for each kind of rim.
        counts: number of strips for each kind, (K, 2): of most pixels, and where the window ends; 0 where the blur is negligible.
        strips: see ``strip_nodes``; (K, 2, 3, most strips).
        chunks: pieces of a strip for the fall-off; 0 for no fall-off.
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
        blurred = count > 0 and varies
        unslope = 1.0 / slope if slope != 0.0 else 0.0
        radius = reach * abs(unslope) if slope != 0.0 else 2.0
        lit = (reach + abs(slope)) * (1.0 - 1e-9)
        level, lower, upper = levels[entry], bounds[0], bounds[1]
        rim_parts = int(parts[kind])
        part = width / rim_parts
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
        even = not blurred and varies and cxy == 0.0
        steady = np.empty((1 + rim_parts, end - start if even else 0))
        if even:
            for column in range(start, end):
                at = origin_x + cxx * (xs[column] - centres[entry, 0])
                steady[0, column - start] = profile_mean(at, boxes[0, 0], 0.0, table, law)
                for i in range(rim_parts):
                    shifted = at + cxx * ((i + 0.5) / rim_parts - 0.5) * width
                    steady[1 + i, column - start] = profile_mean(shifted, boxes[1, 0], 0.0, table, law)
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
                if simple and inside:
                    base = origin_x + cxx * dx + cxy * dy
                    if full:
                        image[row, column] += level * full_mean(base, spread, strip, count, sums, whole)
                        continue
                    share = rim_share(distance, rim)
                    if share > 0.0:
                        inward = unslope if distance < lit else unslope * lit / distance
                        clip_x, clip_y = (along_x * dx + along_y * dy) * inward, (along_x * dy - along_y * dx) * inward
                        low, high = lens_span(clip_x, clip_y, radius)
                        value = clipped_mean(base, spread, clip_x, clip_y, radius, low, high, strip, count, sums, clear, cut)
                        image[row, column] += level * share * min(max(value, 0.0), 1.0)
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
                        if inside and chunks == 0:
                            if not varies:
                                light += share
                                continue
                            if even:
                                light += share * steady[0 if full else 1 + i, column - start]
                                continue
                        ex, ey = look * x, look * y
                        base = origin_x + cxx * ex + cxy * ey
                        if inside and chunks == 0 and blurred and full:
                            light += full_mean(base, spread, strip, count, sums, whole)
                            continue
                        clip_x, clip_y, low, high = 0.0, 0.0, -1.0, 1.0
                        if not full and slope != 0.0:
                            away = math.sqrt(ex * ex + ey * ey)
                            inward = unslope if away < lit else unslope * lit / away  # the centre may be dark, but not its edge
                            clip_x, clip_y = (along_x * ex + along_y * ey) * inward, (along_x * ey - along_y * ex) * inward
                            low, high = lens_span(clip_x, clip_y, radius)
                        value = 1.0
                        if not blurred and varies:
                            value = profile_mean(base, boxes[0 if full else 1, 0], boxes[0 if full else 1, 1], table, law)
                        if inside and chunks == 0:
                            if blurred:
                                value = clipped_mean(base, spread, clip_x, clip_y, radius, low, high, strip, count, sums, clear, cut)
                        else:
                            slant_x, slant_y = slants[entry, 0] + slants[entry, 2] * ex, slants[entry, 1] + slants[entry, 2] * ey
                            slant = (
                                slant_x * along_x + slant_y * along_y,
                                slant_y * along_x - slant_x * along_y,
                                slants[entry, 3],
                            )
                            if chunks == 0:
                                slant = (0.0, 0.0, 0.0)
                            across = (origin_y + cyx * ex + cyy * ey, up_along, up_across)
                            value *= weighted_mean(
                                base,
                                spread if blurred else 0.0,
                                clip_x,
                                clip_y,
                                radius,
                                low,
                                high,
                                strip if inside and blurred else strip_edge,
                                count if inside and blurred else count_edge,
                                sums,
                                whole if full else clear,
                                whole if full else cut,
                                max(chunks, 1),
                                slant,
                                across,
                                window,
                            )
                        light += share * min(max(value, 0.0), 1.0)
                image[row, column] += level * light / (divide * divide)
