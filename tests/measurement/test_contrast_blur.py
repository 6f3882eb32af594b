"""The blur that bars are seen through: found where the misfit is least, and how unsure it makes
what is fitted with it.
"""

import math

import numpy as np
import numpy.typing as npt
import pytest

from flflab.measurement.contrast.blur import with_blur_unsure
from flflab.measurement.contrast.data import ChirpData
from flflab.measurement.contrast.fit import (
    ChirpFit,
    ChirpModel,
    Knots,
    Prior,
    noise_covariance,
    waves,
)
from flflab.measurement.contrast.template import Template, dimming_slope_at, edges_of
from flflab.measurement.lowest import lowest
from flflab.targets import Bars

Array = npt.NDArray[np.float64]


def few_runs(
    blur_px: float, runs: int, dark: float
) -> tuple[ChirpData, ChirpModel, ChirpFit, Prior]:
    """Runs across one bright field, the bars of 2 to 10 cycles/mm in it, and what fits them;
    nothing is known before.
    """
    pixel, target = 0.06, Bars(width=12.0, height=8.0)
    template, law, knots = (
        Template(pixel, blur_px * pixel),
        (0.5, 9.5 / 12, -6.0),
        Knots(1.0, 0.6, 48),
    )
    model = ChirpModel(law, (1.0, 10.0), 27.0, edges_of(target), template, knots)
    geometry, brightness = (
        np.array([0.0, 36.0, 0.0, -8.3, 0.0]),
        np.array([3000.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
    )
    fit = ChirpFit(geometry, brightness, np.append(1.0, np.zeros(knots.count)))
    even, whole = np.ones(runs), np.zeros(runs, dtype=np.int64)
    places = np.stack([even, np.linspace(-0.13, 0.13, runs), 0 * even, 0 * even, 0 * even], axis=1)
    light = np.stack([even] + 5 * [0 * even], axis=1)
    data = ChirpData(
        3000 * even, places, light, dark * even, 0.3 * even, whole, whole, 100 * even,
        0 * even, 0 * even,
    )  # fmt: skip
    size = len(geometry) + len(brightness) + len(fit.curve)
    return data, model, fit, Prior(np.zeros(size), np.full(size, 1e6))


def test_runs_too_few_to_show_the_blur_by_harmonics_know_it_as_the_transfer_does() -> None:
    """A dozen runs are followed by the parameters whatever the blur: one bench's contrast was
    unsure by 10^8.
    """
    data, model, fit, prior = few_runs(0.0, 12, 1.0)
    covariance = with_blur_unsure(
        data, model, fit, prior, np.zeros((len(prior.mean), len(prior.mean)))
    )
    # without a disc, as one of 0.1 px and one of 0.2 px differ
    assert math.sqrt(covariance[-1, -1]) == pytest.approx((0.2**2 - 0.1**2) * 0.06**2, rel=1e-3)


@pytest.mark.parametrize("dark", [0.1, 300.0])
def test_a_fitted_blur_is_as_unsure_as_if_it_were_a_parameter_more(dark: float) -> None:
    """By the whole matrix of derivatives: with the weights the fit has and the noise there is,
    little or much of it.
    """
    data, model, fit, prior = few_runs(1.2, 3000, dark)
    covariance, _ = noise_covariance(data, model, fit, prior)
    found = with_blur_unsure(data, model, fit, prior, covariance)

    def read(step: Array) -> Array:
        part = ChirpFit(
            fit.geometry + step[:5], fit.brightness + step[5:11], fit.curve + step[11:-1]
        )
        wider = model.with_blur(math.sqrt(model.template.blur**2 + step[-1]))
        return (
            3000
            * (1 + step[5] / 3000)
            * (1 + waves(data, wider, part.geometry, part.curve, model.top))
        )

    sizes = np.concatenate(
        [[1e-5, 1e-3, 1e-3, 1e-3, 1e-3], np.full(6, 1.0), np.full(len(fit.curve), 1e-3), [1e-5]]
    )
    by = np.stack([(read(one) - read(-one)) / (2 * one.max()) for one in np.diag(sizes)], axis=1)
    variance = dark + 0.3 * read(np.zeros(len(sizes)))
    weight = 1 / (variance + 3.0**2)
    tie = np.diag(np.append(prior.spread**-2.0, ((1.3**2 - 1.2**2) * 0.06**2) ** -2))
    scale = np.sqrt(np.diag(by.T @ (weight[:, None] * by) + tie))
    by, tie = by / scale, tie / np.outer(scale, scale)
    inverse = np.linalg.inv(by.T @ (weight[:, None] * by) + tie + 1e-12 * np.eye(len(tie)))
    due = (
        inverse
        @ (by.T @ ((weight**2 * variance)[:, None] * by) + tie)
        @ inverse
        / np.outer(scale, scale)
    )
    seen = [5, *range(11, 11 + len(fit.curve)), len(sizes) - 1]
    assert np.diag(found)[seen] == pytest.approx(np.diag(due)[seen], rel=0.01)


@pytest.mark.parametrize("least", [0.9975, 1.0, 1.02])
def test_where_misfit_is_least_is_found_though_it_is_no_parabola(least: float) -> None:
    """Between places ten standard uncertainties of 0.01 apart: up to two were left, and bars'
    extremes off by as much.
    """
    there = lowest(
        lambda place: 1e4 * (place - least) ** 2 * (1 + place - least), [0.9**2, 1.0, 1.1**2], 0.0
    )
    assert there == pytest.approx(least, abs=3e-4)


@pytest.mark.parametrize("disc", [0.02, 0.15, 0.4])
def test_light_that_grows_across_the_blur_adds_the_slope_of_bars_through_a_disc_that_dims(
    disc: float,
) -> None:
    """By strips of the disc, each a pixel of sharp bars: (1 + k t) in place of 1 adds k B / 8 times
    that slope.
    """
    target, pixel, growth = Bars(width=12.0, height=8.0), 0.06, 0.04
    edges, turn = edges_of(target), (np.arange(20000) + 0.5) * math.pi / 20000
    strips, shares = np.cos(turn), np.sin(turn) ** 2 / np.sum(np.sin(turn) ** 2)
    ends, wave = (
        np.append(edges, target.width / 2),
        np.where(np.arange(len(edges)) % 2 == 0, 1.0, -1.0),
    )
    integral = np.append(0.0, np.cumsum(np.diff(ends) * wave))
    for x in (-4.321, -1.03, 0.57, 2.222, 4.9):
        right, left = (
            np.interp(x + disc / 2 * strips + side * pixel / 2, ends, integral) for side in (1, -1)
        )
        added = growth * float(shares @ (strips * (right - left) / pixel))
        phase = (x + 6.0) * (0.5 + 9.5 / 12 * (x + 6.0) / 2)
        assert growth * disc / 8 * dimming_slope_at(x, phase, edges, pixel, disc) == pytest.approx(
            added, abs=2e-7
        )


def test_a_run_that_looks_past_the_end_of_the_law_has_a_wave_without_end_of_harmonics() -> None:
    """Below 0 cycles/mm every harmonic is below the highest frequency."""
    data, model, fit, _ = few_runs(0.5, 12, 1.0)
    beside = fit.geometry - np.array([8.0, 0.0, 0.0, 0.0, 0.0])
    seen = waves(data, model, beside, fit.curve, model.top)
    assert np.abs(seen).max() <= 1 + 1e-9
