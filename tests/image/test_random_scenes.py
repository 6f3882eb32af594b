"""Pixels of random scenes that were once wrong.

Rays are held against those refracted one by one and summed by the slow reference, waves against
finer ones.
"""

from dataclasses import replace

import numpy as np
import pytest

from flflab.image.promise import drawn, sharpest
from flflab.image.reference.pixels import trace_pixels
from flflab.image.render import render
from flflab.image.scene import Scene
from flflab.targets import Picture, White


def scene_of(seed: int) -> Scene:
    """A random scene in light of rays, still, without what spreads or filters its light."""
    return replace(
        drawn(seed)[0], diffraction=None, motion=None, stray_light=None, colour_filter=None
    )


def small_scene(seed: int) -> Scene:
    """A random scene of fewer pixels, in light of rays, without what spreads or filters it."""
    return replace(
        drawn(seed, (160, 120))[0],
        diffraction=None,
        scatter=None,
        stray_light=None,
        colour_filter=None,
    )


def errors(scene: Scene, pixels: list[tuple[int, int]], tolerance: float) -> list[float]:
    """How far pixels (row, column) of the picture are from rays that are sure to a tenth of the
    tolerance, of white.
    """
    columns_rows = np.array(pixels)[:, ::-1]
    wanted = np.zeros(scene.camera.sensor.resolution[::-1], dtype=np.bool_)
    wanted[tuple(np.array(pixels).T)] = True
    traced, uncertainty = trace_pixels(scene, columns_rows, wanted=tolerance / 10)
    assert uncertainty.max() <= tolerance / 10
    return list(
        np.abs(
            render(scene, tolerance=tolerance, wanted=wanted)[tuple(np.array(pixels).T)] - traced
        )
    )


@pytest.mark.parametrize(
    "tolerance",
    [pytest.param(0.004, marks=pytest.mark.ci), pytest.param(0.001, marks=pytest.mark.full)],
)
def test_pixels_askew_on_a_picture_are_not_smoothed_beyond_their_own_width(
    tolerance: float,
) -> None:
    texels, card = (168, 36), (130, 14)
    grey, behind = scene_of(757).planes
    assert isinstance(grey.target, Picture)
    black_and_white = replace(grey, target=sharpest(grey.target))
    for plane in (grey, black_and_white):
        assert (
            max(errors(replace(scene_of(757), planes=(plane, behind)), [texels, card], tolerance))
            < tolerance
        )


def test_a_card_across_a_rim_is_not_settled_by_one_chance() -> None:
    nearest = scene_of(612).planes[0]
    scene = replace(scene_of(612), planes=(replace(nearest, target=White()),))
    assert max(errors(scene, [(158, 46)], 0.0097)) < 0.0097


def test_rows_across_a_rim_weigh_as_much_as_the_pupil_between_them() -> None:
    """Chords in the middles of few rows are not the mean of a lens that has corners."""
    assert max(errors(small_scene(29), [(66, 128)], 0.0546)) < 0.3 * 0.0546
    assert max(errors(small_scene(254), [(66, 95)], 0.005)) < 0.4 * 0.005


def test_sharp_dots_lose_the_light_of_the_whole_cone_and_not_of_its_middle() -> None:
    nearest = scene_of(624).planes[0]
    assert max(errors(replace(scene_of(624), planes=(nearest,)), [(34, 11), (35, 11)], 0.05)) < 0.05


def test_slightly_blurred_pictures_askew_lose_the_light_of_the_whole_cone_and_not_of_its_middle() -> (  # noqa: E501
    None
):
    """So slight a blur needs one point of the pupil, the fall-off more: 0.06 of white off."""
    nearest = scene_of(555).planes[0]
    assert (
        max(errors(replace(scene_of(555), planes=(nearest,)), [(26, 130), (2, 53)], 0.0037))
        < 0.0037
    )


def test_fall_off_on_a_rim_narrower_than_a_pixel_is_not_that_of_the_pupils_last_sliver() -> None:
    """The pixel's centre is beyond the rim: the weight of the pupil's last sliver had counted for
    all of it.
    """
    assert max(errors(scene_of(13), [(14, 20)], 3e-3)) < 1e-3


def test_an_edge_between_two_rows_of_the_pupil_is_seen_past_a_card() -> None:
    """Five rows and ten agreed by chance and were 0.004 of white off."""
    pixel, wanted = (16, 245), np.zeros((192, 256), dtype=np.bool_)
    wanted[pixel] = True
    traced = 0.48639  # by trace_pixels, sure to 0.00001; it took 150 s
    assert abs(render(scene_of(651), tolerance=0.0017, wanted=wanted)[pixel] - traced) < 0.0017


def test_errors_of_many_micro_images_past_a_moving_card_do_not_add_up() -> None:
    """Each had been given moments of the exposure for an error of the whole, and thirty of them
    were 1.3 tolerances off.
    """
    tolerance, pixel, wanted = 0.0017, (72, 229), np.zeros((192, 256), dtype=np.bool_)
    wanted[pixel] = True
    scene = replace(drawn(440)[0], diffraction=None, stray_light=None, colour_filter=None)
    traced = 2.66889  # by trace_pixels, sure to 0.00017; it took 285 s
    assert abs(render(scene, tolerance=tolerance, wanted=wanted)[pixel] - traced) < 0.3 * tolerance


@pytest.mark.ci
def test_a_card_aslant_of_the_rows_of_the_pupil_is_not_summed_in_few_cells() -> None:
    """Rows of two cells erred by 0.0035 of white, and neither more rows nor more cells alone showed
    it.
    """
    nearest = scene_of(35).planes[0]
    assert max(errors(replace(scene_of(35), planes=(nearest,)), [(118, 19)], 0.002)) < 0.2 * 0.002


@pytest.mark.ci
def test_a_narrow_rim_past_a_card_cuts_every_ray_at_its_own_place() -> None:
    """Parts of a pixel that looked through one pupil from the middle of what the rim leaves of them
    erred by 0.004 of white.
    """
    nearest = scene_of(741).planes[0]
    black_and_white = replace(nearest, target=sharpest(nearest.target))
    assert (
        max(errors(replace(scene_of(741), planes=(black_and_white,)), [(60, 118)], 0.002))
        < 0.2 * 0.002
    )


def test_a_rim_narrower_than_a_pixel_weighs_the_rays_that_it_passes() -> None:
    """With the fall-off of the whole pupil its light was 0.0025 of white off."""
    assert (
        max(
            errors(
                replace(scene_of(741), planes=scene_of(741).planes[1:]),
                [(105, 116), (93, 66)],
                0.002,
            )
        )
        < 0.2 * 0.002
    )


def test_a_sliver_of_light_past_a_card_is_not_missed_in_few_cells() -> None:
    """Twice the cells, rows or parts, each alone, changed less than a sixth of the tolerance of
    what was 1.5 tolerances off.
    """
    assert max(errors(replace(scene_of(650), falloff=None), [(191, 137)], 0.0053)) < 0.3 * 0.0053


@pytest.mark.ci
def test_a_rim_of_some_pixels_past_the_edge_of_a_card_cuts_the_pupil_however_few_the_parts() -> (
    None
):
    """Coarse parts were cut instead, in five rows of the pupil: two numbers of them agreed and were
    0.0055 of white off in one lens.
    """
    nearest = scene_of(237).planes[0]
    assert max(errors(replace(scene_of(237), planes=(nearest,)), [(1, 102)], 0.0025)) < 0.3 * 0.0025


def one_pixel(seed: int, pixel: tuple[int, int], finer: float) -> tuple[float, float]:
    """A pixel (row, column) of a random scene in black and white, unspread and unfiltered, and its
    tolerance, so many times finer.
    """
    scene, tolerance = drawn(seed)
    planes = tuple(replace(plane, target=sharpest(plane.target)) for plane in scene.planes)
    scene = replace(scene, planes=planes, stray_light=None, colour_filter=None)
    wanted = np.zeros((192, 256), dtype=np.bool_)
    wanted[pixel] = True
    return (
        float(render(scene, tolerance=0.7 * tolerance / finer, wanted=wanted)[pixel]),
        0.7 * tolerance,
    )


@pytest.mark.ci
def test_the_far_light_of_dots_behind_nine_micro_images_does_not_add_up_to_one_side() -> None:
    """It was 3.7 of the tolerance."""
    light, tolerance = one_pixel(763, (171, 39), 1.0)
    assert abs(light - 4.14491) < tolerance  # formed 17 times finer, which took 22 s


@pytest.mark.full
def test_what_little_waves_change_past_a_card_does_not_add_up_to_one_side() -> None:
    """It was 1.5 of the tolerance."""
    (coarse, tolerance), (fine, _) = (one_pixel(748, (161, 239), finer) for finer in (1.0, 17.0))
    assert abs(coarse - fine) < tolerance
