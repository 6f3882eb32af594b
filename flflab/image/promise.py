"""One scene's trial of what is promised of ``auto``: its error and its estimate against a finer
picture with every effect.

Of a large picture the finer one is formed at some pixels only: those that the estimate looks at,
the steepest of each of 12 x 12 blocks of ``auto``'s own picture, where rims and edges are, among
them, and ``SPREAD`` drawn at random among all.
"""

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from flflab.image.chooser import choose
from flflab.image.estimate import estimate_error, finer_picture, telling_pixels
from flflab.image.random_scene import RESOLUTION, random_scene
from flflab.image.render import LEAST_TOLERANCE, render
from flflab.image.scene import Scene
from flflab.targets import Picture, Target

TOLERANCES = (1e-3, 1e-1)  # from which one is drawn, evenly in its logarithm
FINER, FINER_WAVES = (
    16.0,
    8.0,
)  # how much finer than asked for the picture is formed that ``auto`` is held against, at most 1e-5
WHOLE = 1024  # up to so many pixels all of them are formed
SPREAD = 2000


@dataclass(frozen=True)
class Trial:
    """A scene tried: tolerance asked for, largest error found and estimated, of white, and
    processor seconds.

    ``seconds`` are those of ``auto`` with its choice and estimate, ``picture`` without the
    estimate, ``every`` those of the same scene with every effect that it has, at the same
    tolerance, and ``every_achieved`` its largest error. The picture that both are held against was
    ``finer`` times finer than asked for.
    """

    seed: int
    asked: float
    achieved: float
    estimated: float
    seconds: float
    picture: float
    every: float
    every_achieved: float
    finer: float

    @property
    def kept(self) -> bool:
        """Whether the error is below the tolerance and not above the estimate."""
        return self.achieved < self.asked and self.achieved <= self.estimated

    @property
    def telling(self) -> bool:
        """Whether there is an error to speak of, above a thousandth of the tolerance."""
        return self.achieved > self.asked / 1000


def drawn(
    seed: int,
    resolution: tuple[int, int] = RESOLUTION,
    finest: float = TOLERANCES[0],
    waves: bool = True,
) -> tuple[Scene, float]:
    """A random scene and a tolerance for it; without ``waves`` its light is rays."""
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, resolution)
    tolerance = math.exp(rng.uniform(math.log(finest), math.log(TOLERANCES[1])))
    return (scene if waves else replace(scene, diffraction=None)), tolerance


def sharpest(target: Target) -> Target:
    """A picture in black and white, which no other is steeper than; other targets as they are."""
    return replace(target, values=target.values.round()) if isinstance(target, Picture) else target


def try_scene(
    seed: int,
    resolution: tuple[int, int] = RESOLUTION,
    finest: float = TOLERANCES[0],
    waves: bool = True,
    finer: float | None = None,
) -> Trial:
    """Take a picture of the scene that is ``drawn``, its pictures in black and white, and hold it
    against a finer one.

    That is ``FINER`` times finer than asked for, in waves ``FINER_WAVES`` times, or so many times.
    """
    scene, tolerance = drawn(seed, resolution, finest, waves)
    scene = replace(
        scene, planes=tuple(replace(plane, target=sharpest(plane.target)) for plane in scene.planes)
    )
    finer = finer or (FINER if scene.diffraction is None else FINER_WAVES)
    marks = [time.process_time()]
    choice = choose(scene, tolerance)
    image = render(scene, tolerance=choice.tolerance, effects=choice.formed)
    marks.append(time.process_time())
    estimated = min(estimate_error(scene, image, choice.tolerance, choice.effects), choice.promised)
    marks.append(time.process_time())
    every = render(scene, tolerance=tolerance)
    marks.append(time.process_time())
    wanted = telling_pixels(image, SPREAD)
    drawn_pixels = np.random.default_rng(seed).permutation(wanted.size)[
        : wanted.size if wanted.size <= WHOLE else SPREAD
    ]
    wanted.ravel()[drawn_pixels] = True
    truth = finer_picture(
        scene,
        image,
        max(tolerance / finer, LEAST_TOLERANCE),
        wanted,
        "colour-filter" in choice.effects,
    )
    errors = [float(np.abs(image - truth)[wanted].max()) for image in (image, every)]
    picture, looking, every_seconds = (float(part) for part in np.diff(marks))
    return Trial(
        seed,
        tolerance,
        errors[0],
        estimated,
        picture + looking,
        picture,
        every_seconds,
        errors[1],
        finer,
    )
