"""The floor of a measurement widens what a frame's numbers share, and nothing else."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flflab.alignment import Attitude
from flflab.bench import Element, read_bench
from flflab.bench_uncertainty import MeasurementFloorDescription
from flflab.measurement.contrast.curve import ContrastCurve
from flflab.measurement.dots.views import DotViews
from flflab.measurement.lattice.lattice import Lattice
from flflab.study import Configuration, read_study
from flflab.verdict.properties.floor import with_floor
from flflab.verdict.properties.measured import Measured

ROOT = Path(__file__).parents[2]
BENCH = ROOT / "examples" / "benches" / "simulated.yaml"


def flat(kind: type, **given: Any) -> Any:
    """A record of which only some fields are read."""
    return kind(**{name: given.get(name, np.zeros(1)) for name in kind.__dataclass_fields__})


@pytest.fixture(scope="module")
def one() -> Measured:
    bench = read_bench(BENCH)
    study = read_study(ROOT / "examples" / "studies" / "first.yaml", bench.optics)
    configuration: Configuration = study.configurations[0]
    grid = np.stack(np.meshgrid(np.arange(-12, 13), np.arange(-9, 10)), axis=-1).reshape(-1, 2)
    curve = flat(
        ContrastCurve, covariance=np.diag([1e-8, 4e-8]), extremes_uncertainty=np.full(2, 1e-4)
    )
    lattice = flat(
        Lattice,
        centres_px=245.0 * grid,
        pitch_px=245.0,
        pitch_uncertainty_px=1e-5,
        angle_uncertainty=1e-7,
        origin_uncertainty_px=np.full(2, 1e-3),
        inside_uncertainty_px=2e-3,
        outside_uncertainty_px=1e-3,
        sizes_covariance_px=np.diag([4e-6, 1e-6, 1e-10]),
    )
    views = 245.0 * np.array([[-1.0, -1], [0, -1], [1, -1], [-1, 0], [0, 0], [1, 0.0]])
    dot = flat(
        DotViews,
        dot=0,
        centres_px=views,
        position_mm=np.array([4.0, -4.0, -507.0]),
        uncertainty_mm=np.full(3, 1e-3),
        common_mm=np.full((3, 1), 1e-3),
    )
    attitude = flat(Attitude, covariance=np.diag([1e-14, 1e-10, 1e-10]))
    worlds: dict[Element, float] = {
        "main_lens.z": 0.0,
        "array.z": configuration.array,
        "sensor.z": configuration.sensor,
        "target.z": -configuration.distance,
    }
    return Measured(configuration, worlds, lattice, attitude, (dot,), curve, 1.0, 0)


def floored(one: Measured, **given: str | float) -> Measured:
    return with_floor(
        one, MeasurementFloorDescription.model_validate(given), read_bench(BENCH).optics
    )


def test_without_a_floor_nothing_changes(one: Measured) -> None:
    same = floored(one)
    assert same.curve is not None
    assert one.curve is not None
    assert np.array_equal(same.curve.covariance, one.curve.covariance)
    assert np.array_equal(same.lattice.sizes_covariance_px, one.lattice.sizes_covariance_px)
    assert same.dots == one.dots


def test_all_contrasts_of_a_frame_are_off_together_and_a_fifth_of_it_each_by_itself(
    one: Measured,
) -> None:
    curve = floored(one, contrast=0.002).curve
    assert curve is not None
    apart = (0.002 / 5) ** 2 * np.eye(2)
    assert curve.covariance - np.diag([1e-8, 4e-8]) == pytest.approx(np.full((2, 2), 4e-6) + apart)
    # the difference of two contrasts of one frame knows of that alone
    difference = np.array([1.0, -1.0])
    assert difference @ curve.covariance @ difference == pytest.approx(5e-8 + 2 * apart[0, 0])
    assert curve.extremes_uncertainty == pytest.approx(np.hypot(1e-4, 0.002))


def test_all_radii_of_a_frame_are_off_together(one: Measured) -> None:
    found = floored(one, radius="0.05 px").lattice
    added = found.sizes_covariance_px - one.lattice.sizes_covariance_px
    assert added[:2, :2] == pytest.approx(np.full((2, 2), 0.0025))
    assert not added[2].any()
    assert found.inside_uncertainty_px == pytest.approx(np.hypot(2e-3, 0.05))


def test_positions_that_are_off_in_proportion_move_pitch_roll_and_depth(one: Measured) -> None:
    found = floored(one, position="0.02 px")
    places = one.lattice.centres_px
    # the same by a fit to places that are off so
    off = places * (1 + 0.02 / np.sqrt(np.mean(places**2)))
    assert np.sqrt(np.mean((off - places) ** 2)) == pytest.approx(0.02)
    pitch = 245.0 * (off[0, 0] / places[0, 0] - 1)
    assert found.lattice.pitch_uncertainty_px == pytest.approx(np.hypot(1e-5, pitch))
    assert found.attitude is not None
    assert found.attitude.covariance[0, 0] == pytest.approx(1e-14 + (pitch / 245) ** 2)


def test_depth_moves_as_similar_triangles_say(one: Measured) -> None:
    found = floored(one, position="0.02 px").dots[0]
    camera = one.configuration.camera(read_bench(BENCH).optics)
    length, gap, focal = camera.array.distance, camera.gap, camera.main_lens.focal_length
    distance = one.configuration.distance

    def parallax(away: float) -> float:
        """Of views against micro-images: how far a view is aside of its centre, a unit of it."""
        behind = 1 / (1 / focal - 1 / away)
        landing = 1 + gap / (length - behind)  # of a ray through a lens at 1
        return landing / (1 + gap / length) - 1

    views = one.dots[0].centres_px
    spread = np.sqrt(np.mean((views - views.mean(axis=0)) ** 2))
    step = 1e-3
    slope = (parallax(distance + step) - parallax(distance - step)) / (2 * step)
    expected = 0.02 / spread / abs(slope)
    alone = expected / 5  # by which one dot may be off otherwise than the others
    assert found.uncertainty_mm[2] == pytest.approx(
        np.sqrt(1e-6 + expected**2 + alone**2), rel=1e-6
    )
    assert found.common_mm.shape == (3, 2)
    assert found.common_mm[2, 1] == pytest.approx(expected, rel=1e-6)


def test_a_dot_of_one_view_is_as_unsure_as_if_its_neighbour_counted_too(one: Measured) -> None:
    (whole,) = one.dots
    alone, two = (replace(whole, centres_px=whole.centres_px[4 : 4 + n]) for n in (1, 2))
    found = [floored(replace(one, dots=(dot,)), position="0.02 px").dots[0] for dot in (alone, two)]
    assert found[0].common_mm.shape == found[1].common_mm.shape
    assert found[0].common_mm[2, 1] == pytest.approx(found[1].common_mm[2, 1], rel=0.01)


def test_a_frame_without_dots_and_bars_keeps_its_lattice(one: Measured) -> None:
    bare = replace(one, dots=(), curve=None, attitude=None)
    found = floored(bare, contrast=0.002, position="0.02 px", radius="0.05 px")
    assert (found.dots, found.curve, found.attitude) == ((), None, None)
