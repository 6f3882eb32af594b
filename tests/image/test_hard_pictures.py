"""Hard cases of image formation, each against rays refracted one by one or what must hold by
hand.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import InputError
from flflab.image.render import render
from flflab.image.scene import Scene, one_plane
from flflab.image.sensor.random_numbers import noise_key
from flflab.image.sensor.response import SensorResponse, digitise
from flflab.optics.camera import Camera, MainLens, Sensor
from flflab.targets import Bars, Black, Edge, FourDot, Target, White

pytestmark = pytest.mark.ci

FOCUS = 506.7016
TOLERANCE = 0.002
SLOWER = pytest.mark.ci
Difference = Callable[..., float]


def cropped(camera: Camera, columns: int = 150, rows: int = 40) -> Camera:
    return replace(camera, sensor=replace(camera.sensor, resolution=(columns, rows)))


def in_exit_pupil(camera: Camera, beyond: float) -> Camera:
    """The sensor where kappa is 0 (``beyond`` 1), or so many times as far from the array."""
    gap = beyond * 0.917 * 60.0 / (60.0 - 0.917)
    return cropped(replace(camera, sensor=replace(camera.sensor, distance=60.0 + gap)), 260, 40)


def differences(
    trace_pixels: Callable[..., Any], scene: Scene, pixels: list[tuple[int, int]]
) -> npt.NDArray[np.float64]:
    """Of the picture from rays in units of the white level, at pixels (column, row), less four
    uncertainties.
    """
    chosen = np.array(pixels)
    image = render(scene, tolerance=TOLERANCE)
    assert np.isfinite(image).all()
    traced, uncertainty = trace_pixels(scene, chosen, wanted=2e-4)
    return np.maximum(np.abs(image[chosen[:, 1], chosen[:, 0]] - traced) - 4 * uncertainty, 0)


@pytest.mark.parametrize("target", [White(), Bars()], ids=lambda target: target.kind)
@pytest.mark.parametrize(
    "beyond", [1.0, pytest.param(1 - 1e-3, marks=SLOWER), pytest.param(1 + 1e-6, marks=SLOWER)]
)
def test_the_sensor_in_the_exit_pupil_and_beside_it(
    camera: Camera, typical_difference: Difference, target: Target, beyond: float
) -> None:
    assert (
        typical_difference(one_plane(in_exit_pupil(camera, beyond), target, FOCUS), 4) < TOLERANCE
    )


@pytest.mark.parametrize("target", [FourDot(1.0, 1.6), Bars()], ids=lambda target: target.kind)
def test_the_targets_image_on_the_array(
    camera: Camera, typical_difference: Difference, target: Target
) -> None:
    assert (
        typical_difference(one_plane(cropped(camera), target, 1 / (1 / 50 - 1 / 60)), 4) < TOLERANCE
    )


def test_an_edge_at_infinity(camera: Camera, typical_difference: Difference) -> None:
    assert typical_difference(one_plane(cropped(camera), Edge(), math.inf), 6) < TOLERANCE


@pytest.mark.parametrize("target", [White(), Edge()], ids=lambda target: target.kind)
@pytest.mark.parametrize("f_number", [pytest.param(1e3, marks=SLOWER), 1e7])
def test_a_pinhole_in_the_main_lens(
    camera: Camera, typical_difference: Difference, target: Target, f_number: float
) -> None:
    assert (
        typical_difference(
            one_plane(replace(cropped(camera), main_lens=MainLens(50.0, f_number)), target, FOCUS),
            4,
        )
        < TOLERANCE
    )


@pytest.mark.parametrize("target", [White(), Bars()], ids=lambda target: target.kind)
@pytest.mark.parametrize("aperture", [pytest.param(1e-3, marks=SLOWER), 1e-8])
def test_pinholes_for_microlenses(
    camera: Camera, typical_difference: Difference, target: Target, aperture: float
) -> None:
    pinholes = replace(cropped(camera, 200, 30), array=replace(camera.array, aperture=aperture))
    assert typical_difference(one_plane(pinholes, target, FOCUS), 4) < TOLERANCE


def test_both_stops_seen_alike_to_the_last_bit_touch_in_one_point(
    trace_pixels: Callable[..., Any], camera: Camera
) -> None:
    gap, length, focal = 0.25, 64.0, 0.125  # kappa = 1 + b/L - b/f, all of it exact in binary
    kappa = 1 + gap / length - gap / focal
    aperture = 0.25
    array = replace(
        camera.array, aperture=aperture, focal_lengths=(focal,), distance=length, count=(1, 1)
    )
    stop = aperture * abs(kappa) * length / gap
    same = Camera(MainLens(stop * 4, 4.0), array, Sensor((401, 9), 0.00125, length + gap))
    assert (
        max(
            differences(
                trace_pixels,
                one_plane(same, White(), 900.0),
                [(200, 4), (201, 4), (300, 3), (395, 4), (399, 4), (400, 4)],
            )
        )
        < TOLERANCE
    )
    assert render(one_plane(same, White(), 900.0))[4, 200] == pytest.approx(
        1, abs=0.01
    )  # a cone from its tip


def test_matched_openings_of_main_lens_and_microlens(
    camera: Camera, typical_difference: Difference
) -> None:
    matched = replace(
        cropped(camera, 260), main_lens=MainLens(50.0, 50.0 / (0.336 / 1.15 * 60.0))
    )  # A/L = d/b
    assert typical_difference(one_plane(matched, White(), FOCUS), 6) < TOLERANCE


def test_discs_that_touch_from_outside(trace_pixels: Callable[..., Any], camera: Camera) -> None:
    one = replace(
        camera,
        array=replace(camera.array, count=(1, 1)),
        sensor=replace(camera.sensor, resolution=(241, 9)),
    )
    outside = round(318.5 / 2 / 1.66)  # the rim of the total field, in pixels from the middle
    assert (
        max(
            differences(
                trace_pixels,
                one_plane(one, White(), FOCUS),
                [(120 + outside + step, 4) for step in (-3, -2, -1, 0, 1, 2)],
            )
        )
        < TOLERANCE
    )


def test_micro_images_of_one_pixel(camera: Camera, typical_difference: Difference) -> None:
    array = replace(
        camera.array,
        pitch=(0.004, 0.004),
        aperture=0.003,
        count=(40, 40),
        focal_lengths=(0.02,),
        distance=60.0,
    )
    tiny = Camera(MainLens(50.0, 8.0), array, Sensor((60, 50), 0.0016, 60.025))
    assert typical_difference(one_plane(tiny, Edge(), 600.0), 8) < TOLERANCE


@pytest.mark.parametrize("cycles_per_px", [0.5, pytest.param(1.0, marks=SLOWER), 3.3])
def test_bars_at_and_beyond_nyquist(
    camera: Camera, typical_difference: Difference, cycles_per_px: float
) -> None:
    frequency = cycles_per_px * 0.0278179 / 0.00166
    assert (
        typical_difference(one_plane(cropped(camera), Bars((frequency, frequency)), FOCUS), 4)
        < TOLERANCE
    )


def test_a_dark_scene_is_exactly_dark(camera: Camera) -> None:
    assert not render(one_plane(cropped(camera), Black(), FOCUS)).any()
    assert not render(one_plane(cropped(camera), FourDot(1.0, 90.0), FOCUS)).any()


def test_a_saturated_scene_stays_at_full_scale(camera: Camera) -> None:
    image = render(one_plane(cropped(camera), White(), FOCUS))
    response = SensorResponse()
    numbers = digitise(image, 1e9, response, noise_key("saturated"))
    scale = response.quantisation
    expected = min(
        scale.full_scale, round(scale.offset_dn + scale.dn_per_electron * response.saturation_e)
    )
    assert np.all(
        np.abs(numbers[image > 0.01].astype(float) - expected) < 20
    )  # noise of reading is added to a full well


def test_a_microlens_far_off_the_axis(camera: Camera, typical_difference: Difference) -> None:
    away = 1e6 * 0.4  # a million pitches; the target stands where that microlens looks
    array = replace(camera.array, count=(3, 3), offset=(away, 0.0))
    far = replace(
        camera,
        array=array,
        sensor=replace(camera.sensor, resolution=(150, 40), offset=(away * 61.15 / 60, 0.0)),
    )
    assert (
        typical_difference(one_plane(far, Edge(), FOCUS, (-away / 60 * FOCUS, 0.0)), 4) < TOLERANCE
    )


def test_a_dot_on_a_views_edge(camera: Camera, typical_difference: Difference) -> None:
    one = replace(
        camera,
        array=replace(camera.array, count=(1, 1)),
        sensor=replace(camera.sensor, resolution=(220, 30)),
    )
    edge = 318.5e-3 / 2 / 0.0278179  # the dot's centre is imaged on the rim of the total field
    scene = one_plane(one, FourDot(1.0, 1.0), FOCUS, (edge + 0.5, 0.0))
    assert typical_difference(scene, 8) < TOLERANCE


@pytest.mark.parametrize(
    "target",
    [Bars((1.0, 1.0)), FourDot(1.0, 3.0), pytest.param(Edge(), marks=SLOWER)],
    ids=lambda target: target.kind,
)
def test_hopeless_defocus(camera: Camera, typical_difference: Difference, target: Target) -> None:
    assert (
        typical_difference(one_plane(cropped(camera, 60, 30), target, 150.0), 2) < TOLERANCE
    )  # blurred over 300 pixels


@pytest.mark.parametrize("tolerance", [0.0, -1.0, math.nan, 1e-17, math.inf])
def test_a_tolerance_that_no_picture_can_keep_is_refused(camera: Camera, tolerance: float) -> None:
    with pytest.raises(InputError, match="tolerance"):
        render(one_plane(camera, White(), FOCUS), tolerance=tolerance)
