"""What cards leave of the waves of the target behind them."""

from dataclasses import replace

import numpy as np
import pytest

from flflab.image.effects.diffraction import Diffraction
from flflab.image.render import render
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import Camera, Sensor
from flflab.targets import Bars, White


def behind_a_card(camera: Camera, f_number: float) -> Scene:
    """Bars behind a white card whose edge crosses the picture, through nine microlenses that overlap at F/2."""
    lens = replace(camera.main_lens, f_number=f_number)
    few = replace(camera, main_lens=lens, array=replace(camera.array, count=(3, 3)), sensor=Sensor((96, 96), 0.00996, 61.15))
    card = Plane(White(), 420.0, offset=(-20.3, 0.0), size=(40.0, 400.0))
    return Scene(few, (card, Plane(Bars(), 506.7)), diffraction=Diffraction(800e-6))


@pytest.mark.parametrize("f_number", [4.0, pytest.param(2.0, marks=pytest.mark.ci)], ids=["apart", "overlapping"])
def test_waves_behind_a_card_are_those_of_each_micro_image_alone(camera: Camera, f_number: float) -> None:
    """The picture of nine microlenses is, within its tolerance, the sum of nine finer pictures of one, each with the others covered."""
    scene = behind_a_card(camera, f_number)
    pitch = scene.camera.array.pitch[0]
    lone = [
        replace(scene.camera, array=replace(scene.camera.array, count=(1, 1), offset=(column * pitch, row * pitch)))
        for row in (-1, 0, 1)
        for column in (-1, 0, 1)
    ]
    together, rays = render(scene, tolerance=0.002), render(replace(scene, diffraction=None), tolerance=0.002)
    alone = np.array([render(replace(scene, camera=one), tolerance=0.0005) for one in lone])  # their errors add up
    assert np.abs(together - rays).max() > 0.05
    assert np.abs(together - alone.sum(axis=0)).max() < 0.002
