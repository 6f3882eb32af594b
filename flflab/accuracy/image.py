"""What a stated accuracy of a picture costs: ``render`` and two plain sums of rays on four scenes,
against chords summed densely.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_dilation

from flflab.accuracy.chords import integrate_pixels
from flflab.accuracy.ray_sums import grid_rays, random_rays
from flflab.accuracy.scenes import RESOLUTION, bench_scenes
from flflab.accuracy.work_precision import Answer, Method, Problem, Row, work_precision
from flflab.image.picture import take_picture
from flflab.image.render import render
from flflab.image.scene import Scene

PIXELS = 200  # of each scene, that the methods are judged by
NEAR = 3  # pixels round what is lit from which they are drawn
TOLERANCES = (3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5)
RANDOM_RAYS = tuple(float(4**power) for power in range(2, 8))
GRID_RAYS = tuple(float(places**4) for places in (2, 3, 4, 6, 8, 11))
REPEATS = 3
SEED = 1
RENDER, RANDOM, GRID = "render", "random rays", "rays on a grid"


def image_rows(tell: Callable[[str], None]) -> tuple[Row, ...]:
    """Every method on every scene, below a minute on two cores.

    Args:
        tell: is told what is being done.
    """
    rng = np.random.default_rng(SEED)
    methods = (
        Method(RENDER, "tolerance", TOLERANCES, _render, _estimate),
        Method(
            RANDOM,
            "rays",
            RANDOM_RAYS,
            lambda problem, rays: _answer(
                random_rays(problem.scene, problem.pixels, int(rays), rng)
            ),
        ),
        Method(
            GRID,
            "rays",
            GRID_RAYS,
            lambda problem, rays: _answer(
                grid_rays(problem.scene, problem.pixels, round(rays**0.25))
            ),
        ),
    )
    problems = (make_problem(name, scene, rng) for name, scene in bench_scenes(RESOLUTION).items())
    return work_precision(problems, methods, repeats=REPEATS, tell=tell)


def make_problem(name: str, scene: Scene, rng: np.random.Generator) -> Problem:
    """A scene with pixels drawn among those that light reaches and those close to them, and their
    reference values.
    """
    near = np.argwhere(binary_dilation(render(scene, tolerance=TOLERANCES[0]) > 0, iterations=NEAR))
    pixels = near[rng.choice(len(near), PIXELS, replace=False)][:, ::-1].astype(np.int64)
    return Problem(name, scene, pixels, *integrate_pixels(scene, pixels))


def _render(problem: Problem, tolerance: float) -> Answer:
    picture = render(problem.scene, tolerance=tolerance)
    return Answer(
        picture[problem.pixels[:, 1], problem.pixels[:, 0]], int(np.count_nonzero(picture))
    )


def _estimate(problem: Problem, tolerance: float) -> float:
    """What ``flflab image`` prints as its error estimate."""
    return take_picture(problem.scene, tolerance=tolerance).error_estimate


def _answer(values: npt.NDArray[np.float64]) -> Answer:
    return Answer(values, len(values))
