"""Further readings of a fitted chirp: eq. (2)'s (max - min)/(max + min) without noise, and every
view's own contrast.
"""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.data import ChirpData
from flflab.measurement.contrast.fit import ChirpFit, ChirpModel, variance_and_weight, waves

Array = npt.NDArray[np.float64]

FEWEST_RUNS = 8  # of a view near a frequency
PHASES = np.arange(1, 128) / 256  # of half a cycle, its middle among them
LEVEL = 1e-6  # of the template's extreme: how far below it a phase counts as its place
FURTHEST = 3.0  # standard uncertainties of the template's disc
VANISHING = 0.1  # contrast below which harmonics may move the extremes
LEAST_APART = (
    0.2  # determinant of the correlations of light, sine and cosine: a cycle or more is in the view
)


def transfer_rows(model: ChirpModel, curve: Array, frequency: Array) -> Array:
    """By how much the curve's parameters and the square of the template's disc change the transfer,
    shape (K, curve + 1).
    """
    more, step = model.blurred
    rows = model.knots.design(frequency, model.template)
    wider = more.template.transfer(frequency) if len(model.edges) else rows[:, 0]
    return np.concatenate([rows, (curve[0] * (wider - rows[:, 0]) / step)[:, None]], axis=1)


def fitted_extremes(
    model: ChirpModel, curve: Array, covariance: Array, frequency: Array
) -> tuple[Array, Array]:
    """Largest excursion of the fitted wave at each frequency and its uncertainty.

    The wave is read where a template's, which has no noise, is largest, and averaged over all such
    phases: the largest of the fitted wave's many noisy values would lie up to a standard
    uncertainty too high. Where the fundamental all but vanishes, places go by how little is left of
    it; the template's disc is then, within its own uncertainty, the one whose fundamental is the
    fitted one.

    Args:
        model: of the target.
        curve: fitted.
        covariance: of the curve's parameters and the square of the template's disc.
        frequency: cycles/mm, shape (K,).
    """
    rows = transfer_rows(model, curve, frequency)
    spread = np.einsum("ni,ij,nj->n", rows, covariance, rows)
    if len(model.edges):
        knots, template, (more, step) = model.knots, model.template, model.blurred
        top = knots.first + knots.step * (knots.count - 3)
        by_blur, most = rows[:, -1] * covariance[-1, -1], FURTHEST * math.sqrt(covariance[-1, -1])
        shift = by_blur * (rows[:, :-1] @ curve - rows[:, 0]) / (by_blur * rows[:, -1] + spread)
        shift = np.where(np.abs(rows[:, 0]) < VANISHING, np.clip(shift, -most, most), 0.0)
        for n, nu in enumerate(frequency):
            expected = replace(
                template, blur=math.sqrt(max(template.blur**2 + shift[n], 0.0))
            ).bars(PHASES, nu)
            near = np.abs(expected) >= (1 - LEVEL) * np.abs(expected).max()
            share, phase = np.sign(expected[near]) / np.count_nonzero(near), PHASES[near]
            orders = np.arange(1, max(2.0, top / nu + 1e-9), 2)
            harmonics = share @ np.sin(2 * np.pi * np.outer(phase, orders)) * 4 / (np.pi * orders)
            rows[n, :-1] = harmonics @ knots.design(orders * nu, template)
            rows[n, 0] = share @ template.bars(phase, nu)
            rows[n, -1] = curve[0] * (share @ more.template.bars(phase, nu) - rows[n, 0]) / step
        spread = np.einsum("ni,ij,nj->n", rows, covariance, rows)
    return np.abs(rows[:, :-1] @ curve), np.sqrt(np.maximum(spread, 0.0))


def views_contrast(
    data: ChirpData, model: ChirpModel, fit: ChirpFit, frequency: Array
) -> tuple[npt.NDArray[np.int64], Array, Array]:
    """Every view's own contrast near each frequency: its light and its fundamental free, in height
    and phase, its harmonics the template's.

    The fundamental is compared with the template's too, which has no noise and bends as the view's
    own does.

    Args:
        data: the runs of pixels.
        model: of the target.
        fit: of all views together.
        frequency: evenly spaced, cycles/mm, shape (K,).

    Returns:
        Positions of the views in the lattice, shape (V,); contrast and its standard uncertainty,
        shape (V, K), nan where a view does not see that frequency.
    """
    lenses, view = np.unique(data.lens, return_inverse=True)
    step = frequency[1] - frequency[0] if len(frequency) > 1 else math.inf
    x = data.seen_at(fit.geometry)
    cell = np.rint((model.frequency(x) - frequency[0]) / step).astype(np.int64)
    inside = (cell >= 0) & (cell < len(frequency))
    key = (view * len(frequency) + cell)[inside]
    turn = 2 * np.pi * model.phase(x[inside])
    if len(model.edges):
        unit = np.zeros_like(fit.curve)
        unit[0] = 1.0
        share, wave = 4 / np.pi, waves(data, model, fit.geometry, unit, model.top)[inside]
    else:
        share, wave = 1.0, model.template.transfer(model.frequency(x[inside])) * np.sin(turn)
    level = data.light[inside] @ fit.brightness
    rest = data.read[inside] - level * (1 + wave)
    variance, weight = variance_and_weight(data.part(inside), level, level * (1 + wave))
    columns = [level * share * np.sin(turn), level * share * np.cos(turn), level * (1 + wave)]
    size = len(lenses) * len(frequency)

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(key, weights=values, minlength=size), dtype=np.float64)

    normal, scatter = np.zeros((size, 3, 3)), np.zeros((size, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            product = weight * columns[i] * columns[j]
            normal[:, i, j] = normal[:, j, i] = total(product)
            scatter[:, i, j] = scatter[:, j, i] = total(product * weight * variance)
    right = np.stack([total(weight * column * rest) for column in columns], axis=1)
    diagonal = np.maximum(np.sqrt(np.einsum("nii->ni", normal)), 1e-150)
    scaled = normal / diagonal[:, :, None] / diagonal[:, None, :]
    held = (total(np.ones(len(key))) >= FEWEST_RUNS) & (np.linalg.det(scaled) > LEAST_APART)
    inverse = np.linalg.inv(scaled[held]) / diagonal[held][:, :, None] / diagonal[held][:, None, :]
    found, doubt = np.full(size, np.nan), np.full(size, np.nan)
    found[held] = (inverse @ right[held][:, :, None])[:, 0, 0]
    doubt[held] = np.sqrt((inverse @ scatter[held] @ inverse)[:, 0, 0])
    shape, wider = (len(lenses), len(frequency)), np.zeros(len(lenses))
    wider[view] = data.wider
    template = model.template.through(wider, frequency)
    return lenses, template + found.reshape(shape), doubt.reshape(shape)
