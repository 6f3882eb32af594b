"""A coloured picture through a raw file and back, as other raw readers see it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rawpy

from flflab.files.image import write_picture
from flflab.files.raw import read_raw, write_raw
from flflab.image.effects.colour_filter import ColourFilter
from flflab.image.effects.quantisation import Quantisation
from flflab.image.effects.saturation import Saturation
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.image.sensor.random_numbers import noise_key
from flflab.image.sensor.raw_picture import neutral, raw_picture
from flflab.image.sensor.response import SensorResponse, digitise
from flflab.optics.camera import Camera
from flflab.targets import White


@pytest.mark.parametrize("pattern", ["rggb", "gbrg"])
def test_the_white_balance_of_a_raw_file_makes_a_white_target_grey(
    camera: Camera, tmp_path: Path, pattern: str
) -> None:
    mosaic = ColourFilter(pattern, red=0.6, green=0.9, blue=0.5)
    scene = replace(one_plane(camera, White(), 506.7), colour_filter=mosaic)
    response = SensorResponse(Quantisation(12, 0.4, 64.0), Saturation(9000.0))
    numbers = digitise(render(scene), 8000.0, response, noise_key(1))
    write_raw(tmp_path / "white.dng", raw_picture(numbers, response, mosaic))
    with rawpy.imread(str(tmp_path / "white.dng")) as raw:
        assert np.array_equal(raw.raw_image, numbers)
        assert raw.white_level == round(64 + 0.4 * 9000)
        light = np.array(raw.raw_image, dtype=float) - raw.black_level_per_channel[0]
        balance = np.array([*raw.camera_whitebalance[:3], raw.camera_whitebalance[1]])[
            raw.raw_colors
        ]
        bright = np.s_[90:140, 90:180]  # inside one micro-image
        means = [
            float((light * balance)[bright][raw.raw_colors[bright] == colour].mean())
            for colour in range(4)
        ]
        lit = light[bright].mean() > 1000
        assert lit
        assert means == pytest.approx([means[1]] * 4, rel=0.01)


def test_light_without_noise_keeps_its_mosaic_in_a_raw_file(tmp_path: Path) -> None:
    mosaic = ColourFilter("grbg")
    write_picture(
        tmp_path / "light.dng",
        np.full((30, 40), 0.5),
        pattern=mosaic.pattern,
        neutral=neutral(mosaic),
    )
    back = read_raw(tmp_path / "light.dng")
    assert (back.pattern, back.white_level, back.black_level) == ("grbg", 65535, (0, 0, 0, 0))
    assert back.neutral == pytest.approx((0.6, 1.0, 0.5))
    assert np.all(back.values == 8192)


def test_without_filters_or_through_black_ones_the_colours_are_alike() -> None:
    assert neutral(None) == neutral(ColourFilter(red=0.0)) == (1.0, 1.0, 1.0)
    assert raw_picture(np.zeros((30, 30), dtype=np.uint16), SensorResponse(), None).pattern is None
