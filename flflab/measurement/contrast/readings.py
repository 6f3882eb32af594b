"""Readings of a fitted chirp: every view's own contrast, eq. (2)'s (max - min)/(max + min) without
noise, and the classic one off the single pixels.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.contrast.fit import (
    BLUR,
    DISC,
    FREE,
    GEOMETRY,
    SHIFT,
    STRENGTH,
    Equations,
    Fit,
    Model,
    amplitude,
    inverse_of,
    look_at,
    nodes_of,
    weights,
)
from flflab.measurement.contrast.frame import Frame
from flflab.measurement.contrast.runs import Runs
from flflab.measurement.contrast.wave import seen_through, transfer, widened
from flflab.measurement.lattice.registration import PixelSet
from flflab.optics.contrast import cone_half_angle, lost_over_edges
from flflab.targets import Bars

Array = npt.NDArray[np.float64]

FREQUENCIES = 16
FEWEST_PIXELS = 4  # of a view near a frequency
ASTRAY = 3e-3  # of contrast, left beyond noise in a view that the fit does not follow
SURELY = 3.0  # standard deviations of noise
PHASES = np.arange(1, 128) / 256  # of half a cycle, its middle among them
VANISHING = 0.1  # contrast below which the fundamental does not say how strong harmonics are
CYCLES = 200  # of bars of one frequency, so that no end of them is near


@dataclass(frozen=True)
class Views:
    """Every view's own contrast.

    Attributes:
        contrast: shape (V, K), nan where a view does not see that frequency.
        pixels: how many look there, shape (V, K).
        own: variance that a view's own numbers leave open, and what is left of it beyond noise,
            shape (V, K).
        by_common: how it follows what is common, its own numbers with it, shape (V, K, 17).
        common: covariance of that, shape (17, 17).
        astray: which views the fit does not follow, shape (V,).
    """

    contrast: Array
    pixels: Array
    own: Array
    by_common: Array
    common: Array
    astray: npt.NDArray[np.bool_]

    @property
    def variance(self) -> Array:
        """Of each contrast, shape (V, K)."""
        return self.own + np.einsum(
            "vkp,pq,vkq->vk", self.by_common, self.common, self.by_common, optimize=True
        )

    def mean(self, share: Array) -> tuple[Array, Array]:
        """Contrast, shape (K,), and its covariance, (K, K), of the mean by these shares, (V, K)."""
        along = np.einsum("vk,vkp->kp", share, self.by_common)
        own = np.diag(np.sum(share**2 * self.own, axis=0))
        mean = np.sum(share * np.nan_to_num(self.contrast), axis=0)
        return mean, own + along @ self.common @ along.T


def views_of(runs: Runs, model: Model, fit: Fit, found: Equations, nu: Array) -> Views:
    """Read every view's contrast near evenly spaced frequencies off the fit.

    Args:
        runs: of pixels.
        model: of the picture.
        fit: of all views.
        found: the fit's equations.
        nu: cycles/mm, shape (K,).
    """
    pixels, beyond = _beyond_noise(runs, model, fit, nu)
    pixel, squares, nodes = model.pixel_seen(fit), fit.squares[:, None], nodes_of(model.target)
    disc, strength = transfer(nu, pixel, squares), fit.common[STRENGTH]
    free = np.array([np.interp(nu, nodes, one) for one in np.eye(len(nodes))]).T
    contrast, wider = strength * disc, strength * widened(nu, pixel, squares)
    contrast = np.where(pixels > 0, contrast + free @ fit.common[FREE], np.nan)
    inverse, common, _ = found.eliminated()
    own = wider**2 * inverse[:, BLUR, BLUR, None] + beyond**2
    by_common = -wider[..., None] * (inverse[:, BLUR, None] @ found.mixed)
    by_common[..., DISC] += wider
    by_common[..., STRENGTH] += disc
    by_common[..., FREE] += free
    astray = np.any(beyond > ASTRAY, axis=1)
    return Views(contrast, pixels, own, by_common, inverse_of(common), astray)


def _beyond_noise(runs: Runs, model: Model, fit: Fit, nu: Array) -> tuple[Array, Array]:
    """How many pixels of each view look near each frequency, and how much of its fundamental the
    fit leaves there beyond noise, as contrast, both of shape (V, K): in step with the fit's bars or
    a quarter of a cycle aside, whatever blurs them.
    """
    seen, target = look_at(runs, model, fit), model.target
    step = nu[1] - nu[0] if len(nu) > 1 else math.inf
    cell, shape = np.rint((target.frequency(seen.x) - nu[0]) / step), (len(fit.own), len(nu))
    near = np.flatnonzero((cell >= 0) & (cell < len(nu)))
    key = runs.view[near] * len(nu) + cell[near].astype(np.int64)

    def total(values: Array) -> Array:
        every = np.bincount(key, values[near], minlength=shape[0] * shape[1])
        return every.reshape(shape).astype(np.float64)

    size, turn = amplitude(target) * seen.level * runs.pixels, 2 * np.pi * target.phase(seen.x)
    waves = size * np.sin(turn), size * np.cos(turn)
    powers = [total(wave**2 / runs.pixels) + 1e-9 for wave in waves]
    left = [
        total(wave * (runs.read - seen.due)) / power
        for wave, power in zip(waves, powers, strict=True)
    ]
    noise = np.sqrt(total(waves[0] ** 2 * weights(runs, seen)[0])) / powers[0]
    return total(runs.pixels), np.maximum(np.hypot(*left) - SURELY * noise, 0.0)


def frequencies_of(runs: Runs, model: Model) -> Array:
    """In cycles/mm, from the target's own grid, not the picture's, so that two pictures of one
    target can be compared frequency by frequency.

    Raises:
        MeasurementError: none of them is seen.
    """
    nu = np.linspace(*model.target.cycles_per_mm, FREQUENCIES + 2)[1:-1]
    nominal = model.target.frequency(runs.places @ model.mean[GEOMETRY])
    low, high = float(nominal.min()), float(nominal.max())
    if not np.any((nu >= low) & (nu <= high)):
        raise MeasurementError(
            f"{model.target.kind} picture: it shows {low:.3g} to {high:.3g} cycles/mm, too little"
            " of the target; choose a smaller one"
        )
    return nu[(nu >= low) & (nu <= high)]


def misfit_of_all(runs: Runs, model: Model, fit: Fit) -> tuple[float, float]:
    """Chi squared over what noise makes of it, and the rms of what is left beyond noise, as a
    share of the light.
    """
    seen = look_at(runs, model, fit)
    variance, weight = weights(runs, seen)
    left = (runs.read - seen.due) ** 2
    free = max(1 - (fit.own.size + len(fit.common)) / len(left), 0.1)
    chi2 = float(weight @ left) / (float(weight @ variance) * free)
    light = abs(float(np.mean(seen.level)))
    return chi2, math.sqrt(float(np.mean(left)) * max(1 - 1 / max(chi2, 1e-9), 0.0)) / light


def extremes_of(model: Model, fit: Fit, nu: Array) -> Array:
    """Largest excursion of fitted bars of one frequency over all phases, over their contrast, shape
    (K,).

    Args:
        model: of the picture.
        fit: of all views.
        nu: cycles/mm, shape (K,).
    """
    pixel, square = model.pixel_seen(fit), float(np.mean(fit.squares))
    ratio = np.ones(len(nu))
    for k, one in enumerate(nu if model.target.kind == "bars" else ()):
        even = Bars((one, one), CYCLES / one)
        seen, _, _ = seen_through(even, PHASES / one, pixel, np.full(len(PHASES), square))
        left = abs(float(transfer(np.array(one), pixel, np.array(square))))
        ratio[k] = np.abs(seen).max() / max(left, VANISHING)
    return ratio


def classic_reading(frame: Frame, pixels: PixelSet, frequency: Array, nu: Array) -> Array:
    """(max - min)/(max + min) of each view's pixels near each frequency, mean over the views, shape
    (K,).

    Args:
        frame: the picture.
        pixels: that look at the target.
        frequency: that each looks at, cycles/mm.
        nu: evenly spaced, cycles/mm.
    """
    even = np.ones((2, 2)) if frame.gains is None else frame.gains
    read = np.asarray(frame.values[pixels.rows, pixels.columns], dtype=np.float64)
    value = (read - frame.noise.offset_dn) / even[pixels.rows % 2, pixels.columns % 2]
    step = nu[1] - nu[0] if len(nu) > 1 else math.inf
    cell = np.rint((frequency - nu[0]) / step)
    used = np.flatnonzero((cell >= 0) & (cell < len(nu)) & (read < frame.noise.full_scale_dn))
    key = pixels.lens[used] * len(nu) + cell[used].astype(np.int64)
    shape = int(pixels.lens.max()) + 1, len(nu)
    high, low = np.full(shape, -np.inf), np.full(shape, np.inf)
    np.maximum.at(high.reshape(-1), key, value[used])
    np.minimum.at(low.reshape(-1), key, value[used])
    number = np.bincount(key, minlength=high.size).reshape(shape)
    counts = number >= np.maximum(FEWEST_PIXELS, number.max(axis=0) / 2)
    high, low = (np.where(counts, ends, 0.0) for ends in (high, low))
    counts &= high + low > 0
    ratio = (high - low) / np.where(counts, high + low, np.inf)
    seen = counts.sum(axis=0)
    return ratio.sum(axis=0) / np.where(seen > 0, seen.astype(np.float64), np.nan)


def lost_light(frame: Frame, runs: Runs, fit: Fit, nu: Array) -> Array:
    """Share of the mean light that diffraction takes from the runs near each frequency over the
    target's edges, beyond which it is dark, shape (K,).
    """
    if frame.wavelength is None:
        return np.zeros(len(nu))
    target = frame.target
    ends = np.array([target.width, target.height]) / 2
    x = runs.places @ fit.common[GEOMETRY] + fit.own[runs.view, SHIFT]
    up = runs.places[:, 2] * fit.common[1] + runs.places[:, 4] * fit.common[3]
    seen = np.stack([x, up], axis=1)
    away = np.stack([ends - seen, ends + seen], axis=2).reshape(-1, 4) * frame.scale
    half_angle = float(cone_half_angle(frame.smms, 1 / frame.distance))
    lost, at = lost_over_edges(away, half_angle, frame.wavelength), target.frequency(x)
    near = float(np.ptp(target.cycles_per_mm)) / FREQUENCIES / 2
    return np.array([float(np.mean(lost[np.abs(at - one) <= near])) for one in nu])
