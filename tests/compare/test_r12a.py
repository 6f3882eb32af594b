"""The published measurements of a Raytrix R12: real input that nobody here made or tuned."""

import json
from pathlib import Path

import numpy as np
import pytest

from flflab.cli.compared import Comparison, run_comparison
from flflab.files.camera import read_camera
from flflab.observations.agreement import FrameAgreement
from flflab.optics.camera import Camera, microlens_centres, microlens_types, pixel_positions

pytestmark = pytest.mark.r12a


@pytest.fixture(scope="module")
def camera(root: Path) -> Camera:
    return read_camera(root / "examples" / "cameras" / "r12a.yaml")


@pytest.fixture(scope="module")
def compared(r12a: Path, camera: Camera) -> Comparison:
    return run_comparison(r12a, camera)


@pytest.fixture(scope="module")
def frames(compared: Comparison) -> dict[int, FrameAgreement]:
    return {frame.frame: frame for frame in compared.frames}


@pytest.fixture(scope="module")
def again(r12a: Path, root: Path) -> Comparison:
    """The second detection and calibration of the same pictures."""
    folder = r12a.parent / "r12_libpleno"
    if not folder.is_dir():
        pytest.skip("the second detection, r12_libpleno, is not beside the first")
    return run_comparison(folder, read_camera(root / "examples/cameras/r12a-libpleno.yaml"))


def test_the_camera_file_is_the_published_calibration(r12a: Path, camera: Camera) -> None:
    published = json.loads((r12a / "camera.json").read_text())
    array, sensor = published["microlens_array"], published["sensor"]
    pitch_x, pitch_y = array["pitch_mm"]
    # the data set's own letters; the published lattice counts against columns and rows, its even
    # rows stand half a pitch aside, and its matrices are stored column by column
    l, k = np.divmod(np.arange(array["rows"] * array["columns"]), array["columns"])  # noqa: E741
    column, row = array["columns"] - 1 - k, array["rows"] - 1 - l
    flat = np.stack(
        [pitch_x * (column + (row + 1) % 2 / 2), pitch_y * row * np.sqrt(3) / 2, 0 * k], axis=1
    )
    place = -(flat @ np.array(array["rotation"]) + np.array(array["translation_mm"]))
    centres = microlens_centres(camera.array)
    # the tilt foreshortens the array by a nanometre
    assert np.abs(centres - place[:, :2]).max() < 2e-6
    depth = camera.array.distance + centres @ np.array(camera.array.tilt)
    assert np.abs(depth - place[:, 2]).max() < 1e-8
    assert np.array_equal(microlens_types(camera.array), (k + l + l // 2) % 3)
    size = (np.array(camera.sensor.resolution) - 1) / 2 * camera.sensor.pixel
    last = np.array(camera.sensor.offset) + size
    assert -last == pytest.approx(sensor["translation_mm"][:2], abs=1e-9)
    assert camera.sensor.distance == -sensor["translation_mm"][2]
    assert camera.main_lens.focal_length == published["main_lens"]["focal_length_mm"]
    assert camera.main_lens.aperture == pytest.approx(
        published["main_lens"]["aperture_diameter_mm"]
    )


@pytest.mark.parametrize("name", ["r12a", "r12a-libpleno"])
def test_the_micro_images_of_all_pictures_lie_where_the_camera_file_says(
    r12a: Path, root: Path, name: str
) -> None:
    camera = read_camera(root / "examples" / "cameras" / f"{name}.yaml")
    table = np.loadtxt(r12a / "microimage_centres.csv", delimiter=",", skiprows=1)
    number = (table[:, 0] + table[:, 1] * camera.array.count[0]).astype(int)
    centre = microlens_centres(camera.array)[number]
    depth = camera.array.distance + centre @ np.array(camera.array.tilt)
    x, y = pixel_positions(camera.sensor)
    landing = centre * (camera.sensor.distance / depth)[:, None] - [x[0], y[0]]
    off = landing / camera.sensor.pixel - table[:, 2:]
    assert np.abs(off.mean(axis=0)).max() < 0.1
    assert np.sqrt(np.mean(off**2)) < 0.2


@pytest.mark.ci
def test_views_land_where_the_model_says_in_every_frame_after_one_rotation(
    compared: Comparison, frames: dict[int, FrameAgreement]
) -> None:
    assert max(frame.residual_px for frame in frames.values()) < 1.2
    rotation, uncertainty = compared.found.alignment.rotation, compared.found.alignment.uncertainty
    assert 1e3 * rotation == pytest.approx([9.4, -45.1, -0.5], abs=0.2)
    assert np.all(uncertainty < 3e-4)


@pytest.mark.ci
def test_the_second_detection_needs_no_rotation(again: Comparison) -> None:
    assert len(again.frames) == 8
    assert max(frame.residual_px for frame in again.frames) < 1.0
    assert np.abs(again.found.alignment.rotation).max() < 5e-5
    assert any("without the lens's distortion 0.86 px" in said for said in again.sentences)


@pytest.mark.ci
def test_view_counts_are_the_reach_of_a_detector_within_the_total_field(
    compared: Comparison, frames: dict[int, FrameAgreement]
) -> None:
    assert sum(frame.measured_total for frame in frames.values()) == 8660
    assert not compared.found.seen.beyond_field.any()
    detector = compared.found.detector
    assert detector.reach / compared.found.pixel == pytest.approx(6.6, abs=0.3)
    assert detector.scatter == pytest.approx(0.6, abs=0.1)
    # one curve for all frames finds too little where the blur is small, too much where it is large
    assert frames[0].z is not None
    assert frames[1].z is not None
    assert frames[0].z > 3
    assert frames[1].z < -3


def test_the_median_number_of_views_is_predicted_in_every_frame(
    frames: dict[int, FrameAgreement],
) -> None:
    measured = {number: frame.measured_median for number, frame in frames.items()}
    assert measured == {0: 4, 1: 59, 2: 27, 3: 10, 5: 42, 6: 19, 7: 26}
    assert [number for number, frame in frames.items() if not frame.views_agree] == []


@pytest.mark.ci
def test_another_detector_reaches_less_far_in_the_same_pictures(
    compared: Comparison, again: Comparison
) -> None:
    assert again.found.detector.reach < 0.92 * compared.found.detector.reach
    assert not again.found.seen.beyond_field.any()


def test_a_frame_without_observations_is_not_invented(
    compared: Comparison, frames: dict[int, FrameAgreement]
) -> None:
    assert compared.observations.empty_frames == (4,)
    assert 4 not in frames


def test_the_board_leans_the_way_the_parallax_says(compared: Comparison) -> None:
    found = compared.found
    for number in (1, 2, 3, 6):
        of = found.seen.frame == number
        depths = found.parallax.virtual_depth[of], found.predicted.virtual_depth[of]
        assert np.corrcoef(*depths)[0, 1] > 0.9
        assert np.corrcoef(found.seen.views[of], found.predicted.views[of])[0, 1] > 0.9


def test_the_refitted_gap_hangs_on_which_views_are_used_and_says_so(compared: Comparison) -> None:
    refit = compared.refit
    assert refit is not None
    assert refit.camera.gap == pytest.approx(0.386, abs=0.003)
    assert refit.correlation < -0.8
    assert refit.loosened["focal_length"][0] > 100 * refit.own[0]
    assert abs(refit.selection[1]) > 5 * refit.own[1]
    assert refit.uncertainty[1] > 4 * refit.own[1]
    assert any("Which views are used decides" in said for said in compared.sentences)
