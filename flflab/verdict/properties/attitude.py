"""How the array is turned against the sensor: roll, yaw and pitch, which the camera file describes
and a mount may not keep.
"""

from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Values, single

MRAD = 1e3


def attitude(one: Measured, model: Predicted) -> list[Values]:
    """Roll, yaw and pitch of the array, mrad; none where the picture shows too few micro-images."""
    if one.attitude is None:
        return []
    angles = one.attitude.angles
    return [
        single(
            one.configuration.index, f"array_{name}_mrad", "white", MRAD * angles[name][0],
            MRAD * angles[name][1],
            MRAD * model.attitude_draws[:, k],
        )
        for k, name in enumerate(("roll", "yaw", "pitch"))
    ]  # fmt: skip
