"""The lattice measured in a picture of dots or of bars alone, against the camera the picture was
formed with.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flflab.errors import MeasurementError
from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.lattice.nominal import nominal_lattice
from flflab.measurement.measure import measure
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.without_white.bars import lattice_from_bars
from flflab.measurement.without_white.dots import lattice_from_dots
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.targets import Bars, FourDot, Target

NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
FOCUS, PIXEL = 506.7016, 0.00166
DOTS = FourDot(diameter=1.0, spacing=5.0)


def camera(layout: Any, roll: float, f_number: float) -> Camera:
    array = MicrolensArray(layout, (25, 25), (0.4, 0.4), 0.336, (0.917,), 60.0, roll=roll)
    return Camera(
        MainLens(50.0, f_number), array, Sensor((1300, 1200), PIXEL, 61.15), "round", Useful(0.5)
    )


@pytest.mark.ci
@pytest.mark.parametrize(
    ("measure", "target", "layout", "roll", "f_number", "falloff"),
    [
        (lattice_from_dots, DOTS, "square", 0.0, 4.0, Falloff()),
        pytest.param(lattice_from_dots, DOTS, "square", 0.0, 4.0, None, marks=pytest.mark.ci),
        pytest.param(lattice_from_dots, DOTS, "hexagonal", 0.05, 4.0, None, marks=pytest.mark.full),
        (lattice_from_bars, Bars(), "square", 0.0, 4.0, None),
        pytest.param(
            lattice_from_bars, Bars(), "square", 0.0, 4.0, Falloff(), marks=pytest.mark.ci
        ),
        pytest.param(
            lattice_from_bars, Bars(), "hexagonal", 0.05, 4.0, None, marks=pytest.mark.full
        ),
        pytest.param(
            lattice_from_bars, Bars(), "square", -0.03, 2.8, None, marks=pytest.mark.full
        ),  # neighbours just overlap
    ],
)
def test_what_is_white_in_them_shows_the_lattice_where_no_white_picture_was_taken(
    brute: Any,
    measure: Any,
    target: Target,
    layout: str,
    roll: float,
    f_number: float,
    falloff: Falloff | None,
) -> None:
    true = camera(layout, roll, f_number)
    scene = replace(one_plane(true, target, FOCUS, (0.3, -0.2)), falloff=falloff)
    picture = brute.expose(
        render(scene, tolerance=2e-4), NOISE, 3000, np.random.default_rng(8)
    )  # 0.002 moves a radius by 0.01 px
    nominal = nominal_lattice(true, 3000.0)
    off = np.array([2.0, -1.5])
    found = measure(
        picture,
        replace(
            nominal,
            origin_px=nominal.origin_px + off,
            centres_px=nominal.centres_px + off,
            vectors_px=nominal.vectors_px * 1.001,
        ),
        true,
        target,
        FOCUS,
        NOISE,
    )
    apart = np.hypot(
        *(found.centres_px[:, None] - nominal.centres_px[None]).transpose(2, 0, 1)
    ).min(axis=1)
    reach = np.hypot(*found.indices.T).max()
    assert apart.max() < 4 * math.hypot(
        reach * found.pitch_uncertainty_px, found.origin_uncertainty_px.max()
    )
    assert found.pitch_uncertainty_px < 0.02
    assert np.all(np.abs(found.origin_px - nominal.origin_px) < 4 * found.origin_uncertainty_px)
    assert found.origin_uncertainty_px.max() < 0.02
    assert abs(found.pitch_px - nominal.pitch_px) < 4 * found.pitch_uncertainty_px
    assert abs(found.inside_radius_px - nominal.inside_radius_px) < 4 * found.inside_uncertainty_px
    assert (
        abs(found.outside_radius_px - nominal.outside_radius_px) < 4 * found.outside_uncertainty_px
    )


@pytest.fixture(scope="module")
def four_dots_in_a_whole_frame(brute: Any) -> Any:
    """They cover a few ten thousandths of it."""
    scene = replace(one_plane(brute.camera(4.0, (3664, 2748)), DOTS, FOCUS), falloff=Falloff())
    return np.maximum(render(scene, tolerance=5e-4), 0.0)


@pytest.mark.ci
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.full) for seed in range(2, 4))]
)
def test_four_dots_stand_where_they_are_without_a_white_picture_though_they_cover_next_to_nothing(
    brute: Any, four_dots_in_a_whole_frame: Any, seed: int
) -> None:
    whole, noise = brute.camera(4.0, (3664, 2748)), replace(NOISE, offset_dn=0.0)
    picture = brute.expose(four_dots_in_a_whole_frame, noise, 2600, np.random.default_rng(seed))
    said = measure(picture, whole, DOTS, FOCUS)
    lattice = said["lattice"]
    assert (
        abs(lattice["pitch_px"] - nominal_lattice(whole, 1.0).pitch_px)
        < 3 * lattice["uncertainty"]["pitch_px"]
    )
    for dot, (x, y) in zip(said["dots"], DOTS.centres, strict=True):
        off = np.array(dot["position_mm"]) - [x, y, -FOCUS]
        assert np.all(np.abs(off) < 3 * np.array(dot["uncertainty_mm"]))
        assert dot["uncertainty_mm"][2] < 0.5


@pytest.mark.ci
@pytest.mark.parametrize("f_number", [2.8, 4.0, 5.6])
def test_a_few_small_dots_in_a_whole_frame_do_not_lead_the_fit_of_fall_off_astray(
    brute: Any, f_number: float
) -> None:
    whole = brute.camera(f_number, (3664, 2748))
    dots = FourDot(diameter=1.0, spacing=8.0)
    picture = brute.expose(
        np.maximum(render(one_plane(whole, dots, FOCUS)), 0.0),
        NOISE,
        2600,
        np.random.default_rng(0),
    )
    nominal = nominal_lattice(whole, 2600.0)
    found = lattice_from_dots(picture, nominal, whole, dots, FOCUS, NOISE)
    assert np.all(np.abs(found.origin_px - nominal.origin_px) < 4 * found.origin_uncertainty_px)
    assert abs(found.pitch_px - nominal.pitch_px) < 4 * found.pitch_uncertainty_px
    assert abs(found.inside_radius_px - nominal.inside_radius_px) < 4 * found.inside_uncertainty_px
    assert (
        abs(found.outside_radius_px - nominal.outside_radius_px) < 4 * found.outside_uncertainty_px
    )


@pytest.mark.ci
def test_bars_too_narrow_to_be_white_anywhere_are_refused(brute: Any) -> None:
    true, target = camera("square", 0.0, 4.0), Bars(cycles_per_mm=(6.0, 10.0))
    picture = brute.expose(
        render(one_plane(true, target, FOCUS), tolerance=1e-3),
        NOISE,
        3000,
        np.random.default_rng(9),
    )
    with pytest.raises(MeasurementError, match="middle of white bars"):
        lattice_from_bars(picture, nominal_lattice(true, 3000.0), true, target, FOCUS, NOISE)
