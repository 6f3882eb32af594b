"""The choice of effects and of the path, and what a picture says of itself."""

import math
from dataclasses import replace

import numpy as np
import pytest

from flflab.errors import InputError
from flflab.image.accuracy import LEAST_TOLERANCE
from flflab.image.budget import finest_within, middle_of
from flflab.image.choose import LIGHT, NOISE, choose
from flflab.image.effects.dead_pixels import DeadPixels
from flflab.image.effects.saturation import Saturation
from flflab.image.effects.stray_light import StrayLight
from flflab.image.picture import Report, take_picture
from flflab.image.scene import Plane, Scene, one_plane
from flflab.image.scene_file import short_scene
from flflab.image.sensor.response import SensorResponse
from flflab.optics.camera import Camera
from flflab.targets import Bars, Black, Edge


@pytest.fixture(scope="module")
def scene(camera: Camera) -> Scene:
    small = replace(camera, sensor=replace(camera.sensor, resolution=(96, 64)))
    return short_scene(small, Plane(Edge(), 500.0), 550e-6)


def on(report: Report) -> set[str]:
    return {effect.name for effect in report.effects if effect.on}


def test_every_effect_of_the_contract_is_told_with_a_reason(scene: Scene) -> None:
    report = take_picture(scene)
    assert [effect.name for effect in report.effects] == [*LIGHT, *NOISE]
    assert len(set(LIGHT + NOISE)) == 28
    assert all(effect.why for effect in report.effects)
    assert on(report) == {"defocus", "vignetting", "overlap", "pixel", "diffraction", "falloff"}
    assert report.error_estimate < report.tolerance == 0.002


def test_what_is_left_out_and_the_quadrature_share_the_tolerance(scene: Scene) -> None:
    for tolerance in (0.5, 0.2, 0.01, 0.0005):
        choice = choose(scene, tolerance)
        left_out = sum(one.bound for one in choice.decisions if not one.on and one.size is not None)
        assert left_out <= tolerance / 2
        assert 0.7 * tolerance - 1e-12 <= left_out + choice.tolerance <= tolerance


def test_what_saves_no_time_is_kept_however_little_it_changes(scene: Scene) -> None:
    choice = choose(replace(scene, stray_light=StrayLight(1e-6)), 0.01)
    (stray,) = (one for one in choice.decisions if one.name == "stray-light")
    assert stray.on


def test_a_tilt_too_small_to_matter_leaves_a_scene_to_closed_forms(scene: Scene) -> None:
    rays = replace(scene, diffraction=None)
    paths = {
        tilt: take_picture(replace(rays, planes=(replace(scene.planes[0], tilt=(tilt, 0.0)),))).path
        for tilt in (1e-4, 0.3)
    }
    assert paths == {1e-4: "closed forms", 0.3: "rays"}


def test_a_budget_is_judged_by_the_middle_of_the_sensor(scene: Scene) -> None:
    middle, part = middle_of(scene)
    assert middle.camera.sensor.resolution == (64, 64)
    assert part == pytest.approx(64 / 96)


def test_levels_keep_less_or_more(scene: Scene) -> None:
    fast, auto, reference = (choose(scene, 0.05, level) for level in ("fast", "auto", "reference"))
    assert fast.effects <= auto.effects <= reference.effects
    assert fast.tolerance > auto.tolerance > reference.tolerance == LEAST_TOLERANCE
    assert reference.effects == {
        "defocus",
        "vignetting",
        "overlap",
        "pixel",
        "diffraction",
        "falloff",
    }


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
    assert defocus.why == "the target is in focus: too little to matter, but requested"


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
    with pytest.raises(
        InputError, match=r"^tolerance: .* it must be at least .* and below 1, for instance 0\.002$"
    ):
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
    """By a clock of their own: a picture takes longer the finer it is, and so does every try."""
    now = [0.0]

    def tried(tolerance: float) -> float:
        now[0] += 0.001 * tolerance**-power
        return 0.015 * tolerance**-power

    chosen = finest_within(seconds, tried, lambda: now[0])
    picture = 0.015 * chosen**-power
    assert now[0] + picture < seconds
    assert picture > 0.1 * seconds
