"""What the effects say of themselves, against closed forms and against pictures formed without
them.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flflab.image.choose import effects_of
from flflab.image.effects.columns import Columns
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.effect import Effect
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.motion import Motion
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.soft_rims import SoftRims
from flflab.image.effects.spherical_aberration import SphericalAberration
from flflab.image.effects.stray_light import StrayLight
from flflab.image.path import path_of
from flflab.image.render import render, render_light
from flflab.image.scene import ALL, Plane, Scene, one_plane
from flflab.image.survey import survey
from flflab.optics.camera import Camera, MainLens
from flflab.targets import Bars, Edge, White

TOLERANCE = 0.002


def effect(scene: Scene, name: str) -> Effect:
    return next(one for one in effects_of(scene) if one.name == name)


def size(scene: Scene, name: str) -> float:
    return effect(scene, name).size(survey(scene))


def test_blur_rim_overlap_and_airy_disc_are_those_of_the_worked_example(camera: Camera) -> None:
    scene = replace(one_plane(camera, Bars(), 560.0), diffraction=Diffraction(550e-6))
    assert size(scene, "defocus") == pytest.approx(9.6 / 1.66, rel=0.01)
    assert size(scene, "vignetting") == pytest.approx(78.9 / 1.66, rel=1e-3)
    assert size(scene, "overlap") == pytest.approx(-89.1 / 1.66, rel=1e-3)
    assert size(scene, "diffraction") == pytest.approx(2.77 / 2, rel=0.01)
    wide = replace(scene, camera=replace(camera, main_lens=MainLens(50.0, 1.6)))
    assert size(wide, "overlap") == pytest.approx(270.2 / 1.66, rel=1e-3)


def test_shifts_are_told_in_pixels_of_the_sensor(camera: Camera) -> None:
    scene = replace(
        one_plane(camera, Bars(), 506.7016),
        motion=Motion(drift=(0.3, 0.4)),
        distortion=Distortion(0.5),
    )
    assert size(scene, "motion") == pytest.approx(0.5 * 0.0278179 / 1.66e-3, rel=1e-3)
    field = survey(scene).field
    assert size(scene, "distortion") == pytest.approx(
        0.5 * field**3 * 506.7016 * 0.0278179 / 1.66e-3, rel=1e-3
    )


def test_what_an_ideal_scene_has_not_is_not_among_its_effects(camera: Camera) -> None:
    assert [one.name for one in effects_of(one_plane(camera, White(), 500.0))] == [
        "defocus",
        "vignetting",
        "overlap",
        "pixel",
    ]
    rolled = replace(camera, array=replace(camera.array, roll=0.01))
    assert "misalignment" in {one.name for one in effects_of(one_plane(rolled, White(), 500.0))}


@pytest.mark.parametrize(
    ("name", "scene"),
    [
        ("diffraction", {"diffraction": Diffraction(550e-6)}),
        ("falloff", {"falloff": Falloff()}),
        ("stray-light", {"stray_light": StrayLight(0.01)}),
        ("distortion", {"distortion": Distortion(2.0)}),
        ("motion", {"motion": Motion((0.003, 0.0), (0.0, 0.001))}),
        ("scatter", {"scatter": Scatter(1e-4, 1e-5, 3)}),
        ("soft-rims", {"soft_rims": SoftRims(0.001)}),
        ("columns", {"columns": Columns(0.002, 0.003)}),
        ("spherical-aberration", {"spherical_aberration": SphericalAberration(0.0005)}),
    ],
)
@pytest.mark.parametrize("distance", [506.7, 450.0])
def test_a_picture_without_an_effect_differs_by_no_more_than_its_bound(
    camera: Camera, name: str, scene: dict[str, object], distance: float
) -> None:
    small = replace(camera, sensor=replace(camera.sensor, resolution=(96, 64)))
    pictured = replace(one_plane(small, Edge(math.radians(30)), distance), **scene)  # pyright: ignore[reportArgumentType]
    change = np.abs(
        render(pictured, tolerance=TOLERANCE)
        - render(pictured, tolerance=TOLERANCE, effects=ALL - {name})
    ).max()
    bound = effect(pictured, name).bound(survey(pictured))
    assert change <= bound + 2 * TOLERANCE
    assert 0 < bound < 1


@pytest.mark.parametrize("pixels", [4.0, -4.0])
def test_an_edge_is_spread_by_the_cube_of_the_place_in_the_microlens(
    camera: Camera, pixels: float
) -> None:
    """Against the share of a microlens whose rays land beyond the edge, counted by hand."""
    side = camera.sensor.pixel
    one = replace(
        camera,
        main_lens=MainLens(50.0, 2.0),  # the microlens limits
        array=replace(camera.array, count=(1, 1)),
        sensor=replace(camera.sensor, resolution=(41, 3)),
    )
    scene = replace(
        one_plane(one, Edge(0.0), 506.7016),
        spherical_aberration=SphericalAberration(pixels * side),
    )
    light = render_light(scene, 1e-3, ALL)
    radius = np.sqrt((np.arange(400) + 0.5) / 400)[:, None]
    angle = 2 * np.pi * (np.arange(200) + 0.5) / 200
    aside = np.sort((pixels * radius**3 * np.cos(angle)).ravel())
    within = ((np.arange(41) - 20)[:, None] + (np.arange(50) + 0.5) / 50 - 0.5).ravel()
    due = (np.searchsorted(aside, within) / aside.size).reshape(41, 50).mean(axis=1)
    seen = light.image[1] if light.image[1, -1] > 0.5 else light.image[1, ::-1]
    assert light.pilot is not None
    assert np.sqrt(np.mean((seen - due) ** 2)) < 2 * max(1e-3, light.pilot.rms) < 0.01
    assert 0.05 < due[18] < 0.45  # a pixel that a sharp edge leaves dark


def test_a_turned_target_differs_by_no_more_than_its_bound(camera: Camera) -> None:
    small = replace(camera, sensor=replace(camera.sensor, resolution=(96, 64)))
    scene = Scene(
        small, (Plane(Edge(0.3), 480.0, offset=(0.1, 0.0), roll=0.001, tilt=(0.01, 0.0)),)
    )
    change = np.abs(
        render(scene, tolerance=TOLERANCE)
        - render(scene, tolerance=TOLERANCE, effects=ALL - {"misalignment"})
    ).max()
    bound = effect(scene, "misalignment").bound(survey(scene))
    assert change <= bound + 2 * TOLERANCE
    assert bound < 0.1


SMALL, LARGE = ((32, 24), 2 * TOLERANCE), ((64, 48), TOLERANCE)
BY_HAND = [pytest.mark.full, pytest.mark.timeout(0)]


@pytest.mark.parametrize(
    ("seed", "size_and_tolerance"),
    [
        *(pytest.param(seed, SMALL, marks=pytest.mark.ci) for seed in (0, 2, 3)),
        *(pytest.param(seed, LARGE, marks=BY_HAND) for seed in range(40)),
    ],
)
def test_no_effect_of_a_random_scene_changes_more_than_its_bound(
    random_scene: Callable[..., Any], seed: int, size_and_tolerance: tuple[tuple[int, int], float]
) -> None:
    resolution, tolerance = size_and_tolerance
    scene = random_scene(np.random.default_rng([seed, 4]), resolution)
    if path_of(replace(scene, diffraction=None), tolerance)[0] == "rays":
        scene = replace(scene, diffraction=None)
    regime = survey(scene)
    whole = render(scene, tolerance=tolerance)
    for one in effects_of(scene):
        bound = one.bound(regime)
        if one.name in ALL and bound < 0.5:
            change = np.abs(
                whole - render(scene, tolerance=tolerance, effects=ALL - {one.name})
            ).max()
            assert change <= bound + 2 * tolerance, one.name
