import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flflab.camera_file import read_camera
from flflab.observations.points import PredictedPoints, SeenPoints, measure_points, predict_points
from flflab.observations.reading import read_observations


@pytest.fixture(scope="module")
def truth(traced: Path) -> dict[str, Any]:
    return json.loads((traced / "truth.json").read_text())


@pytest.fixture(scope="module")
def seen(traced: Path) -> SeenPoints:
    return measure_points(read_observations(traced), read_camera(traced / "camera.yaml"))


@pytest.fixture(scope="module")
def predicted(traced: Path, seen: SeenPoints) -> PredictedPoints:
    return predict_points(read_camera(traced / "camera.yaml"), seen)


def test_every_point_is_predicted_in_as_many_micro_images_as_rays_reach(
    seen: SeenPoints, predicted: PredictedPoints
) -> None:
    assert seen.views.min() >= 2
    assert seen.views.max() >= 3 * seen.views.min()
    assert np.array_equal(predicted.views, seen.views)


def test_the_lateral_origin_of_each_frame_is_found_and_nothing_is_left_over(
    truth: dict[str, Any], seen: SeenPoints, predicted: PredictedPoints
) -> None:
    # the pose says R (X - t) = true place + origin with both lateral axes reversed, so the offset
    # found is + origin
    planted = np.array([truth["origin"][str(frame)] for frame in seen.frame])
    assert predicted.offset == pytest.approx(planted, abs=1e-6)
    assert np.abs(predicted.residual).max() < 1e-8


def test_virtual_depth_from_parallax_is_that_of_the_image_behind_the_array(
    truth: dict[str, Any], seen: SeenPoints, predicted: PredictedPoints
) -> None:
    true = np.array(
        [
            truth["virtual_depth"][f"{frame} {point}"]
            for frame, point in zip(seen.frame, seen.point, strict=True)
        ]
    )
    assert predicted.virtual_depth == pytest.approx(true, rel=1e-12)
    assert seen.virtual_depth == pytest.approx(
        true, rel=2e-3
    )  # the array's tilt bends the line by so much


def test_a_keplerian_slope_above_one_gives_a_positive_virtual_depth(seen: SeenPoints) -> None:
    one = SeenPoints(**{**vars(seen), "slope": np.array([1.25, 0.75])})
    assert one.virtual_depth == pytest.approx([4.0, 4.0])


def test_the_uncertainty_of_a_slope_covers_its_error(noisy: Path, seen: SeenPoints) -> None:
    measured = measure_points(read_observations(noisy), read_camera(noisy / "camera.yaml"))
    pull = (measured.slope - seen.slope) / measured.slope_uncertainty
    assert np.std(pull) == pytest.approx(
        1.0, abs=0.25
    )  # 80 points: the standard deviation is known to 8 %


def test_a_point_with_one_view_has_no_parallax_and_still_counts(
    noisy: Path, tmp_path: Path
) -> None:
    lines = (noisy / "observations.csv").read_text().splitlines()
    first = next(line for line in lines if line.endswith(",0,0"))
    kept = [lines[0], first, *(line for line in lines[1:] if not line.endswith(",0,0"))]
    for name in ("poses.json", "camera.json"):
        (tmp_path / name).write_text((noisy / name).read_text())
    (tmp_path / "observations.csv").write_text("\n".join(kept) + "\n")
    measured = measure_points(read_observations(tmp_path), read_camera(noisy / "camera.yaml"))
    alone = (measured.frame == 0) & (measured.point == 0)
    assert measured.views[alone] == [1]
    assert list(measured.with_parallax[alone]) == [False]
    assert measured.with_parallax.sum() == len(measured.frame) - 1
