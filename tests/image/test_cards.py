"""Which parts of micro-images cards hide, and by how much."""

from dataclasses import replace

import numpy as np
import pytest

from flflab.image.cards import cards_of, passing, split
from flflab.image.form import add_plane
from flflab.image.scene import Plane, Scene
from flflab.image.setup import make_setup
from flflab.image.single_rays import add_single_rays
from flflab.optics.camera import Camera, Sensor
from flflab.targets import Bars, White


@pytest.mark.parametrize("distance", [420.0, 480.0], ids=["blurred edge", "sharp edge"])
def test_a_part_counts_by_about_the_light_that_cards_let_pass(camera: Camera, distance: float) -> None:
    """Against the pictures of white with and without the card, part by part, where the main lens clips nothing."""
    lone = replace(camera, array=replace(camera.array, count=(1, 1)), sensor=Sensor((64, 48), 0.00664, 61.15))
    card = Plane(White(), distance, offset=(-2.05, 0.0), size=(4.0, 40.0))
    behind = Plane(Bars(), 506.7)
    scene = Scene(lone, (card, behind))
    cards = cards_of(scene, 1)
    _, crossed = split(make_setup(scene, behind, 0.002), 1 / behind.distance, None, cards)
    passed, whole = np.zeros((48, 64)), np.zeros((48, 64))
    add_single_rays(passed, crossed, replace(behind, target=White()), None, cards)
    add_plane(whole, crossed, White())
    shares = passing(crossed, 1 / behind.distance, None, cards)
    lit = [
        (share, passed[low:high, left:right].sum() / light)
        for share, (left, right, low, high) in zip(shares, crossed.window, strict=True)
        if (light := whole[low:high, left:right].sum()) > 0.9 * (right - left) * (high - low)
    ]
    about, exact = np.array(lit).T
    assert len(about) > 10
    assert exact.min() < 0.2 < 0.8 < exact.max()
    assert np.abs(about - exact).max() < 0.2
    assert np.abs(about - exact).mean() < 0.07
