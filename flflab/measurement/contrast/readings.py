"""Readings of a fitted chirp: the mean transfer of its views, every view's own, eq. (2)'s (max -
min)/(max + min) without noise, and the classic one off the single pixels.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.fit import eliminated, equations, inverse_of
from flflab.measurement.contrast.model import (
    BLUR,
    CURVE,
    DISC,
    GEOMETRY,
    MORE_BLUR,
    Fit,
    Model,
    look_at,
    weights,
)
from flflab.measurement.contrast.runs import Runs
from flflab.measurement.contrast.wave import Pattern, transfer
from flflab.measurement.lattice.registration import PixelSet
from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]

MOST_GROUPS = 60
FEWEST_RUNS = 8  # of a view near a frequency
FEWEST_PIXELS = 4  # of a view near a frequency, for the classic reading
# determinant of the correlations of light, sine and cosine: a cycle or more is in the view
LEAST_APART = 0.2
PHASES = np.arange(1, 128) / 256  # of half a cycle, its middle among them
VANISHING = 0.1  # contrast below which the fundamental does not say how strong harmonics are
CYCLES = 100  # of bars of one frequency, so that no end of them is near


def shares_of(runs: Runs, frequency: Array, nu: Array, step: float) -> Array:
    """Share of each view in each of K frequencies, by its pixels near it, shape (V, K).

    Args:
        runs: of pixels.
        frequency: that each looks at, cycles/mm.
        nu: cycles/mm, shape (K,).
        step: what is near, from end to end, cycles/mm.
    """
    share = np.zeros((len(runs.lenses), len(nu)))
    for k, one in enumerate(nu):
        near = np.abs(frequency - one) <= step / 2
        share[:, k] = np.bincount(runs.view[near], runs.pixels[near], minlength=len(runs.lenses))
    return share / np.maximum(share.sum(axis=0), 1e-300)


def contrast_of(
    runs: Runs, model: Model, fit: Fit, weight: Array, nu: Array, share: Array
) -> tuple[Array, Array, Array, Array]:
    """Contrast at K frequencies in the mean of the views by their shares, shape (K,), its
    covariance by the noise, and by what leaving out groups of views changes (the jackknife), both
    of shape (K, K); standard uncertainties of the geometry, shape (5,).
    """
    basis, curve = model.basis(nu), fit.common[CURVE:]
    pixel, step = abs(float(fit.common[1])) * model.pixel, (MORE_BLUR * model.pixel_seen) ** 2
    squares = fit.squares(np.arange(len(runs.lenses)))[:, None]
    alone = transfer(nu, pixel, squares)
    wider = (transfer(nu, pixel, squares + step) - alone) / step
    strength = basis @ curve
    raw, _ = equations(runs, model, fit, look_at(runs, model, fit), weight)
    found = eliminated(raw)
    by_own = share * wider * strength  # of each view's square, shape (V, K)
    by_common = np.zeros((len(nu), len(fit.common)))
    by_common[:, DISC] = by_own.sum(axis=0)
    by_common[:, CURVE:] = np.sum(share * alone, axis=0)[:, None] * basis
    # a view's own square follows the common parameters
    follows = -np.einsum("vij,vjp->vip", found.inverse, raw.mixed)[:, BLUR]
    along = by_common + by_own.T @ follows
    tie = np.diag(model.doubt**-2.0)
    inverse = inverse_of(found.normal.sum(axis=0) + tie)
    single = by_own.T @ (found.inverse[:, BLUR, BLUR, None] * by_own)
    left_out = _left_out(found.normal, found.right, tie)
    moves = along @ left_out
    where = np.maximum(np.diag(inverse), np.sum(left_out**2, axis=1))[GEOMETRY]
    return (
        np.sum(share * alone, axis=0) * strength,
        along @ inverse @ along.T + single,
        moves @ moves.T,
        np.sqrt(where),
    )


def _left_out(normal: Array, right: Array, tie: Array) -> Array:
    """How the common parameters move without one group of views after the other, scaled so that
    the sum of squares is their covariance; shape (P, groups).

    Linearised where the fit ended: without a group's share of the normal equations they move by
    what that group pulled.
    """
    groups = min(len(normal), MOST_GROUPS)
    whole = normal.sum(axis=0) + tie
    moves = np.array(
        [
            -inverse_of(whole - normal[n::groups].sum(axis=0)) @ right[n::groups].sum(axis=0)
            for n in range(groups)
        ]
    )
    return math.sqrt((groups - 1) / groups) * (moves - moves.mean(axis=0)).T


def extremes_of(model: Model, fit: Fit, nu: Array, doubt: Array) -> tuple[Array, Array]:
    """Largest excursion of the fitted wave over all phases at each frequency, as if its harmonics
    were as strong as its fundamental is, and its standard uncertainty.

    Args:
        model: of the picture.
        fit: of all views together.
        nu: cycles/mm, shape (K,).
        doubt: standard uncertainty of the contrast there, shape (K,).
    """
    pixel, square = abs(float(fit.common[1])) * model.pixel, float(fit.common[DISC])
    left = np.abs(transfer(nu, pixel, np.full(len(nu), square)))
    largest = left.copy()
    for k, one in enumerate(nu if model.pattern.bars else ()):
        number = np.arange(2 * CYCLES)
        even = Pattern(one, 0.0, 0.0, number / (2 * one), number % 2 / (2 * one))
        seen, _ = even.seen((PHASES + CYCLES // 2) / one, pixel, np.full(len(PHASES), square))
        largest[k] = np.abs(seen).max()
    strength = np.abs(model.basis(nu) @ fit.common[CURVE:])
    return largest * strength, largest * doubt / np.maximum(left, VANISHING)


def views_contrast(runs: Runs, model: Model, fit: Fit, nu: Array) -> tuple[Array, Array]:
    """Every view's own contrast near each frequency: its light and its fundamental free, in height
    and phase, its harmonics the fit's.

    Args:
        runs: of pixels.
        model: of the picture.
        fit: of all views together.
        nu: evenly spaced, cycles/mm, shape (K,).

    Returns:
        Contrast and its standard uncertainty, shape (V, K), nan where a view does not see that
        frequency.
    """
    seen = look_at(runs, model, fit)
    step = nu[1] - nu[0] if len(nu) > 1 else math.inf
    cell = np.rint((model.pattern.frequency(seen.x) - nu[0]) / step)
    inside = (cell >= 0) & (cell < len(nu))
    key = (runs.view * len(nu) + cell.astype(np.int64))[inside]
    turn, size = 2 * np.pi * model.pattern.phase(seen.x[inside]), len(runs.lenses) * len(nu)
    variance, weight = (part[inside] for part in weights(runs, seen))
    height = seen.level[inside] * (4 / np.pi if model.pattern.bars else 1.0)
    columns = np.stack([height * np.sin(turn), height * np.cos(turn), seen.due[inside]], axis=1)

    def total(values: Array) -> Array:
        found = np.zeros((size, *values.shape[1:]))
        np.add.at(found, key, values)
        return found

    products = columns[:, :, None] * columns[:, None, :]
    normal = total(products * weight[:, None, None])
    scatter = total(products * (weight**2 * variance)[:, None, None])
    right = total(columns * (weight * (runs.read - seen.due)[inside])[:, None])
    scale = np.maximum(np.sqrt(np.einsum("nii->ni", normal)), 1e-150)
    scale = scale[:, :, None] * scale[:, None, :]
    held = total(np.ones(len(key))) >= FEWEST_RUNS
    held &= np.linalg.det(normal / scale) > LEAST_APART
    inverse = np.linalg.inv((normal / scale)[held]) / scale[held]
    found, doubt = np.full(size, np.nan), np.full(size, np.nan)
    found[held] = np.einsum("nj,nj->n", inverse[:, 0], right[held])
    doubt[held] = np.sqrt((inverse @ scatter[held] @ inverse)[:, 0, 0])
    own = transfer(
        nu,
        abs(float(fit.common[1])) * model.pixel,
        fit.squares(np.arange(len(runs.lenses)))[:, None],
    ) * (model.basis(nu) @ fit.common[CURVE:])
    shape = own.shape
    return own + found.reshape(shape), doubt.reshape(shape)


def classic_reading(
    picture: npt.NDArray[np.generic],
    pixels: PixelSet,
    frequency: Array,
    noise: SensorNoise,
    gains: Array | None,
    nu: Array,
) -> tuple[Array, Array]:
    """(max - min)/(max + min) of each view's pixels near each frequency: mean over the views, and
    its standard uncertainty.

    Args:
        picture: DN, [row, col].
        pixels: that look at the target.
        frequency: that each looks at, cycles/mm.
        noise: of a pixel.
        gains: as in ``flflab.measurement.contrast.runs.gather``.
        nu: evenly spaced, cycles/mm.
    """
    even = np.ones((2, 2)) if gains is None else gains
    read = np.asarray(picture[pixels.rows, pixels.columns], dtype=np.float64)
    value = (read - noise.offset_dn) / even[pixels.rows % 2, pixels.columns % 2]
    step = nu[1] - nu[0] if len(nu) > 1 else math.inf
    cell = np.rint((frequency - nu[0]) / step)
    used = (cell >= 0) & (cell < len(nu))
    used &= read < noise.full_scale_dn
    mean, doubt = np.full(len(nu), np.nan), np.full(len(nu), np.nan)
    lens, cell, value = pixels.lens[used], cell[used].astype(np.int64), value[used]
    order = np.argsort(cell * (int(lens.max(initial=0)) + 1) + lens, kind="stable")
    lens, cell, value = lens[order], cell[order], value[order]
    first = np.flatnonzero(np.diff(lens, prepend=-1) | np.diff(cell, prepend=-1))
    if len(first) == 0:
        return mean, doubt
    high, low = np.maximum.reduceat(value, first), np.minimum.reduceat(value, first)
    number = np.diff(np.append(first, len(value)))
    for k in range(len(nu)):
        here = cell[first] == k
        here &= number >= max(FEWEST_PIXELS, number[here].max(initial=0) / 2)
        here &= high + low > 0
        readings = (high - low)[here] / (high + low)[here]
        if len(readings):
            mean[k] = readings.mean()
        if len(readings) > 1:
            doubt[k] = readings.std(ddof=1) / math.sqrt(len(readings))
    return mean, doubt
