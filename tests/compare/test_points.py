import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flflab.errors import InputError
from flflab.files.camera import read_camera
from flflab.observations.points import (
    Parallax,
    SeenPoints,
    measure_parallax,
    measure_points,
)
from flflab.observations.prediction import (
    Alignment,
    PredictedPoints,
    align,
    landing_points,
    predict_points,
)
from flflab.observations.reading import read_observations
from flflab.optics.camera import Camera
from flflab.optics.distortion import BrownDistortion
from flflab.optics.smms import camera_smms
from flflab.optics.useful import select

TURN = (0.011, -0.024, 0.006)


@pytest.fixture(scope="module")
def truth(traced: Path) -> dict[str, Any]:
    return json.loads((traced / "truth.json").read_text())


@pytest.fixture(scope="module")
def camera(traced: Path) -> Camera:
    return read_camera(traced / "camera.yaml")


@pytest.fixture(scope="module")
def seen(traced: Path, camera: Camera) -> SeenPoints:
    return measure_points(read_observations(traced), camera)


@pytest.fixture(scope="module")
def alignment(camera: Camera, seen: SeenPoints) -> Alignment:
    return align(camera, seen)


@pytest.fixture(scope="module")
def predicted(camera: Camera, seen: SeenPoints, alignment: Alignment) -> PredictedPoints:
    return predict_points(camera, seen, alignment.position)


@pytest.fixture(scope="module")
def parallax(camera: Camera, seen: SeenPoints) -> Parallax:
    return measure_parallax(seen, camera)


def test_every_point_is_predicted_in_as_many_micro_images_as_rays_reach(
    seen: SeenPoints, predicted: PredictedPoints
) -> None:
    assert seen.views.min() >= 2
    assert seen.views.max() >= 3 * seen.views.min()
    assert np.array_equal(predicted.views, seen.views)
    assert not seen.beyond_field.any()


def test_the_one_rotation_of_all_poses_is_found_and_nothing_is_left_over(
    alignment: Alignment,
) -> None:
    assert alignment.rotation == pytest.approx(TURN, abs=1e-8)
    assert np.abs(alignment.residual).max() < 1e-7


def test_the_uncertainty_of_the_rotation_covers_its_error(noisy: Path, camera: Camera) -> None:
    found = align(camera, measure_points(read_observations(noisy), camera))
    assert np.all(np.abs(found.rotation - TURN) < 4 * found.uncertainty)
    assert np.all(found.uncertainty < 2e-3)


def test_a_distorted_point_lands_where_similar_triangles_say(
    camera: Camera, seen: SeenPoints, alignment: Alignment
) -> None:
    bent = BrownDistortion((-1e-2, 1e-3, 1e-4), (5e-3, -2e-3))  # moves views by pixels
    distorted = replace(camera, main_lens=replace(camera.main_lens, distortion=bent))
    smms = select(camera_smms(camera), seen.microlens)
    position = alignment.position[seen.owner]
    behind = 1 / (1 / 50 - 1 / position[:, 2])
    image = bent.displace(-position[:, :2] * (behind / position[:, 2])[:, None])
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)
    share = (57.1 - smms.distance) / (behind - smms.distance)
    expected = centre + (image - centre) * share[:, None]
    found = landing_points(distorted, smms, position)
    assert found == pytest.approx(expected, abs=1e-9)
    assert np.abs(found - landing_points(camera, smms, position)).max() > 0.0055


def test_a_distorted_point_within_the_focal_length_is_refused(
    camera: Camera, seen: SeenPoints
) -> None:
    bent = replace(camera.main_lens, distortion=BrownDistortion((1e-4, 0.0, 0.0)))
    near = replace(seen, position=seen.position * [1, 1, 0.1])
    with pytest.raises(InputError, match="more than the focal length, 50 mm, is due"):
        align(replace(camera, main_lens=bent), near)


def test_virtual_depth_from_parallax_is_that_of_the_image_behind_the_array(
    truth: dict[str, Any], seen: SeenPoints, predicted: PredictedPoints, parallax: Parallax
) -> None:
    true = np.array(
        [
            truth["virtual_depth"][f"{frame} {point}"]
            for frame, point in zip(seen.frame, seen.point, strict=True)
        ]
    )
    assert predicted.virtual_depth == pytest.approx(true, rel=1e-6)
    # the array's tilt bends the line by so much
    assert parallax.virtual_depth == pytest.approx(true, rel=2e-3)


def test_a_keplerian_slope_above_one_gives_a_positive_virtual_depth() -> None:
    none = np.zeros(2)
    one = Parallax(np.array([1.25, 0.75]), none, np.zeros((2, 2)))
    assert one.virtual_depth == pytest.approx([4.0, 4.0])


def test_the_uncertainty_of_a_slope_covers_its_error(
    noisy: Path, camera: Camera, parallax: Parallax
) -> None:
    measured = measure_parallax(measure_points(read_observations(noisy), camera), camera)
    pull = (measured.slope - parallax.slope) / measured.uncertainty
    # 80 points: the standard deviation is known to 8 %
    assert np.std(pull) == pytest.approx(1.0, abs=0.25)


def test_views_far_from_the_centres_can_be_left_out_of_the_parallax(
    camera: Camera, seen: SeenPoints, parallax: Parallax
) -> None:
    within = float(np.median(seen.from_centre))
    inner = measure_parallax(seen, camera, within)
    assert inner.known.any()
    assert np.all(parallax.known[inner.known])
    assert inner.slope[inner.known] == pytest.approx(parallax.slope[inner.known], abs=2e-3)
    assert not measure_parallax(seen, camera, 0.0).known.any()


def test_a_point_with_one_view_has_no_parallax_and_still_counts(
    noisy: Path, tmp_path: Path
) -> None:
    lines = (noisy / "observations.csv").read_text().splitlines()
    first = next(line for line in lines if line.endswith(",0,0"))
    kept = [lines[0], first, *(line for line in lines[1:] if not line.endswith(",0,0"))]
    for name in ("poses.json", "camera.json"):
        (tmp_path / name).write_text((noisy / name).read_text())
    (tmp_path / "observations.csv").write_text("\n".join(kept) + "\n")
    camera = read_camera(noisy / "camera.yaml")
    measured = measure_points(read_observations(tmp_path), camera)
    known = measure_parallax(measured, camera).known
    alone = (measured.frame == 0) & (measured.point == 0)
    assert measured.views[alone] == [1]
    assert list(known[alone]) == [False]
    assert known.sum() == len(measured.frame) - 1
