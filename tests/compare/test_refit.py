from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import numpy.typing as npt
import pytest

from flflab.calibration.refit import (
    Refit,
    depend_on_selection,
    parallax_slope,
    refit_distances,
    state_refit,
)
from flflab.errors import MeasurementError
from flflab.files.camera import read_camera
from flflab.observations.points import measure_parallax, measure_points
from flflab.observations.prediction import align
from flflab.observations.reading import read_observations
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]
DISTANCES = np.repeat([250.0, 270.0, 300.0, 350.0, 380.0], 8)
CENTRE = np.zeros((len(DISTANCES), 2))


@pytest.fixture(scope="module")
def camera(traced: Path) -> Camera:
    return read_camera(traced / "camera.yaml")


def refit_to(
    slope: Array, camera: Camera, distance: Array = DISTANCES, uncertainty: float = 1e-3
) -> Refit:
    return refit_distances(
        camera, distance, np.zeros((len(distance), 2)), slope, np.full(len(distance), uncertainty)
    )


@pytest.mark.parametrize("distance", [20.0, 50.0, 60.0, 310.0, 434.0, 1e4])
@pytest.mark.parametrize("array", [45.0, 56.5, 60.0])
def test_the_slope_is_one_less_the_gap_over_the_image_distance_in_fifty_digits(
    distance: float, array: float
) -> None:
    with mpmath.workdps(50):
        behind = (
            mpmath.inf if distance == 50 else 1 / (1 / mpmath.mpf(50) - 1 / mpmath.mpf(distance))
        )
        true = 1 - mpmath.mpf("0.6") / (behind - mpmath.mpf(array))
        assert parallax_slope(array, 0.6, 50.0, np.array([distance]))[0] == pytest.approx(
            float(true), rel=1e-12
        )


def test_a_refit_from_a_wrong_camera_finds_the_distances_within_their_uncertainties(
    noisy: Path, camera: Camera
) -> None:
    wrong = replace(
        camera,
        array=replace(camera.array, distance=camera.array.distance + 0.15),
        sensor=replace(camera.sensor, distance=57.3),
    )
    seen = measure_points(read_observations(noisy), wrong)
    slopes = measure_parallax(seen, wrong)
    found = refit_distances(
        wrong,
        align(camera, seen).position[:, 2],
        slopes.array_position,
        slopes.slope,
        slopes.uncertainty,
    )
    error = np.array(
        [found.camera.array.distance - camera.array.distance, found.camera.gap - camera.gap]
    )
    assert error @ np.linalg.inv(found.covariance) @ error < 9.2  # 99 % of a chi-square of two
    assert found.scatter == pytest.approx(1.0, abs=0.5)
    assert found.points == 80


def test_the_covariance_is_that_of_repeated_refits(camera: Camera) -> None:
    rng = np.random.default_rng(4)
    true = parallax_slope(
        camera.array.distance, camera.gap, camera.main_lens.focal_length, DISTANCES
    )
    runs = [refit_to(true + 1e-3 * rng.standard_normal(len(true)), camera) for _ in range(200)]
    spread = np.cov(np.array([(run.camera.array.distance, run.camera.gap) for run in runs]).T)
    expected = np.mean([run.covariance for run in runs], axis=0)
    assert np.sqrt(np.diag(spread) / np.diag(expected)) == pytest.approx(1.0, abs=0.15)
    assert spread[0, 1] / expected[0, 1] == pytest.approx(1.0, abs=0.3)


def test_points_at_one_distance_leave_the_distances_undetermined(camera: Camera) -> None:
    distance = np.full(20, 300.0)
    slope = parallax_slope(
        camera.array.distance, camera.gap, camera.main_lens.focal_length, distance
    )
    with pytest.raises(MeasurementError, match="undetermined; points at different distances"):
        refit_to(slope, camera, distance)


def test_two_points_are_refused(camera: Camera) -> None:
    with pytest.raises(MeasurementError, match="2 points with parallax given; at least 3"):
        refit_to(np.array([0.8, 0.9]), camera, np.array([300.0, 320.0]))


def test_what_two_distances_cannot_tell_is_said(camera: Camera) -> None:
    distance = np.repeat([270.0, 330.0], 10)
    slope = parallax_slope(
        camera.array.distance, camera.gap, camera.main_lens.focal_length, distance
    )
    slope += 1e-3 * np.random.default_rng(1).standard_normal(20)
    said = " ".join(state_refit(camera, refit_to(slope, camera, distance)))
    assert said.count("neither is determined") == 2


def test_a_further_free_parameter_loosens_both_distances(camera: Camera) -> None:
    slope = parallax_slope(
        camera.array.distance, camera.gap, camera.main_lens.focal_length, DISTANCES
    )
    slope += 1e-3 * np.random.default_rng(1).standard_normal(len(slope))
    found = refit_to(slope, camera)
    for name in ("focal_length", "distance_offset"):
        assert np.all(found.loosened[name] > found.own)


def test_how_the_distances_change_with_the_views_used_is_part_of_their_uncertainty(
    camera: Camera,
) -> None:
    slope = parallax_slope(
        camera.array.distance, camera.gap, camera.main_lens.focal_length, DISTANCES
    )
    noisy = slope + 1e-3 * np.random.default_rng(1).standard_normal(len(slope))
    found, other = refit_to(noisy, camera), refit_to(1.02 * noisy - 0.02, camera)
    both = depend_on_selection(found, other, 0.03)
    moved = np.array([other.camera.array.distance, other.camera.gap]) - [
        found.camera.array.distance,
        found.camera.gap,
    ]
    assert np.abs(moved[1]) > 3 * found.own[1]
    assert both.uncertainty == pytest.approx(np.hypot(found.own, np.abs(moved) / np.sqrt(3)))
    assert f"b by {moved[1]:+.5f} mm" in " ".join(state_refit(camera, both))
