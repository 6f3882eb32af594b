"""One scene's trial of what is promised of ``auto``: its error and its estimate against a finer picture with every effect.

Of a large picture the finer one is formed at some pixels only: the steepest of each of 12 x 12 blocks of ``auto``'s own picture, where
rims and edges are, and ``SPREAD`` drawn at random among all.
"""

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from flflab.image.estimate import finer_picture, steepest_pixels, steepness
from flflab.image.picture import take_picture
from flflab.image.random_scene import RESOLUTION, random_scene
from flflab.image.render import LEAST_TOLERANCE
from flflab.image.scene import Scene

TOLERANCES = (1e-3, 1e-1)  # from which one is drawn, evenly in its logarithm
FINER, FINER_WAVES = 16.0, 8.0  # how much finer than asked for the picture is formed that ``auto`` is held against, at most 1e-5
WHOLE = 1024  # up to so many pixels all of them are formed
SPREAD = 300


@dataclass(frozen=True)
class Trial:
    """A scene tried: tolerance asked for, largest error found and estimated, of white; processor seconds of ``auto``."""

    seed: int
    asked: float
    achieved: float
    estimated: float
    seconds: float

    @property
    def kept(self) -> bool:
        """Whether the error is below the tolerance and not above the estimate."""
        return self.achieved < self.asked and self.achieved <= self.estimated

    @property
    def telling(self) -> bool:
        """Whether there is an error to speak of, above a thousandth of the tolerance."""
        return self.achieved > self.asked / 1000


def drawn(seed: int, resolution: tuple[int, int] = RESOLUTION, finest: float = TOLERANCES[0], waves: bool = True) -> tuple[Scene, float]:
    """A random scene and a tolerance for it; without ``waves`` its light is rays."""
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, resolution)
    tolerance = math.exp(rng.uniform(math.log(finest), math.log(TOLERANCES[1])))
    return (scene if waves else replace(scene, diffraction=None)), tolerance


def try_scene(seed: int, resolution: tuple[int, int] = RESOLUTION, finest: float = TOLERANCES[0], waves: bool = True) -> Trial:
    """Take a picture of the scene that is ``drawn``, and hold it against a finer one."""
    scene, tolerance = drawn(seed, resolution, finest, waves)
    began = time.process_time()
    report = take_picture(scene, tolerance=tolerance)
    seconds = time.process_time() - began
    wanted = steepest_pixels(steepness(report.image))
    drawn_pixels = np.random.default_rng(seed).permutation(wanted.size)[: wanted.size if wanted.size <= WHOLE else SPREAD]
    wanted.ravel()[drawn_pixels] = True
    finer = max(tolerance / (FINER if scene.diffraction is None else FINER_WAVES), LEAST_TOLERANCE)
    truth = finer_picture(scene, report.image, finer, wanted, "colour-filter" in report.choice.effects)
    return Trial(seed, tolerance, float(np.abs(report.image - truth)[wanted].max()), report.error_estimate, seconds)
