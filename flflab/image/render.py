"""The picture of a scene without noise: by closed forms or by rays, as the scene calls for, and
what changes the finished picture, in the order of the light.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.accuracy import TOLERANCE, check_tolerance
from flflab.image.effects.effect import Finishing, Formed
from flflab.image.microlenses import Lenses, camera_lenses, is_lit
from flflab.image.path import Light, form
from flflab.image.scene import ALL, FINISHING, Plane, Scene, without
from flflab.targets import White

Array = npt.NDArray[np.float64]


def render(scene: Scene, *, tolerance: float = TOLERANCE, effects: frozenset[str] = ALL) -> Array:
    """Form the picture of a scene without noise.

    Args:
        scene: camera and targets; what has a size in mm is a point and black at infinity.
        tolerance: root mean square of the error over lit pixels, of the white level. Scenes formed
            by rays stop at 256 of them a pixel.
        effects: what is formed; an effect that the scene does not have changes nothing.

    Returns:
        Irradiance [row, column] in units of the white level: that at the centre of the micro-image
            nearest the axis under a boundless white target, without its neighbours' light.

    Raises:
        InputError: the apertures are not round, a number is impossible, an effect is unknown, or a
            tilted array reaches through the sensor.
    """
    return render_light(scene, tolerance, effects).image


def render_light(scene: Scene, tolerance: float, effects: frozenset[str]) -> Light:
    """``render``, and by which path."""
    pictured = without(scene, effects)
    shape = pictured.camera.aperture_shape
    if shape != "round":
        raise InputError(
            f"render: images are formed for round apertures only, not {shape}; set aperture_shape:"
            " round"
        )
    check_tolerance(tolerance)
    light = form(pictured, tolerance, effects)
    finish(light.image, pictured, tolerance, effects)
    return light


def finish(image: Array, scene: Scene, tolerance: float, effects: frozenset[str] = ALL) -> None:
    """Apply what changes a finished picture, in place."""

    def white(before: int) -> Array:
        plane = Plane(White(), scene.planes[0].distance)
        later = {name.replace("-", "_"): None for name in FINISHING[before:]}
        bare = replace(scene, planes=(plane,), distortion=None, motion=None, **later)
        return render_light(bare, tolerance, effects).image

    def lenses() -> Lenses:
        found = camera_lenses(scene.camera, 0.0, scene.scatter, "overlap" in effects)
        return found[is_lit(found)]

    for place, name in enumerate(FINISHING):
        effect: Finishing | None = getattr(scene, name.replace("-", "_"))
        if effect is not None:
            effect.apply(image, Formed(scene.camera, lambda place=place: white(place), lenses))
