from dataclasses import replace

import numpy as np
import pytest

from flflab.errors import InputError
from flflab.image.image_report import image_report
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.optics.camera import Camera, MainLens
from flflab.targets import Bars, Black, FourDot, Target

ALL = {
    "defocus",
    "vignetting",
    "overlap",
    "pixel",
    "diffraction",
    "falloff",
    "distortion",
    "misalignment",
    "scatter",
    "stray-light",
    "colour-filter",
    "motion",
    "shot-noise",
    "read-noise",
    "dark-current",
    "fixed-pattern",
    "saturation",
    "quantisation",
}


def test_every_effect_of_the_contract_is_told_with_a_reason(camera: Camera) -> None:
    report = image_report(camera, Bars(), 506.7)
    assert {effect.name for effect in report.effects} == ALL
    assert len(report.effects) == len(ALL)
    assert all(effect.why for effect in report.effects)
    assert {effect.name for effect in report.effects if effect.on} == {"defocus", "vignetting", "pixel"}


@pytest.mark.parametrize("target", [Bars(), FourDot(1.0, 2.0), Black()])
@pytest.mark.parametrize("distance", [506.7016, 500.0])
def test_the_estimate_is_not_below_the_error(camera: Camera, target: Target, distance: float) -> None:
    report = image_report(camera, target, distance)
    truth = render(one_plane(camera, target, distance), tolerance=0.00005)
    assert np.abs(report.image - truth).max() <= report.error_estimate + 0.00005
    assert report.error_estimate < 0.0025


def test_levels_set_the_tolerance(camera: Camera) -> None:
    fast, finest = (image_report(camera, Bars(), 500.0, effects=level) for level in ("fast", "reference"))
    assert finest.error_estimate < 0.0004 < fast.error_estimate


def test_overlap_is_on_where_micro_images_overlap(camera: Camera) -> None:
    report = image_report(replace(camera, main_lens=MainLens(50.0, 1.6)), FourDot(1.0, 2.0), 506.7)
    overlap = next(effect for effect in report.effects if effect.name == "overlap")
    assert overlap.on
    assert overlap.size == pytest.approx(270.2 / 1.66, rel=1e-3)


def test_noise_comes_with_a_seed_and_repeats_with_it(camera: Camera) -> None:
    one, again, other = (image_report(camera, Bars(), 506.7, seed=seed).image for seed in (1, 1, 2))
    quiet = image_report(camera, Bars(), 506.7).image
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    assert np.abs((one - quiet).mean()) < 1e-3
    assert 0.001 < (one - quiet).std() < 0.05


def test_a_camera_file_with_a_roll_is_misaligned(camera: Camera) -> None:
    rolled = replace(camera, array=replace(camera.array, roll=0.01))
    assert {effect.name: effect.on for effect in image_report(rolled, Black(), 506.7).effects}["misalignment"]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("sparkle", "there is no 'sparkle'; allowed: auto, fast, reference, defocus"),
        ("diffraction", "not simulated"),
        ("defocus,pixel", "add vignetting, overlap"),
        ("defocus,vignetting,overlap,pixel,shot-noise", "seed"),
        ("", "add defocus"),
        ("misalignment", "camera file"),
    ],
)
def test_effects_that_cannot_be_chosen_are_refused(camera: Camera, asked: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        image_report(camera, Bars(), 506.7, effects=asked)
