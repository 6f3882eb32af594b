"""Images of targets that vary along one direction (bars, chirp), end at straight lines (edge), or are plain white.

The radiance is profile(x') times a window in y', x' and y' being target axes turned as the target asks. Over the pupil, strips
of constant y' are summed; along each strip the mean of the profile is exact, and so is the mean over the pixel.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.profile import boxed, profile_mean, step_mean
from flflab.image.rim import lit_middle, rim_share, steep_share
from flflab.optics.discs import lens_chord, lens_rows

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

PIECE_NODES = 8
WIDE = 10.0  # half the width in pixels of a rim whose shape within a pixel does not matter
_ABSCISSAE, _WEIGHTS = np.polynomial.legendre.leggauss(PIECE_NODES)
PIECE = np.stack([np.sin(np.pi / 2 * _ABSCISSAE), _WEIGHTS * np.pi / 2 * np.cos(np.pi / 2 * _ABSCISSAE)])


def strip_nodes(counts: Whole) -> Array:
    """Heights and weights of the strips for each count, shape (K, 2, most strips): Gauss's rule for the weight sqrt(1 - y^2)."""
    nodes = np.zeros((len(counts), 2, max(int(counts.max()), 1)))
    for kind, count in enumerate(counts):
        angle = np.pi * np.arange(1, count + 1) / (count + 1)
        nodes[kind, 0, :count] = np.cos(angle)
        nodes[kind, 1, :count] = np.pi / (count + 1) * np.sin(angle)
    return nodes


@numba.njit(cache=True, nogil=True, error_model="numpy")
def window_mean(y: float, window: Array) -> float:
    """A window from window[0] to window[1] at y, smoothed by boxes of widths window[2] and window[3]."""
    return step_mean(y - window[0], window[2], window[3]) - step_mean(y - window[1], window[2], window[3])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def pieces(x: float, y: float, radius: float, low: float, high: float, origin: float, spread: float, window: Array, ends: Array) -> int:
    """Cut the pupil's rows at the window's kinks and the lens's corners; returns the number of ends, 2 where nothing needs a cut."""
    count = 1
    ends[0] = low
    for edge in range(2):
        for side in (-1.0, 1.0):
            for reach in (0.5 * (window[2] + window[3]), 0.5 * abs(window[2] - window[3])):
                at = (window[edge] + side * reach - origin) / spread
                if low < at < high:
                    ends[count] = at
                    count += 1
    if count > 1:
        distance = math.hypot(x, y)
        if distance + 1.0 > radius and distance + radius > 1.0:
            along = (1.0 + (distance - radius) * (distance + radius)) / (2.0 * distance)
            across = math.sqrt(max(0.0, 1.0 - along * along))
            for side in (-1.0, 1.0):
                at = (along * y + side * across * x) / distance
                if low < at < high:
                    ends[count] = at
                    count += 1
        ends[1:count].sort()
    ends[count] = high
    return count + 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def region_of(ex: float, ey: float, slope: float, reach: float) -> tuple[float, float, float]:
    """Centre and radius of the disc that clips the pupil at a sensor point; (0, 0, 2) where it clips nothing.

    A pixel whose centre is dark but whose edge is lit gets the last sliver of the pupil.
    """
    inside = max(0.0, reach - abs(slope))
    squared = ex * ex + ey * ey
    if slope == 0.0 or squared <= inside * inside:
        return 0.0, 0.0, 2.0
    radius = reach / abs(slope)
    shrink = min(1.0, (1.0 + radius) * (1.0 - 1e-9) * abs(slope) / math.sqrt(squared))
    return ex / slope * shrink, ey / slope * shrink, radius


@numba.njit(cache=True, nogil=True, error_model="numpy")
def strips_mean(
    x: float,
    y: float,
    radius: float,
    low: float,
    high: float,
    origin: float,
    spread: float,
    strips: Array,
    count: int,
    box: float,
    table: Array,
    law: Array,
) -> float:
    """Mean of the profile over a pupil clipped by the disc at (x, y), by strips from low to high."""
    light = 0.0
    area = 0.0
    middle = 0.5 * (low + high)
    reach = 0.5 * (high - low)
    exact = abs(spread) * box < 1e-11 * (law[1] - law[0]) ** 2
    for index in range(count):
        left, right = lens_chord(x, y, radius, middle + reach * strips[0, index])
        if right > left:
            weight = strips[1, index]
            area += weight * (right - left)
            if exact:
                chord = right - left
                light += weight * chord * profile_mean(origin + spread * 0.5 * (left + right), box, abs(spread) * chord, table, law)
            else:
                ends = boxed(origin + spread * right, box, table, law) - boxed(origin + spread * left, box, table, law)
                light += weight * ends / spread
    return min(max(light / area, 0.0), 1.0) if area > 0.0 else 0.0  # the difference may round to below 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def pieces_mean(
    x: float,
    y: float,
    radius: float,
    ends: Array,
    count: int,
    origin_x: float,
    origin_y: float,
    spread: float,
    box: float,
    table: Array,
    law: Array,
    window: Array,
) -> float:
    """Mean of profile times window over a clipped pupil, by strips in each of the pieces between the ends."""
    light = 0.0
    area = 0.0
    for piece in range(count - 1):
        middle = 0.5 * (ends[piece + 1] + ends[piece])
        reach = 0.5 * (ends[piece + 1] - ends[piece])
        for index in range(PIECE_NODES):
            at = middle + reach * PIECE[0, index]
            left, right = lens_chord(x, y, radius, at)
            if right > left:
                weight = reach * PIECE[1, index] * (right - left)
                area += weight
                seen = window_mean(origin_y + spread * at, window)
                if seen > 0.0 and table.shape[0] > 0:
                    seen *= profile_mean(origin_x + spread * 0.5 * (left + right), box, abs(spread) * (right - left), table, law)
                light += weight * seen
    return light / area if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def pupil_mean(
    ex: float,
    ey: float,
    pupil: Array,
    strips: Array,
    count: int,
    box: float,
    table: Array,
    law: Array,
    window: Array,
    ends: Array,
) -> float:
    """Mean radiance over the part of the pupil that lights a sensor point, each radiance averaged over the pixel.

    Args:
        ex: sensor point from the micro-image's centre, in the target's axes, mm.
        ey: the same along y'.
        pupil: slope, reach, spread, scale, direction x', y' (spread, scale and direction in target mm).
        strips: heights and weights.
        count: number of strips; 0 where the blur is negligible.
        box: width of the pixel on the target along x', mm.
        table: profile, see ``profile_table``; no row where the target does not vary along x'.
        law: its law.
        window: lower and upper end, and the widths of the two boxes that smooth it.
        ends: scratch for 16 numbers.
    """
    spread = pupil[2]
    origin_x = pupil[3] * ex + pupil[4]
    origin_y = pupil[3] * ey + pupil[5]
    varies = table.shape[0] > 0
    if count == 0:
        seen = window_mean(origin_y, window)
        return seen * profile_mean(origin_x, box, 0.0, table, law) if varies and seen > 0.0 else seen
    x, y, radius = region_of(ex, ey, pupil[0], pupil[1])
    low, high = lens_rows(x, y, radius)
    cuts = pieces(x, y, radius, low, high, origin_y, spread, window, ends)
    seen = window_mean(origin_y + spread * low, window)
    if cuts > 2 or window_mean(origin_y + spread * high, window) != seen:
        return pieces_mean(x, y, radius, ends, cuts, origin_x, origin_y, spread, box, table, law, window)
    if seen == 0.0 or not varies:
        return seen
    return seen * strips_mean(x, y, radius, low, high, origin_x, spread, strips, count, box, table, law)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_ruled(
    image: Array,
    rows: tuple[int, int],
    windows: Whole,
    kinds: Whole,
    centres: Array,
    pupils: Array,
    levels: Array,
    subs: Whole,
    counts: Whole,
    strips: Array,
    rims: Array,
    nodes: Array,
    xs: Array,
    ys: Array,
    pixel: float,
    axes: Array,
    table: Array,
    law: Array,
    bounds: Array,
    wanted: npt.NDArray[np.bool_],
) -> None:
    """Add the light of every microlens to the rows from rows[0] to below rows[1] of an image.

    Args:
        image: picture to add to, [row, column].
        rows: the band.
        windows: first column, column after the last, first row, row after the last, of every microlens; shape (N, 4).
        kinds: kind of rim of every microlens.
        centres: centre of every micro-image, mm, shape (N, 2).
        pupils: as in ``pupil_mean``, direction in the target's axes, shape (N, 6).
        levels: light at full pupil.
        subs: parts a side of a pixel for each kind of rim.
        counts: number of strips for each kind.
        strips: see ``strip_nodes``.
        rims: see ``rim_tables``; steep kinds start with a negative distance.
        nodes: pupil points for steep rims.
        xs: positions of the columns, mm.
        ys: positions of the rows, mm.
        pixel: side of a pixel, mm.
        axes: rows are the directions x' and y' in world axes.
        table: profile.
        law: its law.
        bounds: lower and upper end of the window, target mm.
        wanted: which pixels to compute, [row, column]; empty for all.
    """
    ends = np.empty(16)
    window = np.empty(4)
    plain = table.shape[0] == 0
    window[0], window[1] = bounds[0], bounds[1]
    for lens in range(windows.shape[0]):
        first = max(rows[0], windows[lens, 2])
        last = min(rows[1], windows[lens, 3])
        if first >= last or windows[lens, 0] >= windows[lens, 1]:
            continue
        kind = kinds[lens]
        parts = int(subs[kind])
        part = pixel / parts
        pupil, strip, rim, count = pupils[lens], strips[kind], rims[kind], int(counts[kind])
        outside = pupil[1] + abs(pupil[0]) + 0.75 * pixel
        box = abs(pupil[3]) * (abs(axes[0, 0]) + abs(axes[0, 1])) * part
        window[2] = abs(pupil[3] * axes[1, 0]) * part
        window[3] = abs(pupil[3] * axes[1, 1]) * part
        blurred = abs(pupil[2]) + abs(pupil[3]) * pixel  # how far an end of the window is felt
        wide = rim[0] >= 0.0 and (parts == 1 or abs(pupil[0]) > WIDE * pixel)  # a rim that needs no parts for its own sake
        for row in range(first, last):
            dy = ys[row] - centres[lens, 1]
            room = outside * outside - dy * dy
            if room <= 0.0:
                continue
            half = math.sqrt(room)
            left = max(windows[lens, 0], math.ceil((centres[lens, 0] - half - xs[0]) / pixel))
            right = min(windows[lens, 1], math.floor((centres[lens, 0] + half - xs[0]) / pixel) + 1)
            for column in range(left, right):
                if wanted.size > 0 and not wanted[row, column]:
                    continue
                dx = xs[column] - centres[lens, 0]
                at = pupil[3] * (axes[1, 0] * dx + axes[1, 1] * dy) + pupil[5]
                rows_of_parts = parts
                if wide and abs(at - bounds[0]) > blurred and abs(at - bounds[1]) > blurred:
                    if at < bounds[0] or at > bounds[1]:
                        continue
                    if plain:
                        image[row, column] += levels[lens] * rim_share(math.sqrt(dx * dx + dy * dy), rim)
                        continue
                    rows_of_parts = 1
                light = 0.0
                for j in range(rows_of_parts):
                    y = dy + ((j + 0.5) / rows_of_parts - 0.5) * pixel
                    for i in range(parts):
                        x = dx + ((i + 0.5) / parts - 0.5) * pixel
                        look = 1.0
                        if rim[0] < 0.0:
                            share = steep_share(x, y, part, pupil[0], pupil[1], nodes)
                            look = lit_middle(math.sqrt(x * x + y * y), part, pupil[1])
                        else:
                            share = rim_share(math.sqrt(x * x + y * y), rim)
                        if share > 0.0:
                            ex = look * (axes[0, 0] * x + axes[0, 1] * y)
                            ey = look * (axes[1, 0] * x + axes[1, 1] * y)
                            light += share * pupil_mean(ex, ey, pupil, strip, count, box, table, law, window, ends)
                image[row, column] += levels[lens] * light / (parts * rows_of_parts)
