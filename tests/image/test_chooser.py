"""The choice of effects, and what is promised of it, over random scenes."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import InputError
from flflab.image.budget import expected_seconds, finest_within, tiles_tried
from flflab.image.chooser import LIGHT, NOISE, choose
from flflab.image.effects.dead_pixels import DeadPixels
from flflab.image.effects.saturation import Saturation
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.stray_light import StrayLight
from flflab.image.picture import Report, take_picture
from flflab.image.promise import try_scene
from flflab.image.random_scene import RESOLUTION
from flflab.image.render import LEAST_TOLERANCE, render
from flflab.image.scene import Plane, Scene, one_plane
from flflab.image.scene_file import short_scene
from flflab.image.sensor.response import SensorResponse
from flflab.optics.camera import Camera
from flflab.targets import Bars, Black, Edge, FourDot


@pytest.fixture(scope="module")
def scene(camera: Camera) -> Scene:
    small = replace(camera, sensor=replace(camera.sensor, resolution=(96, 64)))
    return short_scene(small, Plane(Edge(), 500.0), 550e-6)


def on(report: Report) -> set[str]:
    return {effect.name for effect in report.effects if effect.on}


def test_every_effect_of_the_contract_is_told_with_a_reason(scene: Scene) -> None:
    report = take_picture(scene)
    assert [effect.name for effect in report.effects] == [*LIGHT, *NOISE]
    assert len(set(LIGHT + NOISE)) == 20
    assert all(effect.why for effect in report.effects)
    assert on(report) == {"defocus", "vignetting", "pixel", "diffraction", "falloff"}
    assert report.error_estimate < report.tolerance == 0.002


def test_what_is_left_out_and_the_quadrature_share_the_tolerance(scene: Scene) -> None:
    for tolerance in (0.5, 0.2, 0.01, 0.0005):
        choice = choose(scene, tolerance)
        left_out = sum(one.bound for one in choice.decisions if not one.on and one.size is not None)
        assert left_out <= tolerance / 2
        assert 0.7 * tolerance - 1e-12 <= left_out + choice.tolerance <= tolerance


def test_what_saves_next_to_no_time_is_left_out_only_where_it_changes_next_to_nothing(
    scene: Scene,
) -> None:
    for share, on in ((0.003, True), (1e-6, False)):
        choice = choose(replace(scene, stray_light=StrayLight(share)), 0.01)
        (stray,) = (one for one in choice.decisions if one.name == "stray-light")
        assert (stray.bound < 0.005, stray.on) == (True, on)
        assert choice.tolerance == pytest.approx(0.7 * 0.01, rel=1e-3)


def test_levels_keep_less_or_more(scene: Scene) -> None:
    fast, auto, reference = (choose(scene, 0.05, level) for level in ("fast", "auto", "reference"))
    assert fast.effects <= auto.effects <= reference.effects
    assert fast.tolerance > auto.tolerance > reference.tolerance == LEAST_TOLERANCE
    assert reference.effects == {
        "defocus",
        "vignetting",
        "pixel",
        "diffraction",
        "falloff",
    }  # nothing overlaps


def test_a_list_is_taken_as_it_is(scene: Scene) -> None:
    report = take_picture(scene, effects="pixel, falloff")
    assert on(report) == {"pixel", "falloff"}
    assert {effect.why for effect in report.effects if effect.name == "scatter"} == {
        "the scene has none"
    }


def test_what_is_too_little_to_matter_and_on_says_that_it_was_asked_for(scene: Scene) -> None:
    image = 60 - 1 / (1 / 0.917 - 1 / 1.15)
    sharp = replace(scene, planes=(replace(scene.planes[0], distance=1 / (1 / 50 - 1 / image)),))
    (defocus,) = (
        one for one in choose(sharp, 0.002, "reference").decisions if one.name == "defocus"
    )
    assert defocus.on
    assert defocus.why.endswith("softens edges: too little to matter, but asked for")


def test_scattered_microlenses_cost_time_and_next_to_no_scatter_is_left_out(scene: Scene) -> None:
    costs = {}
    for scattered in (0.003, 1e-9):
        (scatter,) = (
            one
            for one in choose(replace(scene, scatter=Scatter(scattered)), 0.002).decisions
            if one.name == "scatter"
        )
        costs[scatter.on] = scatter.cost
    assert set(costs) == {True, False}
    assert costs[True] > 0


def test_electrons_are_told_in_whole_numbers(scene: Scene) -> None:
    regime = replace(choose(scene, 0.002).regime, electrons=30000.0, brightest=1.0)
    assert Saturation(10000.0).why(regime) == "the brightest light makes 30000 electrons of 10000"


def test_noise_comes_with_a_seed_and_repeats_with_it(camera: Camera) -> None:
    scene = one_plane(
        replace(camera, sensor=replace(camera.sensor, resolution=(96, 64))), Bars(), 506.7
    )
    one, again, other = (take_picture(scene, seed=seed).image for seed in (1, 1, 2))
    quiet = take_picture(scene).image
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    assert abs((one - quiet).mean()) < 2e-3
    assert 0.001 < (one - quiet).std() < 0.05


def test_any_subset_of_the_noise_can_be_asked_for(camera: Camera) -> None:
    scene = one_plane(
        replace(camera, sensor=replace(camera.sensor, resolution=(96, 64))), Black(), 506.7
    )
    response = SensorResponse(dead_pixels=DeadPixels(0.1))
    read = take_picture(
        scene, effects="pixel,read-noise", seed=1, response=response, electrons_at_white=1000.0
    ).image
    assert read.std() == pytest.approx(3 / 1000, rel=0.05)
    stuck = take_picture(
        scene, effects="pixel,dead-pixels", seed=1, response=response, electrons_at_white=1000.0
    )
    assert 0.05 < float((stuck.image != 0).mean()) < 0.15
    assert on(stuck) == {"pixel", "dead-pixels"}


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            "sparkle",
            (
                "there is no 'sparkle'; allowed: one of auto, fast, reference, or a list of"
                " defocus, vignetting"
            ),
        ),
        ("auto,fast", "'auto,fast' is a list; auto, fast, reference stand alone; give one of"),
        (
            "pixel, reference",
            "'pixel, reference' is a list; auto, fast, reference stand alone; give one of",
        ),
        ("pixel,shot-noise", "shot-noise need a seed"),
        ("", "the list is empty"),
    ],
)
def test_effects_that_cannot_be_chosen_are_refused(scene: Scene, asked: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        take_picture(scene, effects=asked)


@pytest.mark.parametrize("tolerance", [0.0, -0.1, math.nan, math.inf, 1.0, 1e-12])
def test_tolerances_that_cannot_be_kept_are_refused(scene: Scene, tolerance: float) -> None:
    with pytest.raises(InputError, match=r"^tolerance: .* is allowed; give 0\.002, for instance$"):
        take_picture(scene, tolerance=tolerance)


@pytest.mark.ci
def test_a_time_budget_gives_the_best_that_fits_or_says_what_would(scene: Scene) -> None:
    assert take_picture(scene, budget=60.0).tolerance < take_picture(scene).tolerance
    with pytest.raises(InputError, match="cannot be kept; the least that can is about"):
        take_picture(scene, budget=1e-6)
    with pytest.raises(InputError, match="above 0 s"):
        take_picture(scene, budget=0.0)


@pytest.mark.parametrize("seconds", [0.5, 3.0, 20.0])
@pytest.mark.parametrize("power", [0.5, 1.0])
def test_choosing_and_the_picture_chosen_together_take_no_longer_than_the_budget(
    seconds: float, power: float
) -> None:
    """By a clock of their own: a picture takes longer the finer it is, and so does every try; they
    had taken 2.3 s of 1 s.
    """
    now, tiles = [0.0], np.arange(10000).reshape(100, 100) % 7 == 0

    def spend(time: float, tolerance: float) -> None:
        now[0] += time * tolerance**-power

    def form(tolerance: float, wanted: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
        spend(0.01 * wanted.mean(), tolerance)
        return np.zeros(wanted.shape)

    def tried(tolerance: float) -> float:
        return expected_seconds(
            lambda wanted: form(tolerance, wanted),
            lambda _: spend(0.005, tolerance),
            tiles,
            lambda: now[0],
        )

    chosen = finest_within(seconds, tried, lambda: now[0])
    picture = 0.015 * chosen**-power
    assert now[0] + picture < seconds
    assert picture > 0.1 * seconds


@pytest.mark.parametrize(
    ("seconds", "counts"), [(0.01, (4, 3)), (0.2, (1, 1))], ids=["brief", "long"]
)
def test_only_what_is_brief_is_tried_again_so_that_a_budget_is_not_spent_on_trying(
    seconds: float, counts: tuple[int, int]
) -> None:
    now, formed = [0.0], list[int]()
    tiles = np.arange(100).reshape(10, 10) % 7 == 0

    def form(wanted: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
        now[0] += seconds
        formed.append(int(wanted.sum()))
        return np.zeros(wanted.shape)

    assert expected_seconds(form, lambda _: None, tiles, lambda: now[0]) == pytest.approx(seconds)
    assert (formed.count(int(tiles.sum())), formed.count(0)) == counts


def test_the_tiles_that_a_budget_is_judged_by_hold_their_share_of_light_though_dots_lie_far_between(
    camera: Camera,
) -> None:
    whole_sensor = replace(camera, sensor=replace(camera.sensor, resolution=(3664, 2748)))
    scene = short_scene(whole_sensor, Plane(FourDot(), 507.0))
    lit, tried = render(scene, tolerance=0.01) > 1e-3, tiles_tried(scene)
    assert lit.mean() < 0.002
    assert np.mean(lit[tried]) == pytest.approx(lit.mean(), rel=0.3)
    assert np.count_nonzero(lit[tried]) > 50  # of fewer it would be by chance


@pytest.mark.parametrize(
    ("seeds", "resolution", "finest", "waves"),
    [
        (range(4), (32, 24), 0.02, False),
        (range(134, 135), RESOLUTION, 0.001, True),
        pytest.param(range(920, 921), RESOLUTION, 0.001, True, marks=pytest.mark.ci),
        (range(143, 144), RESOLUTION, 0.001, True),
        pytest.param(range(801, 802), RESOLUTION, 0.001, True, marks=pytest.mark.ci),
        pytest.param(
            range(4, 10), (32, 24), 0.02, False, marks=[pytest.mark.ci, pytest.mark.timeout(400)]
        ),
        pytest.param(range(40, 41), RESOLUTION, 0.001, True, marks=pytest.mark.ci),
        pytest.param(range(10004, 10005), RESOLUTION, 0.001, True, marks=pytest.mark.ci),
        pytest.param(
            range(719, 720),
            RESOLUTION,
            0.001,
            True,
            marks=[pytest.mark.full, pytest.mark.timeout(0)],
        ),
        pytest.param(
            range(10, 50), (32, 24), 0.02, False, marks=[pytest.mark.full, pytest.mark.timeout(0)]
        ),
        pytest.param(
            range(1000), RESOLUTION, 0.001, True, marks=[pytest.mark.full, pytest.mark.timeout(0)]
        ),
    ],
    ids=[
        "few scenes of rays",
        "one wrong in few pixels along a border",
        "one that is as wrong at a third of the tolerance",
        "one whose rims are unlike",
        "one whose outer microlenses share tables with the others",
        "some scenes of rays",
        "a white one whose waves are left out",
        "a card before many micro-images",
        "a card that moves by more than its blur",
        "more scenes of rays",
        "all",
    ],
)
def test_auto_differs_from_the_reference_by_less_than_asked_for_and_knows_by_how_much(
    seeds: range, resolution: tuple[int, int], finest: float, waves: bool
) -> None:
    trials = [try_scene(seed, resolution, finest, waves) for seed in seeds]
    assert [trial for trial in trials if not trial.kept] == []
    assert (
        np.mean([trial.estimated <= 5 * trial.achieved for trial in trials if trial.telling])
        >= 0.95
    )


@pytest.mark.ci
def test_narrow_rims_that_are_unlike_keep_the_promise() -> None:
    """Divided as wider ones need, they were 2.8 tolerances off in this scene."""
    assert try_scene(5).kept
