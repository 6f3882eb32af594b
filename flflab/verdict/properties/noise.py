"""Noise: how much pixels differ from frame to frame, against the camera's photon transfer."""

import numpy as np

from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Shared, Values, single

# share by which photon transfer leaves a standard deviation open: gains are stated to a few per
# cent, and a noise that is as much off moves no other verdict
KNOWN = 0.03
STRAIGHT = 0.01  # by which noise may depart from a straight line over the light


def noise(one: Measured, model: Predicted) -> list[Values]:
    """Noise over what the camera states; nothing where no target was taken twice."""
    if one.noise is None:
        return []
    draws = np.ones(len(model.vergences))
    doubt = float(np.hypot(np.hypot(one.noise.uncertainty, STRAIGHT), KNOWN))
    shared = Shared("photon transfer", np.array([[KNOWN]]))
    index = one.configuration.index
    return [single(index, "noise", "bars", one.noise.ratio, doubt, draws, shared)]
