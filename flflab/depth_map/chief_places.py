"""Where chief rays land against where the light is found: fall-off across a microlens's aperture
moves the light outwards or inwards, in proportion to the microlens's distance from the axis.

How far depends on what is taken for a micro-image's centre, so it is found by measuring, in the
same way as the real white picture, the one that the camera file predicts, without noise.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.errors import MeasurementError
from flflab.image.effects.falloff import Falloff
from flflab.image.picture import take_picture
from flflab.image.scene import Plane, Scene
from flflab.measurement.lattice.kernel import SOFTER, X, Y
from flflab.measurement.lattice.mean_profile import Profile
from flflab.measurement.lattice.registration import sensor_pixel
from flflab.measurement.lattice.white_picture import measure_white
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, microlens_centres
from flflab.targets import White

Array = npt.NDArray[np.float64]

PITCHES = 24  # across the part of the sensor that is predicted
WHITE_DN, QUIET_DN = 4000.0, 0.5
ANY_MM = 1000.0  # distance of a boundless white target: none matters
TOLERANCE = 0.002
PLATEAU = 0.5  # of the radius, within which light is even
EDGE = 0.25, 0.75  # of the light


@dataclass(frozen=True)
class Predicted:
    """What the measurement makes of the predicted white picture.

    Attributes:
        excess: of the lattice of light over that of chief rays, relative.
        edge_px: median width of the vignetting edges, see ``edge_width``; NaN where not known.
    """

    excess: float
    edge_px: float


def edge_width(profile: Profile) -> float:
    """Width over which the mean micro-image falls from three to one quarter of its light, px."""
    places = profile.step * np.arange(len(profile.table))
    plateau = profile.table[places < PLATEAU * profile.radius, 0]
    light = profile.table[:, 0] / float(np.mean(plateau))
    outside = np.flatnonzero(light > EDGE[1])[-1]
    falling = slice(outside, None)
    at = [float(np.interp(-level, -light[falling], places[falling])) for level in EDGE]
    return at[0] - at[1]


def predicted_white(camera: Camera) -> Predicted:
    """Measure the white picture that a camera file predicts; nothing in excess where it cannot
    be measured.
    """
    scale = 1 + camera.optical_gap / camera.optical_distance
    pitch = min(camera.array.pitch) * scale / camera.sensor.pixel
    columns, rows = (min(size, round(PITCHES * pitch)) for size in camera.sensor.resolution)
    part = replace(camera, sensor=replace(camera.sensor, resolution=(columns, rows)))
    scene = Scene(part, (Plane(White(), ANY_MM),), falloff=Falloff())
    light = take_picture(scene, tolerance=TOLERANCE).image
    noise = SensorNoise(1.0, QUIET_DN, 0.0, 2 * WHITE_DN)
    try:
        found = measure_white((WHITE_DN * light).astype(np.float32), noise)
    except MeasurementError:
        return Predicted(0.0, math.nan)
    seen = found.values[found.whole][:, [X, Y]]
    nominal = sensor_pixel(part.sensor, microlens_centres(part.array) * scale)
    _, nearest = KDTree(nominal).query(seen)
    due = nominal[nearest] - nominal[nearest].mean(axis=0)
    excess = float(np.sum(due * (seen - nominal[nearest])) / np.sum(due**2))
    softer = float(np.median(np.exp(found.values[found.whole, SOFTER])))
    return Predicted(excess, softer * edge_width(found.profile))
