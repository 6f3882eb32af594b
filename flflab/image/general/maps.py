"""How far a target's maps are from what closed forms assume: one scale along its direction and one
across, the same all over a micro-image.
"""

import numpy as np
import numpy.typing as npt

from flflab.image.fast.lines import Lines
from flflab.image.landing import land
from flflab.image.microlenses import Lenses, outside
from flflab.image.scene import Plane, Scene
from flflab.targets import Edge, FourDot

Array = npt.NDArray[np.float64]

SPOKES = 2 * np.pi * np.arange(8) / 8
EDGE = np.stack(
    [np.cos(SPOKES), np.sin(SPOKES)], axis=1
)  # points on the pupil's and the light's edge


def misfit(scene: Scene, plane: Plane, lenses: Lenses, lines: Lines) -> float:
    """Largest distance between where rays end and where the maps say, over the width to which pixel
    and pupil blur a target's edges; that is about how much of white a sharp edge is wrong by.

    Along the direction of a target that varies along one; else along both.
    """
    if not len(lenses):
        return 0.0
    angle = plane.target.angle if isinstance(plane.target, Edge) else 0.0
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    pupil = np.concatenate([EDGE, np.zeros((9, 2)), EDGE])[None]
    light = outside(lenses)[:, None, None]
    sensor = light * np.concatenate([np.zeros((9, 2)), EDGE, EDGE])[None]
    places = land(lenses, plane, scene.distortion, pupil, sensor)
    towards = np.stack([lines["cos"], lines["sin"]], axis=1)[:, None]
    sideways = np.stack([-lines["sin"], lines["cos"]], axis=1)[:, None]
    worst = 0.0
    for direction, axis, name, start in (
        (along, towards, "", "origin"),
        (across, sideways, "across_", "across"),
    ):
        by_sensor, by_pupil = lines[f"{name}sensor"][:, None], lines[f"{name}pupil"][:, None]
        said = lines[start][:, None] + by_sensor * (sensor * axis).sum(axis=2)
        said = said + by_pupil * (pupil * axis).sum(axis=2)
        width = np.hypot(by_sensor * scene.camera.sensor.pixel, by_pupil)
        off = np.abs(places @ direction - said) / np.maximum(width, 1e-300)
        worst = max(worst, float(off.max()))
        if not isinstance(plane.target, FourDot):
            break
    return worst
