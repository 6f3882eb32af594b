"""The kernel that adds the diffracted light of lines, pixel by pixel: curves over x', less what
comes from beyond their borders.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.diffraction.border import border_row, from_beyond
from flflab.image.diffraction.falloff import mean_falloff
from flflab.image.diffraction.ruled import seen_through
from flflab.image.diffraction.shading import WEIGHTS, weigh_pupil
from flflab.image.diffraction.terms import shade_amounts, term_amounts, turn_terms, turn_weighted
from flflab.image.geometry.rim import place_on_rim

Array = npt.NDArray[np.float64]
SingleArray = npt.NDArray[np.float32]
Chosen = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int64]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_ruled_diffracted(
    image: Array,
    rows: tuple[int, int],
    windows: Whole,
    centres: Array,
    origins: Array,
    directions: Array,
    levels: Array,
    rims: Array,
    steep: bool,
    bright: float,
    ring: tuple[float, float],
    offsets: Array,
    amounts: Array,
    box: float,
    xs: Array,
    ys: Array,
    pixel: float,
    half: float,
    curves: tuple[Array, Array, SingleArray, tuple[float, float, float, float, float, float]],
    curve_terms: tuple[Whole, Whole, SingleArray],
    lower: tuple[
        Array, Array, SingleArray, Whole, Whole, Array, tuple[float, float, float, float, float]
    ],
    upper: tuple[
        Array, Array, SingleArray, Whole, Whole, Array, tuple[float, float, float, float, float]
    ],
    mirror: float,
    highest: int,
    border_terms: tuple[Whole, Array],
    slants: Array,
    moments: Array,
    fit: Array,
    blur: float,
    nodes: Array,
    chosen: Chosen,
) -> None:
    """Add the light of microlenses of one kind to the rows from rows[0] to below rows[1].

    Args:
        image: picture to add to, [row, column].
        rows: the band.
        windows: first column, column after the last, first row, row after the last; shape (N, 4).
        centres: of the micro-images, mm, shape (N, 2).
        origins: position on the target seen from there along x' and y', in pixels of either
            direction, shape (N, 2).
        directions: change of that position per pixel on the sensor, shape (N, 2, 2).
        levels: light at full pupil.
        rims: see ``Kind``.
        steep: whether its rim is too narrow for curves of its own.
        bright: see ``PixelParts``.
        ring: the same.
        offsets: the same.
        amounts: the same.
        box: side of the square over which a pixel gathers light, pixels.
        xs: positions of the columns, mm.
        ys: of the rows.
        pixel: side of a pixel, mm.
        half: half the target's extent along y', pixels; infinite where it does not end.
        curves: see ``Curves``.
        curve_terms: ``orders``, ``polynomials`` and ``coefficients`` of their waves, see
            ``term_amounts``.
        lower: see ``Border``.
        upper: the same.
        mirror: -1 where the upper one is the lower one's mirror image, else 1.
        highest: order of all terms.
        border_terms: ``polynomials`` and ``coefficients`` of the borders' waves.
        slants: see ``slant_rows``.
        moments: see ``pupil_moments``.
        fit: see ``Shading``.
        blur: see ``Kind``.
        nodes: pupil points for steep rims.
        chosen: which pixels to compute.
    """
    core, part, curve_waves, place = curves
    orders, polynomials, own_radial = curve_terms
    border_polynomials, radial_terms = border_terms
    count = own_radial.shape[0] - 1
    weights = np.empty(own_radial.shape[1], dtype=np.float32)
    most = max(lower[2].shape[2], upper[2].shape[2])
    scratch = (
        np.empty(radial_terms.shape[1]),
        np.empty(2 * highest + 2),
        np.empty(most, dtype=np.float32),
    )
    shaded = fit.shape[0] > 0
    told = np.ones(WEIGHTS)
    for entry in range(windows.shape[0]):
        rim = rims[entry]
        stretch = math.hypot(directions[entry, 0, 0], directions[entry, 0, 1])
        for row in range(max(rows[0], windows[entry, 2]), min(rows[1], windows[entry, 3])):
            dy = (ys[row] - centres[entry, 1]) / pixel
            for column in range(windows[entry, 0], windows[entry, 1]):
                dx = (xs[column] - centres[entry, 0]) / pixel
                from_centre = math.sqrt(dx * dx + dy * dy)
                if (
                    from_centre > rim[3] + 0.75
                    or not ring[0] <= rim[0] - from_centre < ring[1]
                    or not chosen[row, column]
                ):
                    continue
                whole = from_centre < rim[0] - bright
                pieces = 1 if whole else offsets.size
                side = max(box / pieces, 1e-3)
                light = 0.0
                for j in range(pieces):
                    y = dy + (0.0 if whole else offsets[j] * box)
                    for i in range(pieces):
                        x = dx + (0.0 if whole else offsets[i] * box)
                        amount = 1.0 if whole else amounts[i] * amounts[j]
                        distance = math.sqrt(x * x + y * y)
                        radial, share, look = place_on_rim(
                            x, y, side, rim, steep and not whole, count, nodes
                        )
                        if share <= 0.0:
                            continue
                        toward = directions[entry, 0, 0] * x + directions[entry, 0, 1] * y
                        falling, aside_x, aside_y = 1.0, 0.0, 0.0
                        if shaded:
                            falling = weigh_pupil(x, y, slants[entry], fit, told)
                            radial = max(radial, 0.0)
                        else:
                            falling, aside_x, aside_y = mean_falloff(
                                x, y, rim, slants[entry], moments
                            )
                        if radial >= 0.0:
                            away = max(distance, 1e-9) * stretch
                            ahead = min(max(toward / away, -1.0), 1.0)
                            term_amounts(radial, own_radial, weights)
                            if shaded:
                                beside = (
                                    directions[entry, 0, 0] * y - directions[entry, 0, 1] * x
                                ) / away
                                turn_weighted(ahead, beside, orders, polynomials, told, weights)
                            else:
                                turn_terms(ahead, orders, weights)
                        seen_x, seen_y = look * x + blur * aside_x, look * y + blur * aside_y
                        at = (
                            origins[entry, 0]
                            + directions[entry, 0, 0] * seen_x
                            + directions[entry, 0, 1] * seen_y
                        )
                        seen = seen_through(
                            radial, at, core if whole else part, curve_waves, place, weights
                        )
                        if half < math.inf:
                            cos, sin = (
                                (x / distance, y / distance)
                                if radial >= 0.0 and distance > 1e-9
                                else (1.0, 0.0)
                            )
                            up = (
                                origins[entry, 1]
                                + directions[entry, 1, 0] * seen_x
                                + directions[entry, 1, 1] * seen_y
                            )
                            for upwards in range(2):
                                sheet, part_sheet, waves, terms, turns, last, border = (
                                    upper if upwards else lower
                                )
                                inside, side_on = (
                                    (half - up, mirror * sin) if upwards else (half + up, sin)
                                )
                                sheet = sheet if whole else part_sheet
                                at_row = border_row(inside, border)
                                if at_row >= sheet.shape[0] - 1.0:
                                    continue
                                if radial >= 0.0:
                                    term_amounts(radial, radial_terms, scratch[0])
                                if shaded:
                                    shade_amounts(
                                        border_polynomials,
                                        told,
                                        mirror if upwards else 1.0,
                                        scratch[0],
                                    )
                                seen -= from_beyond(
                                    radial,
                                    cos,
                                    side_on,
                                    at,
                                    at_row,
                                    sheet,
                                    waves,
                                    terms,
                                    turns,
                                    last,
                                    border,
                                    scratch,
                                )
                        light += amount * share * max(seen, 0.0) * falling
                image[row, column] += levels[entry] * light
