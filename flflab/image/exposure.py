"""How bright a camera's picture is: the irradiance at the white level, and the electrons it makes."""

import math

from flflab.errors import InputError
from flflab.image.pupil import axis_microlens, limiting_radius
from flflab.optics.camera import Camera
from flflab.optics.smms import camera_smms


def white_irradiance(camera: Camera) -> float:
    """Irradiance at the white level over the exitance of the white target: g^2 / (b^2 + g^2), the squared sine of the cone's half angle.

    g = min(d, A b / (L |kappa|)) / 2 is the radius of the cone in the microlens plane, b the gap (physics.md, E_i on the axis).
    It changes with the f-number where the main lens limits, and with the gap always; the target's distance has no part in it.
    """
    smms = camera_smms(camera)
    index = axis_microlens(smms)
    radius, gap = float(limiting_radius(smms)[index]), float(smms.gap[index])
    return radius**2 / (gap**2 + radius**2)


def electrons_at_white(camera: Camera, exposure_s: float, electrons_per_second: float) -> float:
    """Mean electrons in a pixel at the white level.

    Args:
        camera: the camera.
        exposure_s: exposure time, s.
        electrons_per_second: electrons a pixel would collect each second if it lay on the white target itself.

    Raises:
        InputError: the exposure or the rate is negative or not finite.
    """
    for name, value, unit in (("exposure_s", exposure_s, "s"), ("electrons_per_second", electrons_per_second, "electrons/s")):
        if not (math.isfinite(value) and value >= 0):
            raise InputError(f"electrons_at_white: {name} is {value:g} {unit}; a finite number from 0 up is allowed")
    return white_irradiance(camera) * exposure_s * electrons_per_second
