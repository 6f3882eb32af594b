"""Pictures without fine detail: formed at every so many pixels, and read between them.

Behind a wide blur and a wide vignetting edge the light changes over tens of pixels. It is formed at
points of a coarser lattice, each behind a pixel of the sensor's own size, and interpolated by cubic
splines.
"""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_interp_spline

from flflab.image.fast.form import Upright, add_upright, blur_of
from flflab.image.microlenses import outside, set_windows
from flflab.image.scene import Scene
from flflab.optics.camera import Sensor
from flflab.targets import Bars, FourDot, White

Array = npt.NDArray[np.float64]

LEAVES = 0.4  # over the square of the points across a blur, a vignetting edge or a dot
FEWEST = 16  # of these points
OF_A_PERIOD = 6.0  # points across a period of bars, of which a wide blur leaves next to nothing
WORTH = 3  # pixels from point to point, at least
MOST = 32
MARGIN = 2  # points beyond the sensor


def step_of(made: Upright, pixel: float, tolerance: float) -> int:
    """From how many to how many pixels a target is formed; 1 where every pixel is.

    Args:
        made: the target.
        pixel: side of the sensor's pixels, mm.
        tolerance: root mean square of the error over lit pixels, of white.
    """
    widths = [2 * np.abs(made.lenses["slope"]) / pixel]
    plateau = outside(made.lenses) - widths[0] * pixel  # whole of the pupil is seen within it
    if isinstance(made.target, White) and float(plateau.min(initial=math.inf)) < 2 * pixel:
        return 1  # a cone has a tip
    periods = math.inf
    with np.errstate(divide="ignore"):
        per_mm = 1 / (np.abs(made.lines["sensor"]) * pixel)
    if not isinstance(made.target, White):
        widths.append(blur_of(made.lines, pixel))
    if isinstance(made.target, FourDot):
        widths.append(made.target.diameter * per_mm)
    elif isinstance(made.target, Bars):
        finest = max(abs(one) for one in made.target.cycles_per_mm)
        periods = float(per_mm.min(initial=math.inf)) / finest
    least = min(float(one.min(initial=math.inf)) for one in widths)
    points = max(math.sqrt(LEAVES / tolerance), FEWEST)
    step = int(min(least / points, periods / OF_A_PERIOD, MOST))
    return step if step >= WORTH else 1


def add_coarsely(image: Array, scene: Scene, made: Upright, step: int) -> None:
    """Add the light of a prepared target to a picture, formed at every ``step`` pixels."""
    sensor = scene.camera.sensor
    columns, rows = (math.ceil(count / step) + 2 * MARGIN for count in sensor.resolution)
    coarser = Sensor((columns, rows), sensor.pixel * step, sensor.distance, sensor.offset)
    lenses = made.lenses.copy()
    set_windows(lenses, coarser, overlap=True)
    light = np.zeros((rows, columns))
    looked_at = replace(scene, camera=replace(scene.camera, sensor=coarser))
    add_upright(light, looked_at, replace(made, lenses=lenses))
    for axis, count in enumerate(image.shape):
        points = np.arange(light.shape[axis]) - (light.shape[axis] - 1) / 2
        between = make_interp_spline(points * step + (count - 1) / 2, light, axis=axis)
        light = between(np.arange(count))
    image += np.maximum(light, 0.0)
