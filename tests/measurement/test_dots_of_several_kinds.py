"""Dots seen by microlenses of several kinds, before another focus, and blurred over more than any
bright field, as in a Raytrix R12: every spot is cut, and some micro-images show two of them.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import MeasurementError
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.dots.views import count_views
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.measure import measure
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.targets import FourDot, White

Array = npt.NDArray[np.float64]

NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
SIMILAR = (
    Camera(
        MainLens(65.647, 5.3833),
        MicrolensArray(
            "hexagonal", (13, 15), (0.18267, 0.18267), 0.16061, (0.6854, 0.6952, 0.6726), 80.7888,
            ((0, 1, 2), (2, 0, 1)), tilt=(-0.0007, 0.0005),
        ),
        Sensor((400, 441), 0.00305, 81.6073), useful=Useful(0.5),
    ),
    FourDot(0.9, 3.1646), 455.4,
)  # fmt: skip
UNLIKE = (
    Camera(
        MainLens(40.217, 4.712),
        MicrolensArray(
            "hexagonal", (11, 13), (0.14301, 0.14301), 0.12706, (0.58792, 0.60023, 0.58003),
            39.1764, ((0, 1, 2), (2, 0, 1)), tilt=(0.00035, 0.00277),
        ),
        Sensor((413, 328), 0.002614, 39.6335),
    ),
    FourDot(2.3228, 7.2889), 1428.34,
)  # fmt: skip
GALILEAN = Camera(
    MainLens(49.885, 4.0),
    MicrolensArray("hexagonal", (30, 30), (0.12744, 0.12744), 0.12744, (0.56057,), 56.866),
    Sensor((420, 420), 0.0055, 57.1971),
)
KINDS = replace(
    GALILEAN,
    array=replace(
        GALILEAN.array, focal_lengths=(0.58267, 0.52402, 0.56057), pattern=((0, 1, 2), (1, 2, 0)),
        tilt=(0.0003, -0.0004),
    ),
)  # fmt: skip
WIDE = replace(SIMILAR[0], main_lens=MainLens(65.647, 3.2))  # whose micro-images overlap
SLOW = pytest.mark.ci


@pytest.mark.ci
@pytest.mark.parametrize(
    ("camera", "target", "distance", "most_mm"),
    [
        pytest.param(*SIMILAR, 1.0, marks=SLOW),
        (*UNLIKE, 5.0),
        (GALILEAN, FourDot(6.0, 20.0), 900.0, 2.0),
        pytest.param(GALILEAN, FourDot(6.0, 20.0), 600.0, 1.2, marks=SLOW),
        pytest.param(GALILEAN, FourDot(10.0, 30.0), 900.0, 3.0, marks=pytest.mark.full),
        pytest.param(KINDS, FourDot(6.0, 20.0), 900.0, 4.0, marks=SLOW),
    ],
)
def test_every_kind_puts_the_dots_where_they_are(
    brute: Any, camera: Camera, target: FourDot, distance: float, most_mm: float
) -> None:
    rng = np.random.default_rng(4)
    for off, uncertainty in placed(brute, camera, target, distance, rng):
        assert np.abs(off / uncertainty).max() < 3.5
        assert uncertainty[2] < most_mm


@pytest.mark.full
def test_where_micro_images_overlap_by_half_depth_is_within_twice_what_is_stated(
    brute: Any,
) -> None:
    """Neighbours' centres then depart alike, which uncertainties do not count."""
    rng, target = np.random.default_rng(4), FourDot(0.9, 3.1646)
    scores = [
        off[2] / uncertainty[2]
        for _ in range(6)
        for off, uncertainty in placed(brute, WIDE, target, 455.4, rng)
    ]
    assert np.sqrt(np.mean(np.square(scores))) < 2


def placed(
    brute: Any, camera: Camera, target: FourDot, distance: float, rng: np.random.Generator
) -> list[tuple[Array, Array]]:
    """How far each dot of new pictures is from where it stands, and what is stated, mm."""
    offset = (0.5, -0.3)
    white, dots = (
        brute.expose(
            np.maximum(render(one_plane(camera, one, distance, offset), tolerance=5e-4), 0.0),
            NOISE, 3000, rng,
        )
        for one in (White(), target)
    )  # fmt: skip
    lattice = lattice_behind(camera, white, NOISE)
    return [
        (
            dot.position_mm - np.append(target.centres[dot.dot] + offset, -distance),
            dot.uncertainty_mm,
        )
        for dot in count_views(dots, lattice, camera, target, distance, NOISE)
    ]


@pytest.mark.ci
def test_without_a_white_picture_they_are_refused_since_nothing_shows_how_light_falls_off() -> None:
    target = FourDot(diameter=6.0, spacing=20.0)
    picture = 64 + 3000 * render(one_plane(GALILEAN, target, 900.0), tolerance=1e-3)
    with pytest.raises(MeasurementError, match="name a picture of a white target"):
        measure(picture, GALILEAN, target, 900.0, NOISE)


@pytest.mark.ci
def test_dots_blurred_into_one_another_are_refused() -> None:
    target = FourDot(diameter=6.0, spacing=12.0)
    white, dots = (
        64 + 3000 * render(one_plane(GALILEAN, one, 900.0), tolerance=1e-3)
        for one in (White(), target)
    )
    lattice = lattice_behind(GALILEAN, white, NOISE)
    with pytest.raises(MeasurementError, match=r"10\.\d px apart and, with 11\.4 px of blur"):
        count_views(dots, lattice, GALILEAN, target, 900.0, NOISE)


def test_what_stands_for_saturated_in_single_precision_is_saturated() -> None:
    """Rounded down, all that was no dot passed for plain white."""
    for full in (4095.0, 8000.000000000001, 65535 / 8):
        noise = replace(NOISE, full_scale_dn=full)
        assert noise.saturated(noise.saturated_dn)
