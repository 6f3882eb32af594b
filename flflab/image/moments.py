"""Moments of an exposure in which the targets move: standing scenes whose pictures have the moving one's as their mean."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.image.effects.motion import Motion
from flflab.image.pupil import camera_pupils
from flflab.image.scene import Scene

Array = npt.NDArray[np.float64]


def moments(scene: Scene, tolerance: float, effects: frozenset[str]) -> tuple[Scene, ...]:
    """Scenes of equal weight, one for each of ``places_of`` the motion; the scene itself where diffraction forms the motion with the light.

    Cards uncover what is behind them as they move: with them every moment is formed, with diffraction too.
    """
    motion = scene.motion
    if motion is None or is_formed_at_once(scene):
        return (scene,)
    still = replace(scene, motion=None)
    return tuple(_moved(still, place) for place in places_of(motion, _smear(scene, effects), tolerance))


def is_formed_at_once(scene: Scene) -> bool:
    """Whether motion is formed with the light, in closed form."""
    return scene.diffraction is not None and len(scene.planes) == 1 and scene.planes[0].size is None


def places_of(motion: Motion | None, smear: float, tolerance: float) -> Array:
    """Where the targets are looked at, mm from their middle places, shape (N, 2): the mean over the places is that over the exposure.

    The places are midpoints of equal times of the even drift, and of equal phases of the sine (Gauss's rule for its density), so many
    that the mean of their pictures is as near as the tolerance asks: n of them leave about S / (4 n^2) of white where sharp edges
    wander over S times the width to which pixel and blur smooth them (measured on edges and bars boxed by a pixel, where Gauss's rule
    for the drift is worse), a half more for the sine.

    Args:
        motion: of the targets; None for none.
        smear: over how many widths of a smoothed edge the picture moves when the target moves by 1 mm.
        tolerance: largest error asked for, of white.
    """
    if motion is None:
        return np.zeros((1, 2))
    drift = _count(math.hypot(*motion.drift) * smear / tolerance)
    vibration = _count(1.6 * 2 * math.hypot(*motion.vibration) * smear / tolerance)
    return _places(motion, drift, vibration)


def _count(demand: float) -> int:
    return max(1, math.ceil(math.sqrt(demand)))


def _smear(scene: Scene, effects: frozenset[str]) -> float:
    """Over how many widths of a smoothed edge the picture moves when the target moves by 1 mm; the most among all microlenses."""
    most = 0.0
    for plane in scene.planes:
        if math.isfinite(plane.distance):
            pupils = camera_pupils(scene.camera, 1 / plane.distance, scene.scatter)
            blur = np.abs(pupils.spread) * (math.pi / 2 if "defocus" in effects else 0.0)
            width = plane.distance * np.maximum(np.abs(pupils.scale) * scene.camera.sensor.pixel, blur)
            most = max(most, float((1 / width[width > 0]).max(initial=0.0)))
    return most


def _places(motion: Motion, drift: int, vibration: int) -> Array:
    """How far the targets are from their middle places, mm, shape (drift * vibration, 2)."""
    even = (np.arange(drift) + 0.5) / drift - 0.5
    swing = np.cos(np.pi * (np.arange(vibration) + 0.5) / vibration) if vibration > 1 else np.zeros(1)
    places = even[:, None, None] * np.array(motion.drift) + swing[None, :, None] * np.array(motion.vibration)
    return places.reshape(-1, 2)


def _moved(scene: Scene, by: Array) -> Scene:
    planes = [replace(plane, offset=(plane.offset[0] + float(by[0]), plane.offset[1] + float(by[1]))) for plane in scene.planes]
    return replace(scene, planes=tuple(planes))
