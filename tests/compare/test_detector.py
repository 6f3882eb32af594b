from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flflab.files.camera import read_camera
from flflab.observations.detector import Detector, PossibleViews, fit_detector, possible_views
from flflab.observations.points import SeenPoints, measure_points
from flflab.observations.prediction import align
from flflab.observations.reading import read_observations

PIXEL = 0.0055


@pytest.fixture(scope="module")
def traced_views(traced: Path) -> tuple[SeenPoints, PossibleViews]:
    camera = read_camera(traced / "camera.yaml")
    seen = measure_points(read_observations(traced), camera)
    return seen, possible_views(camera, seen, align(camera, seen).position)


def detect(
    seen: SeenPoints, possible: PossibleViews, rng: np.random.Generator, blind: int | None = None
) -> Detector:
    """A detector of reach 9 px and softness 0.7 px finds what it finds; in one frame it finds a
    third less.
    """
    share = 1 / (1 + np.exp((possible.from_centre / PIXEL - 9) / 0.7))
    if blind is not None:
        share[seen.frame[possible.owner] == blind] *= 2 / 3
    found = rng.random(len(share)) < share
    views = np.bincount(possible.owner[found], minlength=len(seen.frame))
    return fit_detector(replace(possible, found=found), replace(seen, views=views), PIXEL)


def test_all_views_that_rays_reach_are_possible_and_those_beyond_the_stop_are_not_found(
    traced_views: tuple[SeenPoints, PossibleViews],
) -> None:
    seen, possible = traced_views
    assert possible.found.sum() == len(seen.owner)
    assert np.array_equal(np.bincount(possible.owner[possible.found]), seen.views)
    # chief rays reach as far as the main lens's shadow: A b / (2 L), 8.6 px
    edge = 50 / 5.6 * 0.6 / 56.5 / 2 / PIXEL
    assert possible.from_centre[possible.found].max() / PIXEL == pytest.approx(edge, rel=0.01)
    assert possible.from_centre[~possible.found].min() / PIXEL == pytest.approx(edge, rel=0.01)
    found = fit_detector(possible, seen, PIXEL)
    assert found.reach / PIXEL == pytest.approx(edge, abs=0.1)
    assert found.expected == pytest.approx(seen.views, abs=1.5)


def test_a_planted_reach_and_softness_are_found_and_z_is_normal(
    traced_views: tuple[SeenPoints, PossibleViews],
) -> None:
    seen, possible = traced_views
    rng = np.random.default_rng(3)
    runs = [detect(seen, possible, rng) for _ in range(40)]
    assert np.mean([run.reach for run in runs]) / PIXEL == pytest.approx(9.0, abs=0.05)
    assert np.mean([run.softness for run in runs]) / PIXEL == pytest.approx(0.7, abs=0.05)


def test_a_frame_in_which_the_detector_finds_less_stands_out(
    traced_views: tuple[SeenPoints, PossibleViews],
) -> None:
    seen, possible = traced_views
    rng = np.random.default_rng(5)
    share = 1 / (1 + np.exp((possible.from_centre / PIXEL - 9) / 0.7))
    of = seen.frame[possible.owner] == 1
    found = rng.random(len(share)) < share * np.where(of, 2 / 3, 1)
    views = np.bincount(possible.owner[found], minlength=len(seen.frame))
    detector = fit_detector(replace(possible, found=found), replace(seen, views=views), PIXEL)
    z = {
        int(frame): detector.z(
            int(views[seen.frame == frame].sum()),
            float(detector.expected[seen.frame == frame].sum()),
        )
        for frame in np.unique(seen.frame)
    }
    assert z[1] < -5
    assert min(z, key=lambda frame: z[frame]) == 1
