"""What cards leave of the light behind them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from flflab.errors import InputError
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.motion import Motion
from flflab.image.general.targets import Boxes, covered, sight_of
from flflab.image.render import render
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import Camera, Sensor
from flflab.targets import Bars, Black, Chirp, FourDot, Target, Texture, White


def test_waves_behind_a_card_are_refused_with_the_reason(camera: Camera) -> None:
    card = Plane(White(), 420.0, offset=(-20.3, 0.0), size=(40.0, 400.0))
    scene = Scene(camera, (card, Plane(Bars(), 506.7)), diffraction=Diffraction(800e-6))
    with pytest.raises(InputError, match="a card hides what is behind it; leave the wavelength"):
        render(scene)


def white_past(camera: Camera, near: Plane, motion: Motion | None = None) -> Scene:
    return Scene(
        camera,
        (near, Plane(White(), 700.0)),
        falloff=Falloff(),
        distortion=Distortion(0.01),
        motion=motion,
    )


@pytest.mark.ci
@pytest.mark.parametrize(
    ("target", "distance"),
    [
        pytest.param(White(), 506.7, id="white in focus"),
        pytest.param(Black(), 430.0, id="black out of it"),
    ],
)
def test_white_past_a_card_askew_is_what_rays_say(
    camera: Camera, typical_difference: Callable[..., float], target: Target, distance: float
) -> None:
    """A white card's own light ends at its sides, a black one hides the white behind it: corners
    and sides are in the picture.
    """
    card = Plane(target, distance, offset=(0.2, -0.1), roll=0.3, tilt=(0.1, -0.05), size=(3.0, 2.5))
    assert typical_difference(white_past(camera, card), tolerance=0.002) < 0.002


@pytest.mark.ci
def test_white_past_a_card_that_drifts_and_trembles_is_what_rays_say(
    camera: Camera, typical_difference: Callable[..., float]
) -> None:
    card = Plane(Black(), 470.0, offset=(0.2, -0.1), roll=0.3, size=(3.0, 2.5))
    moving = white_past(camera, card, Motion(drift=(0.1, 0.04), vibration=(-0.02, 0.05)))
    assert typical_difference(moving, tolerance=0.002, count=4) < 0.002


@pytest.mark.ci
def test_white_past_two_cards_that_overlap_is_what_rays_say(
    camera: Camera, typical_difference: Callable[..., float]
) -> None:
    """Where both leave some rays, no picture of one of them tells how many."""
    near, far = (
        Plane(Black(), distance, offset=(x, 0.3), roll=x, size=(2.0, 1.5))
        for distance, x in ((430.0, -0.6), (506.7, 0.5))
    )
    scene = Scene(camera, (near, far, Plane(White(), 700.0)), falloff=Falloff())
    assert typical_difference(scene, tolerance=0.002, count=4) < 0.002


@pytest.mark.ci
@pytest.mark.parametrize(
    "target", [Bars((0.5, 3.0), 8.0, 8.0), Chirp((3.0, 0.5), 8.0, 8.0)], ids=["bars", "chirp"]
)
def test_bars_on_a_card_too_small_for_them_are_what_rays_say(
    camera: Camera, typical_difference: Callable[..., float], target: Bars
) -> None:
    """The card's sides cut bars anywhere, and not where one begins."""
    plane = Plane(target, 480.0, offset=(0.2, -0.1), roll=0.2, size=(3.1, 2.7))
    assert typical_difference(Scene(camera, (plane,)), tolerance=0.002, count=4) < 0.002


@pytest.mark.ci
def test_large_dots_past_cards_are_what_rays_say(
    camera: Camera, typical_difference: Callable[..., float], allowed: Callable[..., float]
) -> None:
    """Most pixels look into one dot, cut by its own card or hidden by another, or past all dots;
    some see edges of both.
    """
    near = Plane(Black(), 450.0, offset=(0.3, -0.5), roll=0.3, size=(1.0, 0.8))
    dots = Plane(
        FourDot(2.0, 2.2), 490.0, offset=(0.2, -0.1), roll=0.2, tilt=(0.1, 0.0), size=(3.6, 3.0)
    )
    scene = Scene(
        replace(camera, sensor=Sensor((64, 48), 0.00996, 61.15)),
        (near, dots),
        falloff=Falloff(),
        distortion=Distortion(0.01),
    )
    assert typical_difference(scene, tolerance=0.002, count=6) < allowed(scene)


@pytest.mark.parametrize("target", [Bars((12.9, 13.1), 9.8, 8.4), Texture(12.0, 0.06, 3)])
def test_boxes_that_look_past_a_card_see_what_is_on_it_and_no_more(target: Target) -> None:
    """Over all places of a box, wider or narrower than the card, the light adds up to the card's:
    14 periods on it are not 14 beyond its rim.
    """
    half, step = (0.55, 0.3), 0.004
    across = np.linspace(-2.0, 2.0, 1001)[:, None]
    row = np.full_like(across, 0.03)  # the middle of a row of texels
    columns = np.arange(-half[0] + step / 2, half[0], step)
    for wide in (0.02, 0.3, 1.6):
        boxes = Boxes(*(np.array([side]) for side in (0.05 * wide, 0.0, wide, 1e-6)))
        light = sight_of(target)(across, row, boxes, half)
        light = light * covered(across, row, boxes, *half)
        on_it = target.radiance(columns, np.full_like(columns, 0.03)).sum() * step
        assert light.sum() * 0.004 == pytest.approx(on_it, rel=0.01)
