"""Methods against the reference, the reference against rays: orders by slope, never seconds."""

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flflab.accuracy.chords import integrate_pixels
from flflab.accuracy.image import SEED, make_problem
from flflab.accuracy.ray_sums import grid_rays, random_rays
from flflab.accuracy.scenes import CHART, FOCUS, RESOLUTION, bench_scene, bench_scenes
from flflab.accuracy.table import write_table
from flflab.accuracy.work_precision import (
    Answer,
    Method,
    Problem,
    order,
    random_cost,
    work_precision,
)
from flflab.errors import InputError
from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.image.scene_file import read_scene
from flflab.targets import Bars

pytestmark = pytest.mark.ci

SCENES = bench_scenes(RESOLUTION)


@pytest.fixture(scope="module", params=SCENES, ids=str)
def problem(request: pytest.FixtureRequest) -> Problem:
    return make_problem(request.param, SCENES[request.param], np.random.default_rng(SEED))


def test_the_reference_is_the_mean_of_random_rays_and_their_error_falls_as_the_root_of_their_number(
    problem: Problem,
) -> None:
    rng, works = np.random.default_rng(1), [64, 512, 4096]
    errors = [
        random_rays(problem.scene, problem.pixels, rays, rng) - problem.values for rays in works
    ]
    assert order(works, [np.sqrt(np.mean(error**2)) for error in errors]) == pytest.approx(
        -0.5, abs=0.06
    )
    lit = problem.values > 0.01
    assert abs(errors[-1][lit].mean()) < 4 * errors[-1][lit].std() / np.sqrt(lit.sum())


def test_rays_on_a_grid_come_close_as_the_grid_grows_dense(problem: Problem) -> None:
    errors = [
        np.sqrt(np.mean((grid_rays(problem.scene, problem.pixels, across) - problem.values) ** 2))
        for across in (2, 4, 8)
    ]
    assert order([16, 256, 4096], errors) < -0.3


def test_the_reference_states_an_uncertainty_far_below_what_it_judges(problem: Problem) -> None:
    assert np.sqrt(np.mean(problem.uncertainty**2)) < 3e-5
    finer, _ = integrate_pixels(problem.scene, problem.pixels[:20])
    assert finer == pytest.approx(problem.values[:20], abs=0)


@pytest.mark.ci
@pytest.mark.parametrize("name", SCENES)
def test_the_reference_is_what_rays_traced_one_by_one_sum_up_to(
    trace_pixels: Callable[..., Any], name: str
) -> None:
    problem = make_problem(name, SCENES[name], np.random.default_rng(SEED))
    rim = np.argsort(np.abs(problem.values - 0.5))[:6]
    traced, uncertainty = trace_pixels(problem.scene, problem.pixels[rim], wanted=1e-4)
    assert np.all(np.abs(traced - problem.values[rim]) < 4 * uncertainty + 1e-5)


def test_render_keeps_what_is_asked_of_it_down_to_a_thousandth(problem: Problem) -> None:
    for tolerance in (1e-2, 3e-3, 1e-3):
        picture = render(problem.scene, tolerance=tolerance)
        apart = picture[problem.pixels[:, 1], problem.pixels[:, 0]] - problem.values
        assert np.sqrt(np.mean(apart**2)) <= tolerance


def test_a_table_holds_what_the_methods_answered(tmp_path: Path) -> None:
    """Methods whose errors are known beforehand."""
    scene = bench_scene(4.0, FOCUS, (8, 8))
    known = Problem(
        "flat", scene, np.zeros((4, 2), dtype=np.int64), np.full(4, 0.5), np.full(4, 1e-6)
    )
    methods = (
        Method(
            "half",
            "tolerance",
            (0.1, 0.01),
            lambda problem, asked: Answer(problem.values + asked / 2, 1000),
            lambda problem, asked: asked,
        ),
        Method(
            "root",
            "rays",
            (100.0, 10000.0),
            lambda problem, rays: Answer(problem.values + rays**-0.5 * np.eye(4)[0], 4),
        ),
    )
    told: list[str] = []
    rows = work_precision([known], methods, repeats=2, tell=told.append)
    assert told == ["flat: half", "flat: root"]
    assert [(row.requested, row.work) for row in rows] == [
        (0.1, None),
        (0.01, None),
        (None, 100.0),
        (None, 10000.0),
    ]
    assert [row.largest_error for row in rows] == pytest.approx([0.05, 0.005, 0.1, 0.01])
    assert [row.rms_error for row in rows] == pytest.approx([0.05, 0.005, 0.05, 0.005])
    assert [row.estimate for row in rows] == [0.1, 0.01, None, None]
    assert all(
        row.reference_uncertainty == pytest.approx(1e-6) and row.repeats == 2 and row.wall_s > 0
        for row in rows
    )
    assert order(
        [row.work or 1 for row in rows[2:]], [row.rms_error for row in rows[2:]]
    ) == pytest.approx(-0.5)
    cost = rows[2].processor_s_per_megapixel, rows[3].processor_s_per_megapixel
    assert random_cost(rows[2:3], 0.05 / 10) == pytest.approx(100 * cost[0])
    write_table(rows, tmp_path / "table.csv", also=("processor_s_per_megapixel",))
    with (tmp_path / "table.csv").open(encoding="utf-8") as stream:
        read = list(csv.DictReader(stream))
    assert [float(row["largest_error"]) for row in read] == pytest.approx([0.05, 0.005, 0.1, 0.01])
    assert float(read[3]["processor_s_per_megapixel"]) == pytest.approx(cost[1])
    assert [row["requested"] for row in read] == ["0.1", "0.01", "", ""]


@pytest.mark.parametrize(
    "scene",
    [
        replace(bench_scene(4.0, FOCUS, (8, 8)), falloff=Falloff()),
        one_plane(bench_scene(4.0, FOCUS, (8, 8)).camera, Bars(), FOCUS),
        one_plane(bench_scene(4.0, FOCUS, (8, 8)).camera, CHART, FOCUS, offset=(1.0, 0.0)),
    ],
    ids=["fall-off", "bars", "off the axis"],
)
def test_ray_sums_refuse_what_they_do_not_know(scene: object) -> None:
    with pytest.raises(InputError, match="leave the rest out"):
        random_rays(scene, np.zeros((1, 2), dtype=np.int64), 4, np.random.default_rng(0))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("name", "file"), [("F/4, in focus", "in-focus-f4"), ("F/4, defocused", "defocused-f4")]
)
def test_the_scenes_are_the_named_ones_of_the_speed_trials(
    name: str, file: str, root: Path
) -> None:
    named, scene = read_scene(root / "examples" / "scenes" / f"{file}.yaml").scene, SCENES[name]
    assert named.planes == scene.planes
    assert named.camera.main_lens == scene.camera.main_lens
    for one, other in (
        (named.camera.array, scene.camera.array),
        (named.camera.sensor, scene.camera.sensor),
    ):
        assert one.distance == pytest.approx(other.distance, abs=1e-6)
    array = scene.camera.array
    assert replace(named.camera.array, count=array.count, distance=array.distance) == array
