"""Marginal light: how bright the micro-image in the middle is, from one configuration to the
next.
"""

import numpy as np
import numpy.typing as npt

from flflab.optics.brightness import irradiance
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Shared, Values, single

Array = npt.NDArray[np.float64]


def light(
    measured: tuple[Measured, ...], predicted: tuple[Predicted, ...], steadiness: float
) -> list[Values]:
    """Irradiance of the cone of marginal rays in each configuration over the mean of all: lamp and
    target cancel.

    Args:
        measured: every configuration.
        predicted: the same.
        steadiness: relative standard uncertainty of the light from one configuration to another.

    Returns:
        One number a configuration; none where there is only one configuration.
    """
    if len(measured) < 2:
        return []
    seen = np.array([float(one.lattice.light[0]) / one.exposure_s for one in measured])
    unsure = np.array(
        [one.lattice.light_uncertainty_dn / float(one.lattice.light[0]) for one in measured]
    )
    draws = np.stack([irradiance(model.systems) for model in predicted], axis=1)
    draws /= draws.mean(axis=1, keepdims=True)
    ratio, by = over_their_mean(seen, np.hypot(steadiness, unsure))
    return [
        single(one.configuration.index, "light", "white", float(ratio[k]),
        float(np.hypot.reduce(by[k])), draws[:, k],
               Shared("light", by[k : k + 1]))
        for k, one in enumerate(measured)
    ]  # fmt: skip


def over_their_mean(read: Array, unsure: Array) -> tuple[Array, Array]:
    """Readings over their mean, and how each of these moves with a standard deviation of each
    reading, which moves the mean too.

    Args:
        read: shape (n,).
        unsure: relative standard uncertainty of each by itself, shape (n,).

    Returns:
        Shapes (n,) and (n, n).
    """
    ratio = read / read.mean()
    return ratio, (np.eye(len(ratio)) - ratio[:, None] / len(ratio)) * ratio * unsure
