"""The slow reference of ``render``: rays refracted one by one, summed along straight lines whose
breaks are found exactly.

It shares no formula with the fast path. The light of a pixel through a microlens is an integral
over four coordinates, two on the pixel and two on the microlens. Slices of it are summed line by
line, between the places where stops, cards and borders on the targets cut the lines; the slices
themselves, and the motion's moments, lie at scrambled Sobol points, which converge fast because a
slice's sum is smooth, and repeated scrambling tells how far their mean can be off.
"""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from flflab.errors import InputError
from flflab.image.effects.motion import Motion
from flflab.image.scene import Scene
from flflab.optics.camera import microlens_centres, microlens_types, pixel_positions
from reference_rays.rays import Bundle, Path
from reference_rays.slices import bundle_of, slices_of, sums_of

Array = npt.NDArray[np.float64]

REPEATS = 8  # scramblings of the Sobol points
FEWEST_SLICES, MOST_SLICES = 256, 16384  # of one scrambling
BLOCK = 2048  # slices traced at once


def trace_pixels(
    scene: Scene,
    pixels: npt.NDArray[np.int64],
    *,
    wanted: float = 1e-6,
    mean_light: float | None = None,
) -> tuple[Array, Array]:
    """Trace single pixels of the picture of a scene, without diffraction and noise.

    Args:
        scene: what is pictured.
        pixels: (column, row) of each, shape (K, 2).
        wanted: the uncertainty at which a pixel is done; one that needs too many lines for it stays
            above.
        mean_light: mean of the picture before stray light and filters, for a scene that has stray
            light.

    Returns:
        Irradiance in units of the white level and its standard uncertainty, both of shape (K,).

    Raises:
        InputError: the scene has diffraction, apertures that are not round, or stray light without
            ``mean_light``.
    """
    if scene.diffraction is not None or scene.camera.aperture_shape != "round":
        raise InputError(
            "reference: the scene has diffraction or square apertures; only rays through round ones"
            " are traced, leave them out"
        )
    if scene.stray_light is not None and mean_light is None:
        raise InputError(
            "reference: stray light spreads the mean of the whole picture; give mean_light"
        )
    xs, ys = pixel_positions(scene.camera.sensor)
    white = _white(scene)
    paths = _paths(scene)
    found = [
        _pixel(scene, paths, np.array([xs[column], ys[row]]), wanted * white)
        for column, row in pixels
    ]
    values, uncertainties = np.array(found).reshape(-1, 2).T / white
    if scene.stray_light is not None and mean_light is not None:
        share = scene.stray_light.share
        values, uncertainties = (
            (1 - share) * values + share * mean_light,
            (1 - share) * uncertainties,
        )
    if scene.colour_filter is not None:
        mosaic = scene.colour_filter
        passed = {"r": mosaic.red, "g": mosaic.green, "b": mosaic.blue}
        through = np.array(
            [passed[mosaic.pattern[2 * (row % 2) + column % 2]] for column, row in pixels]
        )
        values, uncertainties = through * values, through * uncertainties
    return values, uncertainties


def _paths(scene: Scene) -> Path:
    """The paths through all microlenses, with the errors that a scatter draws for them: Philox
    keyed by its seed.
    """
    camera = scene.camera
    centres = microlens_centres(camera.array)
    focal_lengths = np.asarray(camera.array.focal_lengths)[microlens_types(camera.array)]
    rise = centres @ np.asarray(camera.array.tilt)
    if scene.scatter is not None:
        draws = np.random.Generator(np.random.Philox(key=scene.scatter.seed)).standard_normal(
            (len(centres), 3)
        )
        focal_lengths = focal_lengths * (1 + scene.scatter.focal_length * draws[:, 0])
        centres = centres + scene.scatter.position * draws[:, 1:]
    gaps, depths = camera.optical_gap - rise, camera.optical_distance + rise
    return Path(
        centres,
        focal_lengths[:, None],
        gaps[:, None],
        depths[:, None],
        camera.main_lens.focal_length,
    )


def _white(scene: Scene) -> float:
    """Area of the microlens nearest the axis that lights the centre of its micro-image, over the
    gap squared, in the ideal array.
    """
    paths = _paths(replace(scene, scatter=None))
    path = paths.of(int(np.argmin(np.round(np.hypot(*paths.centre.T), 9))))
    middle = path.centre * (path.depth + path.gap) / path.depth
    return math.pi * (bundle_of(scene, path, middle).pupil / path.gap[0]) ** 2


def _pixel(scene: Scene, paths: Path, place: Array, wanted: float) -> tuple[float, float]:
    """Light of a pixel and its uncertainty, as areas on a microlens over the gap squared."""
    bundles = [
        bundle_of(scene, paths.of(int(index)), place)
        for index in np.flatnonzero(_lit(scene, paths, place))
    ]
    if not bundles:
        return 0.0, 0.0
    scramblings = [qmc.Sobol(4, rng=repeat) for repeat in range(REPEATS)]
    sums, count, more = np.zeros(REPEATS), 0, FEWEST_SLICES
    while True:
        sums += _sums(
            scene, bundles, np.concatenate([points.random(more) for points in scramblings])
        )
        count += more
        means = sums / count
        uncertainty = float(np.std(means, ddof=1)) / math.sqrt(REPEATS)
        if uncertainty <= wanted or count >= MOST_SLICES:
            return float(means.mean()), uncertainty
        more = 3 * count  # four times as many, of which the first are those summed so far


def _lit(scene: Scene, paths: Path, place: Array) -> npt.NDArray[np.bool_]:
    """Through which microlenses a ray from a pixel can pass the main lens's stop."""
    camera, aside = scene.camera, np.array([1.0, 0.0])
    crossing = paths.on_main_lens(place, paths.centre)
    by_sensor = np.abs(paths.on_main_lens(place + aside, paths.centre) - crossing)[:, 0]
    by_lens = np.abs(paths.on_main_lens(place, paths.centre + aside) - crossing)[:, 0]
    reach = by_sensor * camera.sensor.pixel + by_lens * camera.array.aperture / 2
    return np.hypot(*crossing.T) <= camera.main_lens.aperture / 2 + reach


def _sums(scene: Scene, bundles: list[Bundle], points: Array) -> Array:
    """The light of a pixel in slices at points of the scramblings, one after the other, summed for
    each; shape (REPEATS,).
    """
    light = np.zeros(len(points))
    for first in range(0, len(points), BLOCK):
        block = slice(first, first + BLOCK)
        for bundle in bundles:
            slices = slices_of(bundle, points[block, :2], _moved(scene.motion, points[block, 2:]))
            light[block] += sums_of(scene, slices) / bundle.path.gap[0] ** 2
    return light.reshape(REPEATS, -1).sum(axis=1) / scene.camera.sensor.pixel**2


def _moved(motion: Motion | None, points: Array) -> Array:
    """How far the targets have moved at moments of the exposure and phases of the vibration, both
    from 0 to 1; shape (N, 2).
    """
    if motion is None:
        return np.zeros((len(points), 2))
    sway = np.cos(np.pi * points[:, 1:])
    return (points[:, :1] - 0.5) * np.asarray(motion.drift) + sway * np.asarray(motion.vibration)
