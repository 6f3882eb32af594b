"""What accuracy costs for a scene of one's own: error against time of its whole frame, as the
chooser forms it, with every effect, by rays, and by plain Monte Carlo.

The reference is rays through shifted grids of the pupil on random lit pixels, two independent sets
of them: the mean of (V - A)(V - B) is the mean squared error without bias.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.accuracy import TOLERANCE, for_forming
from flflab.image.budget import middle_of
from flflab.image.choose import choose
from flflab.image.general.form import Blocks, add_rays, blocks_of, light_at
from flflab.image.general.rays import Points, grid, shifted_grid
from flflab.image.path import Light, prepare
from flflab.image.picture import estimate
from flflab.image.render import render_light
from flflab.image.scene import ALL, Scene

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Tell = Callable[[str], None]

AUTO, EVERY, RAYS, RANDOM = "auto", "every effect", "rays", "Monte Carlo"
TOLERANCES = (2e-2, 5e-3, TOLERANCE, 5e-4, 1e-4)
SIDES = (1, 2, 3, 4, 6, 8)  # points a side of the pupil
RANDOM_RAYS = (16, 64, 256, 1024)
PIXELS = 400
REFERENCE_SIDE = 48  # points a side of the pupil, for each quarter of a pixel
REPEATS = 3
SEED = 1


@dataclass(frozen=True)
class SceneRow:
    """One method at one setting; errors over lit pixels, of white.

    Attributes:
        method: its name.
        requested: tolerance asked for; None where there is none.
        rays: a pixel; None where a tolerance was asked for.
        path: closed forms or rays.
        seconds: for the whole frame, on the wall, warm.
        rms_error: against the reference.
        percentile_99: of the error's size.
        estimate: what the picture says of its own error, root mean square; None where nothing.
    """

    method: str
    requested: float | None
    rays: int | None
    path: str
    seconds: float
    rms_error: float
    percentile_99: float
    estimate: float | None


@dataclass(frozen=True)
class Reference:
    """Values of some lit pixels, twice."""

    rows: Whole
    columns: Whole
    first: Array
    second: Array

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of either set, root mean square, of white."""
        return float(np.sqrt(np.mean((self.first - self.second) ** 2) / 2))

    def error(self, values: Array) -> tuple[float, float]:
        """Root mean square and 99th percentile of the error of values, of white."""
        squared = float(np.mean((values - self.first) * (values - self.second)))
        apart = np.abs(values - (self.first + self.second) / 2)
        return math.sqrt(max(squared, 0.0)), float(np.percentile(apart, 99))


def scene_rows(scene: Scene, tell: Tell) -> tuple[tuple[SceneRow, ...], float]:
    """Every method at every setting, and the reference's uncertainty.

    What multiplies or blurs a finished picture (shading, halo, stray light, filters, gamma) is
    left out.

    Args:
        scene: what is pictured.
        tell: is told what is being done.

    Raises:
        InputError: the scene is dark, or its light bends.
    """
    if scene.diffraction is not None:
        raise InputError(
            "accuracy image: light of one wavelength has no reference of rays; leave `wavelength`"
            " out of the scene"
        )
    scene = replace(
        scene, stray_light=None, colour_filter=None, shading=None, halo=None, gamma=None
    )
    tell("reference")
    blocks = _blocks(scene)
    reference = _reference(scene, blocks)
    rows: list[SceneRow] = []
    for tolerance in TOLERANCES:
        tell(f"tolerance {tolerance:g}")
        rows.append(_as_chosen(scene, reference, tolerance))
        rows.append(_with_every_effect(scene, reference, tolerance))
    tell("rays")
    by_rays = [_by_rays(scene, blocks, reference, side) for side in SIDES]
    of_a_ray = by_rays[-1].seconds / SIDES[-1] ** 2
    tell("Monte Carlo")
    rng = np.random.default_rng(SEED)
    random = [_by_chance(blocks, reference, count, of_a_ray, rng) for count in RANDOM_RAYS]
    return (*rows, *by_rays, *random), reference.uncertainty


def _blocks(scene: Scene) -> Blocks:
    ready = prepare(scene, TOLERANCE)
    if not ready.lenses:
        raise InputError(f"accuracy image: the scene is dark: {ready.why}")
    return blocks_of(scene, ready.lenses, defocus=True, pixel=scene.camera.sensor.pixel)


def _reference(scene: Scene, blocks: Blocks) -> Reference:
    light = render_light(scene, TOLERANCE, ALL).image
    rng = np.random.default_rng(SEED)
    lit = np.flatnonzero(light > 1e-3)
    if not len(lit):
        raise InputError("accuracy image: nothing of the scene is lit; bring its target into sight")
    chosen = rng.choice(lit, min(PIXELS, len(lit)), replace=False)
    rows, columns = np.unravel_index(np.sort(chosen), light.shape)
    first, second = (
        light_at(blocks, rows, columns, lambda: shifted_grid(REFERENCE_SIDE, rng)) for _ in range(2)
    )
    return Reference(rows, columns, first, second)


def _timed(form: Callable[[], Light]) -> tuple[Light, float]:
    """What is formed, and the shortest time, s; the first, which may compile, does not count."""
    light, shortest = form(), math.inf
    for _ in range(REPEATS):
        started = time.perf_counter()
        light = form()
        shortest = min(shortest, time.perf_counter() - started)
        if shortest > 1:
            break
    return light, shortest


def _as_chosen(scene: Scene, reference: Reference, tolerance: float) -> SceneRow:
    choice = choose(scene, tolerance)

    def form() -> Light:
        again = choose(scene, tolerance)
        return render_light(scene, again.tolerance, again.formed)

    light, seconds = _timed(form)
    error = reference.error(light.image[reference.rows, reference.columns])
    return SceneRow(AUTO, tolerance, None, light.path, seconds, *error, estimate(choice, light))


def _with_every_effect(scene: Scene, reference: Reference, tolerance: float) -> SceneRow:
    light, seconds = _timed(lambda: render_light(scene, for_forming(tolerance, 0.0), ALL))
    error = reference.error(light.image[reference.rows, reference.columns])
    return SceneRow(EVERY, tolerance, None, light.path, seconds, *error, None)


def _by_rays(scene: Scene, blocks: Blocks, reference: Reference, side: int) -> SceneRow:
    middle, part = middle_of(scene)
    columns, rows = middle.camera.sensor.resolution
    looked_at = _blocks(middle)

    def form() -> Light:
        image = np.zeros((rows, columns))
        add_rays(image, looked_at, side)
        return Light(image, RAYS, "")

    _, seconds = _timed(form)
    values = light_at(blocks, reference.rows, reference.columns, lambda: grid(side))
    error = reference.error(values)
    return SceneRow(RAYS, None, side * side, RAYS, seconds / part, *error, None)


def _by_chance(
    blocks: Blocks, reference: Reference, count: int, of_a_ray: float, rng: np.random.Generator
) -> SceneRow:
    values = light_at(blocks, reference.rows, reference.columns, lambda: _random_points(count, rng))
    error = reference.error(values)
    return SceneRow(RANDOM, None, count, RAYS, of_a_ray * count, *error, None)


def _random_points(count: int, rng: np.random.Generator) -> Points:
    """Independent points of pupil and pixel."""
    across, along, column, row = rng.random((4, count))
    return Points(2 * across - 1, along, column - 0.5, row - 0.5, False)
