"""The published measurements of a Raytrix R12: real input that nobody here made or tuned."""

import json
from pathlib import Path

import numpy as np
import pytest

from flflab.calibration.refit import refit_distances
from flflab.camera_file import read_camera
from flflab.observations.agreement import FrameAgreement, compare_frames, depth_deviation
from flflab.observations.points import PredictedPoints, SeenPoints, measure_points, predict_points
from flflab.observations.reading import Observations, read_observations
from flflab.optics.camera import Camera, microlens_centres, microlens_types

pytestmark = pytest.mark.r12a


@pytest.fixture(scope="module")
def camera(root: Path) -> Camera:
    return read_camera(root / "examples" / "cameras" / "r12a.yaml")


@pytest.fixture(scope="module")
def observations(r12a: Path) -> Observations:
    return read_observations(r12a)


@pytest.fixture(scope="module")
def seen(observations: Observations, camera: Camera) -> SeenPoints:
    return measure_points(observations, camera)


@pytest.fixture(scope="module")
def predicted(camera: Camera, seen: SeenPoints) -> PredictedPoints:
    return predict_points(camera, seen)


@pytest.fixture(scope="module")
def frames(
    observations: Observations, seen: SeenPoints, predicted: PredictedPoints, camera: Camera
) -> dict[int, FrameAgreement]:
    return {
        frame.frame: frame
        for frame in compare_frames(observations, seen, predicted, None, camera.sensor.pixel)
    }


def test_the_camera_file_is_the_published_calibration(r12a: Path, camera: Camera) -> None:
    published = json.loads((r12a / "camera.json").read_text())
    array, sensor = published["microlens_array"], published["sensor"]
    pitch_x, pitch_y = array["pitch_mm"]
    # the data set's own letter
    l, k = np.divmod(np.arange(array["rows"] * array["columns"]), array["columns"])  # noqa: E741
    flat = np.stack([pitch_x * (k - l % 2 / 2), pitch_y * l * np.sqrt(3) / 2, 0 * k], axis=1)
    place = flat @ np.array(array["rotation"]).T + np.array(array["translation_mm"])
    centres = microlens_centres(camera.array)
    assert (
        np.abs(centres - place[:, :2]).max() < 2e-6
    )  # the tilt foreshortens the array by a nanometre
    assert (
        np.abs(camera.array.distance + centres @ np.array(camera.array.tilt) + place[:, 2]).max()
        < 1e-8
    )
    assert np.array_equal(microlens_types(camera.array), (k + l + l // 2) % 3)
    corner = (
        np.array(camera.sensor.offset)
        - (np.array(camera.sensor.resolution) - 1) / 2 * camera.sensor.pixel
    )
    assert corner == pytest.approx(sensor["translation_mm"][:2], abs=1e-9)
    assert camera.sensor.distance == -sensor["translation_mm"][2]
    assert camera.main_lens.focal_length == published["main_lens"]["focal_length_mm"]
    assert camera.main_lens.aperture == pytest.approx(
        published["main_lens"]["aperture_diameter_mm"]
    )


def test_the_array_tilts_as_the_micro_images_of_all_pictures_say(
    r12a: Path, camera: Camera
) -> None:
    # centres on the sensor are y (1 + b/L), and b falls linearly where the array tilts away from
    # the main lens: a quadratic term
    k, l, u, v = np.loadtxt(r12a / "microimage_centres.csv", delimiter=",", skiprows=1, unpack=True)  # noqa: E741
    x, y = 0.1274 * (k - l % 2 / 2 - 87.25), 0.1274 * (l - 75.5) * np.sqrt(3) / 2
    one, none = np.ones(len(x)), np.zeros(len(x))
    first = np.stack([one, x, y, none, none, none, -x * x, -x * y], axis=1)
    second = np.stack([none, none, none, one, x, y, -x * y, -y * y], axis=1)
    fitted, *_ = np.linalg.lstsq(
        np.concatenate([first, second]), np.concatenate([u, v]) * camera.sensor.pixel
    )
    assert fitted[-2:] * camera.array.distance == pytest.approx(camera.array.tilt, rel=0.35)


def test_the_median_number_of_views_is_predicted_in_every_frame(
    frames: dict[int, FrameAgreement],
) -> None:
    assert {number: frame.measured_median for number, frame in frames.items()} == {
        0: 4,
        1: 59,
        2: 27,
        3: 10,
        5: 42,
        6: 19,
        7: 26,
    }
    assert sum(frame.measured_total for frame in frames.values()) == 8660
    assert [number for number, frame in frames.items() if not frame.views_agree] == []


def test_a_frame_without_observations_is_not_invented(
    observations: Observations, frames: dict[int, FrameAgreement]
) -> None:
    assert observations.empty_frames == (4,)
    assert 4 not in frames


def test_virtual_depths_follow_an_independent_evaluation(frames: dict[int, FrameAgreement]) -> None:
    measured = {0: 2.98, 3: 5.2, 5: 11.3, 6: 7.3, 7: 8.8}
    by_model = {
        0: 2.92,
        3: 5.6,
        5: 12.8,
        6: 8.1,
        7: 9.8,
    }  # without the array's tilt, which brings 2 %
    for number in measured:
        assert frames[number].virtual_depth_measured == pytest.approx(measured[number], rel=0.015)
        assert frames[number].virtual_depth_predicted == pytest.approx(by_model[number], rel=0.025)


def test_the_board_leans_the_way_the_parallax_says(
    seen: SeenPoints, predicted: PredictedPoints
) -> None:
    for number in (1, 2, 3, 6):
        tilted = seen.frame == number
        assert np.corrcoef(seen.virtual_depth[tilted], predicted.virtual_depth[tilted])[0, 1] > 0.9
        assert np.corrcoef(seen.views[tilted], predicted.views[tilted])[0, 1] > 0.9


def test_a_refit_of_two_distances_takes_up_the_trend_of_the_virtual_depth(
    camera: Camera, seen: SeenPoints, predicted: PredictedPoints
) -> None:
    known = seen.with_parallax
    refit = refit_distances(
        camera,
        seen.position[known, 2],
        seen.array_position[known],
        seen.slope[known],
        seen.slope_uncertainty[known],
    )
    before, after = (
        depth_deviation(seen, predicted),
        depth_deviation(seen, predict_points(refit.camera, seen)),
    )
    assert before is not None
    assert after is not None
    assert before > 0.10
    assert after < 0.03
    assert refit.correlation < -0.8
    assert refit.loosened["focal_length"][0] > 100 * refit.uncertainty[0]
