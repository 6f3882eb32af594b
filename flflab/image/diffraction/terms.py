"""How much each term of a kind's modes counts at a sensor point: by its place on the rim, its
direction and the weight of its pupil.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.diffraction.ruled import mirrored, spline_weights
from flflab.image.diffraction.shading import ODD

Array = npt.NDArray[np.float64]
SingleArray = npt.NDArray[np.float32]
Whole = npt.NDArray[np.int64]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def term_amounts(
    radial: float, coefficients: Array | SingleArray, amounts: Array | SingleArray
) -> None:
    """The terms' amounts at a place in nodes of radius; ``coefficients``: ``radial`` of ``Modes``
    with the terms along the second axis.
    """
    last = coefficients.shape[0]
    base = min(int(radial), last - 2)
    a, b, c, d = spline_weights(radial - base)
    of = coefficients.dtype.type
    one, two, three, four = of(a), of(b), of(c), of(d)
    low, middle, next_one, high = mirrored(base - 1, last), base, base + 1, mirrored(base + 2, last)
    for term in range(amounts.size):
        near = two * coefficients[middle, term] + three * coefficients[next_one, term]
        amounts[term] = near + one * coefficients[low, term] + four * coefficients[high, term]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def turn_terms(cos: float, orders: Whole, weights: SingleArray) -> None:
    """Multiply the weights of terms of rising order by the cosine of their turn, for a sensor point
    whose direction has this from x'.
    """
    before, now, order = cos, 1.0, 0
    for term in range(weights.size):
        while order < orders[term]:
            before, now, order = now, 2.0 * cos * now - before, order + 1
        weights[term] *= np.float32(now)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def turn_weighted(
    cos: float, sin: float, orders: Whole, polynomials: Whole, told: Array, weights: SingleArray
) -> None:
    """As ``turn_terms`` for pupils weighted by polynomials, of which each counts as ``told``; see
    ``Modes`` and ``shading``.
    """
    before, now, sine_before, sine, order = cos, 1.0, -sin, 0.0, 0
    for term in range(weights.size):
        while order < orders[term]:
            before, now, order = now, 2.0 * cos * now - before, order + 1
            sine_before, sine = sine, 2.0 * cos * sine - sine_before
        weights[term] *= np.float32(
            told[polynomials[term]] * (sine if polynomials[term] >= ODD else now)
        )


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def shade_amounts(polynomials: Whole, told: Array, odd: float, amounts: Array) -> None:
    """Multiply the terms' amounts by what their polynomials count, and those that are odd across
    the point's direction by ``odd``.
    """
    for term in range(amounts.size):
        amounts[term] *= told[polynomials[term]] * (odd if polynomials[term] >= ODD else 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def weigh_waves(
    cos: float,
    sin: float,
    terms: Whole,
    turns: Whole,
    amounts: Array,
    turned: Array,
    weights: SingleArray,
) -> None:
    """The first waves' weights at a sensor point, as many as ``weights`` holds.

    Args:
        cos: cosine of its direction.
        sin: the sine.
        terms: the term of each wave.
        turns: twice its order for the cosine, 1 more for the sine.
        amounts: of the terms.
        turned: room for twice the orders from 0 to the highest.
        weights: of the waves.
    """
    turned[0], turned[1] = 1.0, 0.0
    for order in range(2, turned.size, 2):
        turned[order] = turned[order - 2] * cos - turned[order - 1] * sin
        turned[order + 1] = turned[order - 1] * cos + turned[order - 2] * sin
    for wave in range(weights.size):
        weights[wave] = amounts[terms[wave]] * turned[turns[wave]]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def weigh_pairs(
    radial: float, angle: float, orders: Whole, coefficients: Array, weights: SingleArray
) -> None:
    """The weights of terms of rising order for both waves of each, that in the cosine of the sensor
    point's angle and that in its sine.

    Args:
        radial: place of the sensor point in nodes of radius.
        angle: its direction, rad.
        orders: of the terms.
        coefficients: see ``term_amounts``.
        weights: of the waves, twice as many as terms.
    """
    last = coefficients.shape[0]
    base = min(int(radial), last - 2)
    a, b, c, d = spline_weights(radial - base)
    low, high = mirrored(base - 1, last), mirrored(base + 2, last)
    order = orders[0]
    cos, sin, by_cos, by_sin = (
        math.cos(order * angle),
        math.sin(order * angle),
        math.cos(angle),
        math.sin(angle),
    )
    for term in range(orders.size):
        while order < orders[term]:
            cos, sin = cos * by_cos - sin * by_sin, sin * by_cos + cos * by_sin
            order += 1
        amount = a * coefficients[low, term] + b * coefficients[base, term]
        amount += c * coefficients[base + 1, term] + d * coefficients[high, term]
        weights[2 * term], weights[2 * term + 1] = amount * cos, amount * sin


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def shade_pairs(polynomials: Whole, told: Array, weights: SingleArray) -> None:
    """Multiply the waves' weights by what their terms' polynomials count; a sine of the turn takes
    the place of a cosine in odd ones.
    """
    for term in range(polynomials.size):
        amount, odd = np.float32(told[polynomials[term]]), polynomials[term] >= ODD
        cos, sin = amount * weights[2 * term], amount * weights[2 * term + 1]
        weights[2 * term], weights[2 * term + 1] = (sin, -cos) if odd else (cos, sin)
