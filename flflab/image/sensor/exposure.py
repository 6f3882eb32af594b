"""How bright a camera's picture is: the irradiance at the white level."""

from flflab.image.effects.falloff import Falloff
from flflab.image.microlenses import axis_microlens
from flflab.optics.camera import Camera
from flflab.optics.smms import camera_smms


def white_irradiance(camera: Camera, falloff: Falloff | None = None) -> float:
    """Irradiance that 1.0 of a picture stands for, over the exitance of the white target.

    g = min(d, A b / (L |kappa|)) / 2 is the radius of the cone in the microlens plane, b the gap
    (physics.md, E_i on the axis). The irradiance at the centre of the micro-image on the axis is
    the squared sine of the cone's half angle, g^2 / (b^2 + g^2). A picture without fall-off shows
    1.0 there and stands for just that. In a picture with fall-off every ray counts by cos^4: it
    shows b^2 / (b^2 + g^2) there, and its 1.0 stands for the paraxial g^2 / b^2. Either way the
    same electrons come out. It changes with the f-number where the main lens limits, and with the
    gap always; the target's distance has no part in it.

    Args:
        camera: the camera.
        falloff: as in the scene that is pictured.
    """
    smms = camera_smms(camera)
    index = axis_microlens(smms)
    radius, gap = float(smms.limiting_radius[index]), float(smms.gap[index])
    return radius**2 / (gap**2 + (radius**2 if falloff is None else 0.0))
