"""What a scene's picture must be without knowing how it is formed."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import InputError
from flflab.image.accuracy import TOLERANCE
from flflab.image.effects.colour_filter import ColourFilter
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.motion import Motion
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.stray_light import StrayLight
from flflab.image.render import render
from flflab.image.scene import ALL, Plane, Scene, one_plane
from flflab.optics.camera import Camera, MainLens, Sensor, Substrate
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, White

Array = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def small(camera: Camera) -> Camera:
    return replace(
        camera,
        array=replace(camera.array, count=(5, 5)),
        sensor=Sensor((110, 90), 0.00166, 61.15, (0.1, 0.05)),
    )


def test_an_effect_that_the_scene_lacks_changes_nothing(small: Camera) -> None:
    scene = one_plane(small, Bars(), 500.0)
    for name in (
        "distortion",
        "scatter",
        "motion",
        "stray-light",
        "colour-filter",
        "falloff",
        "diffraction",
    ):
        assert np.array_equal(render(scene), render(scene, effects=ALL - {name}))


def test_an_effect_that_is_off_is_as_if_the_scene_lacked_it(small: Camera) -> None:
    plain = one_plane(
        replace(small, sensor=replace(small.sensor, offset=(0.0, 0.0))), Bars(), 500.0
    )
    array = replace(small.array, offset=(0.1, 0.0), roll=0.1, tilt=(0.01, 0.0))
    full = Scene(
        replace(small, array=array, sensor=replace(small.sensor, offset=(0.03, 0.0))),
        (Plane(Bars(), 500.0, roll=0.1, tilt=(0.1, 0.0)),),
        falloff=Falloff(),
        distortion=Distortion(1.0),
        scatter=Scatter(0.05, 0.01),
        stray_light=StrayLight(0.1),
        colour_filter=ColourFilter(),
        motion=Motion((1.0, 0.0)),
    )
    off = {
        "falloff",
        "distortion",
        "scatter",
        "stray-light",
        "colour-filter",
        "motion",
        "misalignment",
    }
    assert np.array_equal(render(full, effects=ALL - off), render(plain))


def test_an_unknown_effect_is_refused(small: Camera) -> None:
    scene = one_plane(small, Bars(), 500.0)
    with pytest.raises(InputError, match="there is no 'sparkle'"):
        render(scene, effects=ALL | {"sparkle"})


def test_without_defocus_every_ray_ends_where_the_pupils_middle_ray_does(small: Camera) -> None:
    centred = replace(small, sensor=Sensor((110, 90), 0.00166, 61.15))
    pinholes = replace(centred, array=replace(centred.array, aperture=1e-5))
    sharp = render(one_plane(centred, Edge(), 495.0), effects=ALL - {"defocus"})
    truth = render(one_plane(pinholes, Edge(), 495.0))
    middle = render(one_plane(centred, White(), 495.0)) > 0.999
    assert np.abs(sharp - truth)[middle].max() < 0.002
    assert np.abs(render(one_plane(centred, Edge(), 495.0)) - truth)[middle].max() > 0.1


def test_without_vignetting_and_pixels_a_micro_image_ends_at_once(small: Camera) -> None:
    image = render(one_plane(small, White(), 500.0), effects=ALL - {"vignetting", "pixel"})
    assert set(np.unique(image)) == {0.0, 1.0}


def test_without_overlap_white_is_nowhere_brighter_than_one(small: Camera) -> None:
    wide = replace(small, main_lens=MainLens(50.0, 1.6))
    assert render(one_plane(wide, White(), 500.0)).max() > 1.5
    assert render(one_plane(wide, White(), 500.0), effects=ALL - {"overlap"}).max() <= 1.0


def test_the_slightest_tilt_distortion_or_scatter_is_none(small: Camera) -> None:
    plain = render(one_plane(small, Bars(), 500.0))
    slight = Scene(
        small,
        (Plane(Bars(), 500.0, roll=1e-9, tilt=(1e-9, 0.0)),),
        distortion=Distortion(1e-9),
        scatter=Scatter(1e-9, 1e-9),
    )
    assert np.abs(render(slight) - plain).max() < 1e-5


def test_a_quarter_turn_leaves_four_dots_as_they_are(small: Camera) -> None:
    dots = FourDot(1.0, 2.0)
    turned = Scene(small, (Plane(dots, 500.0, roll=math.pi / 2),))
    assert np.abs(render(turned) - render(one_plane(small, dots, 500.0))).max() < 1e-9


def test_a_white_target_is_white_however_it_stands(small: Camera) -> None:
    plain = render(one_plane(small, White(), 500.0))
    leaning = Scene(
        small, (Plane(White(), 500.0, roll=0.3, tilt=(0.3, 0.2)),), distortion=Distortion(2.0)
    )
    assert np.abs(render(leaning) - plain).max() < 1e-6


def test_a_white_card_before_white_cannot_be_seen(small: Camera) -> None:
    plain = render(one_plane(small, White(), 500.0))
    hidden = Scene(
        small,
        (Plane(White(), 470.0, (1.0, 0.5), 0.1, (0.2, 0.0), (3.0, 2.0)), Plane(White(), 500.0)),
    )
    assert np.abs(render(hidden) - plain).max() < 0.002


@pytest.mark.ci
def test_a_small_card_changes_nothing_away_from_its_picture(small: Camera) -> None:
    plain = render(one_plane(small, Bars(), 506.7))
    card = Plane(Picture(np.zeros((1, 1)), 0.3), 506.0, (0.5, 0.3), size=(0.3, 0.3))
    changed = np.abs(render(Scene(small, (card, Plane(Bars(), 506.7)))) - plain) > 0.02
    assert 20 < changed.sum() < 400  # 0.3 mm are 5 pixels; two micro-images at most see it


def test_a_white_card_is_a_white_picture_of_its_size(small: Camera) -> None:
    card = Scene(small, (Plane(White(), 495.0, (1.0, 0.5), 0.2, size=(3.0, 2.0)),))
    picture = Scene(small, (Plane(Picture(np.ones((2, 3)), 3.0), 495.0, (1.0, 0.5), 0.2),))
    assert np.abs(render(card) - render(picture)).max() < 0.003


@pytest.mark.ci
@pytest.mark.parametrize("motion", [Motion(drift=(0.25, -0.1)), Motion(vibration=(0.1, 0.05))])
def test_a_moving_target_is_the_mean_of_standing_ones(small: Camera, motion: Motion) -> None:
    phase = (np.arange(300) + 0.5) / 300
    places = [
        (phase - 0.5)[:, None] * motion.drift
        + np.sin(2 * np.pi * phase)[:, None] * motion.vibration
    ][0]
    few = replace(small, sensor=Sensor((60, 40), 0.00166, 61.15))
    standing = [render(one_plane(few, Edge(0.3), 505.0, (float(x), float(y)))) for x, y in places]
    moving = render(replace(one_plane(few, Edge(0.3), 505.0), motion=motion))
    apart = (moving - np.mean(standing, axis=0))[moving > 0]
    assert np.sqrt(np.mean(apart**2)) < 0.002
    assert np.abs(moving - render(one_plane(few, Edge(0.3), 505.0))).max() > 0.1


def test_stray_light_spreads_its_share_evenly(small: Camera) -> None:
    scene = one_plane(small, Bars(), 500.0)
    plain, veiled = render(scene), render(replace(scene, stray_light=StrayLight(0.1)))
    assert veiled.mean() == pytest.approx(plain.mean())
    assert np.allclose(veiled, 0.9 * plain + 0.1 * plain.mean())


def test_a_colour_filter_dims_each_pixel_by_its_place(small: Camera) -> None:
    scene = one_plane(small, White(), 500.0)
    plain, filtered = (
        render(scene),
        render(replace(scene, colour_filter=ColourFilter("grbg", 0.5, 0.9, 0.25))),
    )
    for (row, column), share in {(0, 0): 0.9, (0, 1): 0.5, (1, 0): 0.25, (1, 1): 0.9}.items():
        assert np.allclose(filtered[row::2, column::2], share * plain[row::2, column::2])


def test_half_the_radiance_is_half_the_light(small: Camera) -> None:
    values = np.random.default_rng(2).random((8, 8))
    full, half = (
        Scene(small, (Plane(Picture(v, 4.0), 495.0, size=(3.0, 3.0), tilt=(0.1, 0.2)),))
        for v in (values, values / 2)
    )
    apart = render(full) - 2 * render(half)
    assert np.sqrt(np.mean(apart**2)) < 3 * TOLERANCE  # each is within it, the half one twice


@pytest.mark.ci
def test_bars_that_move_by_half_a_period_are_the_mean_of_bars_that_stand(small: Camera) -> None:
    fine, way, count = Chirp((9.0, 9.2), 6.0, 6.0), 0.055, 64
    moving = render(replace(one_plane(small, fine, 500.0), motion=Motion(drift=(way, 0.0))))
    standing = [
        render(Scene(small, (Plane(fine, 500.0, offset=(way * ((k + 0.5) / count - 0.5), 0.0)),)))
        for k in range(count)
    ]
    apart = moving - np.mean(standing, axis=0)
    assert np.sqrt(np.mean(apart[moving > 0] ** 2)) < TOLERANCE
    assert np.std(moving - standing[0]) > 0.01


def test_scatter_is_the_same_for_a_seed_and_grows_with_its_numbers(small: Camera) -> None:
    def scattered(seed: int) -> Array:
        return render(replace(one_plane(small, Bars(), 500.0), scatter=Scatter(0.02, 0.002, seed)))

    assert np.array_equal(scattered(1), scattered(1))
    assert np.abs(scattered(1) - scattered(2)).max() > 0.05


def test_distances_count_from_principal_planes_and_a_plate_is_thinner_in_air(small: Camera) -> None:
    plain = render(one_plane(small, Bars(), 500.0))
    thick = replace(small, main_lens=replace(small.main_lens, principal_separation=7.0))
    assert np.array_equal(render(one_plane(thick, Bars(), 500.0)), plain)
    plate = replace(
        small,
        array=replace(small.array, substrate=Substrate(0.6, 1.5)),
        sensor=replace(small.sensor, distance=small.sensor.distance - 0.4),
    )
    assert np.abs(render(one_plane(plate, Bars(), 500.0)) - plain).max() < 1e-6


def test_what_cannot_be_pictured_is_refused_with_the_reason(small: Camera) -> None:
    far_off = replace(
        small,
        sensor=replace(small.sensor, offset=(4.0, 0.0)),
        array=replace(small.array, count=(25, 5)),
    )
    with pytest.raises(InputError, match="folds the picture over"):
        render(Scene(far_off, (Plane(Bars(), 500.0),), distortion=Distortion(-100.0)))
    with pytest.raises(InputError, match="reaches the main lens"):
        render(Scene(small, (Plane(White(), 100.0, (500.0, 0.0), tilt=(0.4, 0.0)),)))
