"""Marginal light: how bright the micro-image in the middle is, from one configuration to the next."""

import numpy as np

from flflab.optics.brightness import irradiance
from flflab.properties.measured import Measured
from flflab.properties.predicted import Predicted
from flflab.properties.values import Values


def light(measured: tuple[Measured, ...], predicted: tuple[Predicted, ...], steadiness: float) -> list[Values]:
    """Irradiance of the cone of marginal rays in each configuration over the geometric mean of all: lamp and target cancel.

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
    unsure = np.array([one.lattice.light_uncertainty_dn / float(one.lattice.light[0]) for one in measured])
    draws = np.stack([np.log(irradiance(model.systems)) for model in predicted], axis=1)
    draws = np.exp(draws - draws.mean(axis=1, keepdims=True))
    ratio = seen / np.exp(np.mean(np.log(seen)))
    doubt = ratio**2 * (steadiness**2 + unsure**2)
    return [
        Values(
            one.configuration.index, "light", "white", ratio[k : k + 1], doubt[k : k + 1, None], draws[:, k].mean(keepdims=True),
            draws[:, k : k + 1], (None,), (None,),
        )
        for k, one in enumerate(measured)
    ]  # fmt: skip
