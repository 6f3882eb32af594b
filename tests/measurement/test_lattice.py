"""The lattice found in white pictures made by brute force."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import MeasurementError
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.lattice.profile import cone_of
from flflab.measurement.lattice.white import find_lattice
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Layout
from flflab.targets import White

Array = npt.NDArray[np.float64]

NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
SHAPE = (360, 480)
ORIGIN = (200.3, 182.9)
# 1 % shot noise is 10,000 electrons: 3000 DN; overlapping micro-images need room for their sum.
CASES = [
    ("square", 90.0, 1.7, 66.1, 8.7, 1000),  # F/1.6 of the worked example, scaled
    ("square", 90.0, -3.0, 54.9, 8.7, 1000),  # first ring of the spectrum vanishes
    ("square", 90.0, 44.0, 37.8, 8.7, 3000),
    ("square", 90.0, 2.0, 26.5, 8.7, 3000),
    ("square", 90.0, 2.0, 6.6, 8.7, 3000),  # the main lens is the narrower stop
    ("hexagonal", 40.0, 5.0, 14.0, 4.0, 3000),
    ("hexagonal", 40.0, -25.0, 26.0, 6.0, 1000),
    ("hexagonal", 12.0, 3.0, 1.6, 0.8, 3000),
    ("square", 10.0, 2.0, 4.6, 1.2, 3000),
]


def distances(found: Array, true: Array) -> Array:
    return np.hypot(*(found[:, None] - true[None]).transpose(2, 0, 1))


@pytest.mark.parametrize(("layout", "pitch", "degrees", "a", "b", "level"), CASES)
def test_every_micro_image_is_found_to_a_hundredth_of_a_pixel_at_one_percent_noise(
    brute: Any,
    layout: Layout,
    pitch: float,
    degrees: float,
    a: float,
    b: float,
    level: float,
) -> None:
    angle = math.radians(degrees)
    image = brute.white_picture(SHAPE, layout, pitch, angle, ORIGIN, a, b)
    picture = brute.expose(image, NOISE, level, np.random.default_rng(7))
    lattice = find_lattice(picture, layout, pitch * 1.04, NOISE)
    true = brute.lattice_points(SHAPE, brute.vectors_of(layout, pitch, angle), ORIGIN, a + b)
    apart = distances(true, lattice.centres_px).min(axis=1)
    # the brute-force points lie within the reach of the sides, the lattice's within that of the
    # corners too
    corner = np.hypot(*(true - np.clip(true, -0.5, [SHAPE[1] - 0.5, SHAPE[0] - 0.5])).T)
    safe = corner < a + b - 0.01
    assert abs(len(lattice.centres_px) - (corner < a + b).sum()) <= 1
    assert np.sqrt(np.mean(apart[safe] ** 2)) < 0.01
    assert abs(lattice.pitch_px / pitch - 1) < 1e-5
    assert abs(lattice.pitch_px - pitch) < 4.5 * lattice.pitch_uncertainty_px
    assert abs(lattice.angle - angle) < 4.5 * lattice.angle_uncertainty
    assert abs(lattice.inside_radius_px - abs(a - b)) < 4.5 * lattice.inside_uncertainty_px + 1e-3
    assert abs(lattice.outside_radius_px - a - b) < 4.5 * lattice.outside_uncertainty_px + 1e-3
    assert lattice.chi2_per_pixel == pytest.approx(1.0, abs=0.03)


def test_without_noise_no_centre_is_off_by_a_thousandth_of_a_pixel_even_in_the_corners(
    brute: Any,
) -> None:
    image = brute.white_picture(SHAPE, "square", 60.0, 0.02, ORIGIN, 19.0, 5.5)
    lattice = find_lattice(image * 3000 + NOISE.offset_dn, "square", 60.0, NOISE)
    true = brute.lattice_points(SHAPE, brute.vectors_of("square", 60.0, 0.02), ORIGIN, 24.5)
    assert distances(lattice.centres_px, true).min(axis=1).max() < 1e-3
    assert lattice.pitch_px == pytest.approx(60.0, rel=1e-6)
    assert lattice.inside_radius_px == pytest.approx(13.5, abs=2e-3)
    assert lattice.outside_radius_px == pytest.approx(24.5, abs=2e-3)


@pytest.mark.ci
def test_micro_images_of_300_pixels_are_found_though_the_description_is_off_by_4_percent(
    brute: Any,
) -> None:
    shape = (1100, 1300)
    image = brute.white_picture(shape, "square", 300.0, 0.02, (520.3, 470.6), 110.0, 25.0)
    lattice = find_lattice(
        brute.expose(image, NOISE, 3000, np.random.default_rng(7)), "square", 312.0, NOISE
    )
    true = brute.lattice_points(
        shape, brute.vectors_of("square", 300.0, 0.02), (520.3, 470.6), 130.0
    )
    assert np.sqrt(np.mean(distances(true, lattice.centres_px).min(axis=1) ** 2)) < 0.005
    assert abs(lattice.pitch_px - 300.0) < 4.5 * lattice.pitch_uncertainty_px
    assert lattice.pitch_uncertainty_px < 0.003


@pytest.mark.full
@pytest.mark.timeout(0)
@pytest.mark.parametrize("f_number", [1.6, 2.8, 4.0, 8.0, 16.0], ids="F/{:g}".format)
def test_a_whole_frame_at_one_percent_noise_gives_the_lattice_to_a_thousandth_of_a_pixel(
    brute: Any, f_number: float
) -> None:
    """3664 x 2748 pixels, fall-off and tilt fitted; errors, of eight frames, against where rays
    through the microlenses' middles land.
    """
    camera = brute.camera(f_number, (3664, 2748))
    image = np.maximum(render(one_plane(camera, White(), 506.7016), tolerance=3e-5), 0.0)
    deep = SensorNoise(0.3, 2.0, 64.0, 16383.0)  # overlapping neighbours add up to more than white
    pitch, middle = (
        0.4 * (1 + camera.gap / camera.array.distance) / camera.sensor.pixel,
        np.array([1831.5, 1373.5]),
    )
    clean, *noisy = (
        find_lattice(picture, "square", 241.0, deep, cone_of(camera))
        for picture in (
            image * 3000 + 64,
            *(brute.expose(image, deep, 3000, np.random.default_rng(seed)) for seed in range(8)),
        )
    )
    bias = np.abs(clean.centres_px - middle - clean.indices * pitch).max()
    centres = np.sqrt(
        np.mean(
            [
                np.mean((one.centres_px - middle - one.indices * pitch) ** 2, axis=0)
                for one in noisy
            ],
            axis=0,
        )
    ).max()
    origin = np.sqrt(np.mean([(one.origin_px - middle) ** 2 for one in noisy]))
    by_pitch = np.sqrt(np.mean([(one.pitch_px / pitch - 1) ** 2 for one in noisy]))
    stated = np.mean([np.max(one.origin_uncertainty_px) for one in noisy])
    print(
        f"F/{f_number:g} bias {bias:.5f}, centres {centres:.5f}, origin {origin:.5f} (stated"
        f" {stated:.5f}), pitch {by_pitch:.1e}"
    )
    assert bias < 0.002
    assert centres < 0.005
    assert origin < 0.001
    assert by_pitch < 1e-6


def test_the_stated_uncertainties_are_the_scatter_over_repeated_noise(brute: Any) -> None:
    angle, pitch, a, b = 0.03, 30.0, 10.0, 3.0
    shape, origin = (150, 180), (93.3, 70.6)
    image = brute.white_picture(shape, "square", pitch, angle, origin, a, b)
    rng = np.random.default_rng(3)
    scores: list[list[float]] = []
    for _ in range(24):
        found = find_lattice(brute.expose(image, NOISE, 3000, rng), "square", pitch, NOISE)
        scores.append(
            [
                (found.pitch_px - pitch) / found.pitch_uncertainty_px,
                (found.angle - angle) / found.angle_uncertainty,
                (found.origin_px[0] - origin[0]) / found.origin_uncertainty_px[0],
                (found.origin_px[1] - origin[1]) / found.origin_uncertainty_px[1],
                (found.inside_radius_px - (a - b)) / found.inside_uncertainty_px,
                (found.outside_radius_px - (a + b)) / found.outside_uncertainty_px,
            ]
        )
    spread = np.sqrt(np.mean(np.square(scores)))
    assert 0.82 < spread < 1.18  # 144 scores: 1 +- 0.06
    assert np.abs(np.mean(scores, axis=0)).max() < 4 / math.sqrt(24)


def test_an_array_smaller_than_the_sensor_gives_only_the_micro_images_it_has(brute: Any) -> None:
    image = brute.white_picture(SHAPE, "square", 40.0, 0.0, ORIGIN, 13.0, 4.0)
    image[:, 340:] = 0  # the columns of centres at 360.3 and beyond are missing
    lattice = find_lattice(
        brute.expose(image, NOISE, 3000, np.random.default_rng(1)), "square", 40.0, NOISE
    )
    on_picture = lattice.centres_px[
        (lattice.centres_px[:, 1] > 0) & (lattice.centres_px[:, 1] < SHAPE[0])
    ]
    assert on_picture[:, 0].max() == pytest.approx(320.3, abs=0.01)
    assert lattice.pitch_px == pytest.approx(40.0, rel=2e-4)


def test_the_origin_is_the_centre_nearest_the_sensors_and_angles_are_nearest_zero(
    brute: Any,
) -> None:
    image = brute.white_picture(SHAPE, "square", 40.0, math.radians(88.0), ORIGIN, 13.0, 4.0)
    lattice = find_lattice(image * 3000 + NOISE.offset_dn, "square", 41.0, NOISE)
    assert math.degrees(lattice.angle) == pytest.approx(-2.0, abs=1e-3)
    middle = np.array([(SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2])
    nearest = np.argmin(np.hypot(*(lattice.centres_px - middle).T))
    assert np.array_equal(lattice.centres_px[nearest], lattice.origin_px)
    assert np.array_equal(lattice.indices[nearest], [0, 0])


@pytest.mark.parametrize(("pitch", "a", "b"), [(40.0, 13.0, 4.0), (60.0, 19.0, 5.5)])
def test_square_micro_images_described_as_hexagonal_are_refused(
    brute: Any, pitch: float, a: float, b: float
) -> None:
    white = brute.expose(
        brute.white_picture(SHAPE, "square", pitch, 0.03, ORIGIN, a, b),
        NOISE,
        3000,
        np.random.default_rng(1),
    )
    with pytest.raises(MeasurementError, match="check layout"):
        find_lattice(white, "hexagonal", pitch, NOISE)


@pytest.mark.parametrize(
    "picture",
    [
        np.full((200, 200), 2000.0),
        np.full((200, 200), 64.0),
        np.full((200, 200), 4095.0),
        np.full((1, 1), 2000.0),
        np.full((200, 200), np.nan),
        np.random.default_rng(5).normal(2000, 30, (200, 200)),
    ],
)
def test_a_picture_without_a_lattice_is_refused_in_one_sentence(picture: Array) -> None:
    with pytest.raises(MeasurementError, match="white picture"):
        find_lattice(picture, "square", 30.0, NOISE)
