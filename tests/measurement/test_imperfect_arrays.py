"""Bars and dots behind lenses that differ in place, light and focal length, new arrays for every
picture, against closed forms of each lens and against where the dots are.
"""

import itertools
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.special import j1

from flflab.image.effects.scatter import Scatter
from flflab.image.microlenses import draws_of
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.contrast.curve import ContrastCurve, fit_contrast
from flflab.measurement.dots.views import count_views
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import (
    Camera,
    MainLens,
    MicrolensArray,
    Sensor,
    Useful,
    microlens_centres,
)
from flflab.targets import Bars, BarsAlongY, FourDot, Target, White

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(
    dn_per_electron=0.34125, read_noise_dn=1.02375, offset_dn=64.0, full_scale_dn=4095.0
)
ELECTRONS = 7000.0
FOCUS = 506.7016
PLACES, BRIGHTNESSES, FOCAL_LENGTHS = (0.0, 3e-5, 1e-4, 5e-4), (0.0, 0.018), (0.0, 0.002, 0.01)
BARS = Bars()
EVERY = list(itertools.product(PLACES, BRIGHTNESSES, FOCAL_LENGTHS))


def camera_of(resolution: tuple[int, int]) -> Camera:
    array = MicrolensArray("square", (25, 25), (0.4, 0.4), 0.336, (0.917,), 60.0)
    return Camera(
        MainLens(50.0, 4.0), array, Sensor(resolution, 0.00166, 61.15), "round", Useful(0.5)
    )


def exposed(
    camera: Camera,
    target: Target,
    distance: float,
    offset: tuple[float, float],
    scatter: Scatter,
    rng: np.random.Generator,
) -> npt.NDArray[np.uint16]:
    scene = replace(one_plane(camera, target, distance, offset), scatter=scatter)
    electrons = rng.poisson(np.maximum(render(scene, tolerance=5e-4), 0) * ELECTRONS)
    dn = electrons * NOISE.dn_per_electron + NOISE.offset_dn
    dn = dn + rng.normal(0, NOISE.read_noise_dn, dn.shape)
    return np.clip(np.rint(dn), 0, NOISE.full_scale_dn).astype(np.uint16)


def lens_transfer(camera: Camera, distance: float, frequency: Array, focal: float) -> Array:
    """sinc u times 2 J1(z)/z of the view through one lens of this focal length."""
    b, away, main = camera.gap, camera.array.distance, camera.main_lens.focal_length
    image = 1 / (1 / main - 1 / distance)
    a = away - image
    disc = camera.array.aperture * abs(1 / focal - 1 / b - 1 / a) * b
    scale = abs(b / a * image / distance)
    z = np.pi * disc * frequency / scale + 1e-9
    return np.sinc(frequency * camera.sensor.pixel / scale) * 2 * j1(z) / z


def focal_lengths(camera: Camera, lattice: Lattice, scatter: Scatter) -> Array:
    """Of the lens behind each micro-image."""
    lenses = np.asarray(microlens_centres(camera.array)).reshape(-1, 2)
    middle = (np.asarray(camera.sensor.resolution) - 1) / 2
    landed = lenses * (1 + camera.gap / camera.array.distance) / camera.sensor.pixel + middle
    near = np.argmin(np.sum((lattice.centres_px[:, None] - landed[None]) ** 2, axis=2), axis=1)
    share = scatter.focal_length * draws_of(scatter, len(lenses))[near, 0]
    return camera.array.focal_lengths[0] * (1 + share)


def bars_behind(
    scatter: Scatter, distance: float, resolution: tuple[int, int], target: Bars = BARS
) -> tuple[ContrastCurve, Array, Array]:
    """The curve, its truth (the mean over views by their shares) and every view's."""
    camera, rng = camera_of(resolution), np.random.default_rng(scatter.seed)
    aside = float(rng.uniform(-0.3, 0.3)), float(rng.uniform(-0.3, 0.3))
    white = exposed(camera, White(), distance, (0.0, 0.0), scatter, rng)
    bars = exposed(camera, target, distance, aside, scatter, rng)
    lattice = lattice_behind(camera, white, NOISE)
    curve = fit_contrast(bars, lattice, camera, target, distance, NOISE)
    focal = focal_lengths(camera, lattice, scatter)[curve.views]
    each = np.array([lens_transfer(camera, distance, curve.cycles_per_mm, one) for one in focal])
    return curve, np.sum(curve.views_share * each, axis=0), each


def bars_scores(
    seeds: range, combinations: list[tuple[float, float, float]]
) -> tuple[Array, Array]:
    """Errors of all contrasts, and these over stated uncertainties."""
    errors, scores = list[Array](), list[Array]()
    for seed, (place, bright, focal) in itertools.product(seeds, combinations):
        drawn = 1000 * seed + EVERY.index((place, bright, focal))
        distance = (FOCUS, 520.0)[seed % 2]
        curve, truth, _ = bars_behind(Scatter(focal, place, drawn, bright), distance, (1400, 1100))
        errors.append(curve.contrast - truth)
        scores.append(errors[-1] / curve.uncertainty)
    error, score = np.concatenate(errors), np.concatenate(scores)
    print(
        f"{len(error)} contrasts: rms {np.sqrt(np.mean(error**2)):.5f}, rms z"
        f" {np.sqrt(np.mean(score**2)):.2f}, beyond 3 and 0.005:"
        f" {np.mean((np.abs(score) > 3) & (np.abs(error) > 0.005)):.4f}"
    )
    return error, score


@pytest.mark.ci
@pytest.mark.parametrize("target", [BARS, BarsAlongY()])
def test_each_view_of_bars_shows_its_own_lens(target: Bars) -> None:
    scatter = Scatter(0.01, 1e-4, 5, 0.018)
    curve, truth, each = bars_behind(scatter, FOCUS, (760, 560), target)
    seen = np.isfinite(curve.views_contrast)
    assert np.ptp(each[:, -1]) > 0.2  # views differ by so much
    assert np.abs(curve.views_contrast - each)[seen].max() < 0.01
    off = np.abs(curve.contrast - truth)
    assert np.all((off < 3 * curve.uncertainty) | (off < 0.005))
    assert curve.chi2_per_pixel == pytest.approx(1.0, abs=0.2)


@pytest.mark.full
@pytest.mark.parametrize("combinations", [EVERY[5::6]])
def test_bars_behind_arrays_as_built_are_measured(
    combinations: list[tuple[float, float, float]],
) -> None:
    error, score = bars_scores(range(11, 13), combinations)
    assert np.mean((np.abs(score) > 3) & (np.abs(error) > 0.005)) <= 0.01
    assert not np.any((np.abs(score) > 5) & (np.abs(error) > 0.01))


@pytest.mark.full
@pytest.mark.timeout(0)
def test_bars_behind_arrays_of_every_workmanship_are_measured() -> None:
    error, score = bars_scores(range(100, 110), EVERY)
    assert np.mean((np.abs(score) > 3) & (np.abs(error) > 0.005)) <= 0.01
    assert not np.any((np.abs(score) > 5) & (np.abs(error) > 0.01))


def depth_scores(
    combination: tuple[float, float, float], seeds: range
) -> tuple[Array, Array, Array]:
    """Errors of dots' depth, mm, these over stated uncertainties, and over those without what the
    pictures lack: diffraction, and a tilt too small to be seen.
    """
    place, bright, focal = combination
    errors, scores, alone = list[float](), list[float](), list[float]()
    for seed in seeds:
        distance = (480.0, 507.0, 540.0, 620.0)[seed % 4]
        rng = np.random.default_rng([seed, EVERY.index(combination)])
        scatter = Scatter(focal, place, int(rng.integers(1 << 30)), bright)
        camera, target = camera_of((1400, 1100)), FourDot(0.8, 3.0)
        aside = float(rng.uniform(-0.4, 0.4)), float(rng.uniform(-0.4, 0.4))
        white = exposed(camera, White(), distance, (0.0, 0.0), scatter, rng)
        picture = exposed(camera, target, distance, aside, scatter, rng)
        lattice = lattice_behind(camera, white, NOISE)
        for dot in count_views(picture, lattice, camera, target, distance, NOISE):
            errors.append(float(dot.position_mm[2]) + distance)
            stated, lacking = float(dot.uncertainty_mm[2]), dot.by_cause_mm
            scores.append(errors[-1] / stated)
            rest = stated**2 - lacking["diffraction"][2] ** 2 - lacking["tilt"][2] ** 2
            alone.append(errors[-1] / np.sqrt(rest))
    return np.array(errors), np.array(scores), np.array(alone)


@pytest.mark.ci
def test_depth_behind_lenses_off_their_places_is_as_sure_as_stated() -> None:
    errors, scores, _ = (
        np.concatenate(part)
        for part in zip(
            *(depth_scores((place, 0.018, 0.0), range(3)) for place in PLACES[1:]), strict=True
        )
    )
    assert 0.6 < np.sqrt(np.mean(scores**2)) < 1.4
    assert np.sqrt(np.mean(errors**2)) < 0.06


@pytest.mark.full
@pytest.mark.timeout(0)
def test_depth_behind_arrays_of_every_workmanship_is_as_sure_as_stated() -> None:
    together = list[Array]()
    for combination in EVERY:
        errors, scores, alone = depth_scores(combination, range(20, 40))
        together.append(scores)
        each = float(np.sqrt(np.mean(alone**2)))
        print(
            f"{combination}: rms {np.sqrt(np.mean(errors**2)):.4f} mm, rms z"
            f" {np.sqrt(np.mean(scores**2)):.2f}, by what these pictures hold {each:.2f}"
        )
        assert 0.7 < each < 1.4
    every = np.concatenate(together)
    print(f"rms z {np.sqrt(np.mean(every**2)):.2f}, beyond 3: {np.mean(np.abs(every) > 3):.4f}")
    assert 0.8 < np.sqrt(np.mean(every**2)) < 1.25
    assert np.mean(np.abs(every) > 3) <= 0.01
