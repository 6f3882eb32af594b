"""The target itself: how large dots and bars are imaged, and how the target is turned.

A longer lens and a nearer target move the sharp plane alike, and scale the image differently.
"""

import numpy as np

from flflab.measurement.lattice.registration import target_scales
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Values, single

MRAD = 1e3
# share by which unequal microlenses leave the scale of bars open: at 1 % of focal length 0.5e-4 to
# 2e-4 were seen, where noise leaves 1e-5
BARS_APART = 2e-4


def target(one: Measured, model: Predicted, repeat: float = 0.0) -> list[Values]:
    """Scale of the images of dots and of bars over the camera's, and the target's roll, mrad; what
    too few views tell is left out.

    Args:
        one: the configuration.
        model: what the model says of it.
        repeat: to what the stages repeat, mm: bars may be taken after another approach than dots.
    """
    index = one.configuration.index
    found: list[Values] = []
    if one.dot_scale is not None:
        drawn, scale = model.dot_scale_draws, one.dot_scale
        found += [
            single(index, "dot_scale", "four-dot", scale.size, scale.size_uncertainty, drawn),
            single(
                index, "target_roll_mrad", "four-dot", MRAD * scale.turn,
                MRAD * scale.size_uncertainty, MRAD * model.roll_draws,
            ),
        ]  # fmt: skip
    if one.curve is not None:
        across, _ = target_scales(model.camera, model.distance)
        ratio = float(across / one.curve.geometry[1])
        doubt = ratio * abs(float(one.curve.geometry_uncertainty[1] / one.curve.geometry[1]))
        doubt = float(np.hypot(np.hypot(doubt, ratio * BARS_APART), 2 * repeat / model.camera.gap))
        drawn = model.bar_scale_draws
        if np.isfinite(doubt) and doubt > 0:
            found.append(single(index, "bar_scale", "bars", ratio, doubt, drawn))
    return found
