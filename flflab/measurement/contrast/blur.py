"""How unsure the parameters of a fitted chirp are because the template's blur was fitted too."""

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.data import ChirpData
from flflab.measurement.contrast.fit import (
    BLUR_STEP,
    CURVE,
    GEOMETRY,
    ChirpFit,
    ChirpModel,
    Prior,
    expected,
    followed,
    variance_and_weight,
)

Array = npt.NDArray[np.float64]

NUDGE = 1e-3  # of a step, so that what the runs change is in proportion to it


def with_blur_unsure(
    data: ChirpData, model: ChirpModel, fit: ChirpFit, prior: Prior, covariance: Array
) -> Array:
    """The covariance of the parameters and, behind them, of the square of the template's disc
    (mm^2), which was fitted too.

    The picture as fitted, without noise, is fitted with a little more blur: how the parameters
    follow, and what is left at every run. As much blur as the noise has of what is left, sum(w left
    noise) / sum(w left^2), the fit takes for the bars', and the parameters with it; w allows for a
    model error, the noise does not (see ``noise_covariance``). Few harmonics leave nothing; the
    transfer itself says the disc to ``BLUR_STEP``. Of a sine, which has no template, the last row
    is 0.
    """
    size = len(covariance)
    whole = np.zeros((size + 1, size + 1))
    whole[:size, :size] = covariance
    if len(model.edges):
        more, step = model.blurred
        before = expected(data, model, fit)
        change = expected(data, more, fit) - before
        follow = -followed(data, model, fit, prior, change)
        part = NUDGE * follow
        nudged = ChirpFit(
            fit.geometry + part[:GEOMETRY],
            fit.brightness + part[GEOMETRY:CURVE],
            fit.curve + part[CURVE:],
        )
        left = change + (expected(data, model, nudged) - before) / NUDGE
        variance, weight = variance_and_weight(data, data.light @ fit.brightness, before)
        away = BLUR_STEP * model.template.pixel
        tied = (
            step
            / ((max(model.template.blur, away) + away) ** 2 - max(model.template.blur, away) ** 2)
        ) ** 2
        seen, noisy = float(weight @ left**2) + tied, weight * variance * left
        moves, shared = (
            np.append(follow, step),
            np.append(followed(data, model, fit, prior, noisy), 0.0) / seen,
        )
        whole += np.outer(moves, moves) * (float((weight * left) @ noisy) + tied) / seen**2
        whole += np.outer(moves, shared) + np.outer(shared, moves)
    return whole
