"""Alignment's estimators against rays drawn with a ruler: a straight line through a microlens, one
thin lens, no code of the package.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.alignment import attitude_of, find_crossing, nominal_slopes
from flflab.errors import MeasurementError
from flflab.measurement.lattice.disc_light import cone_of, light_across
from flflab.measurement.lattice.find import pitch_and_angle
from flflab.measurement.lattice.nominal import nominal_lattice
from flflab.measurement.lattice.straight import TILT, Images, Straight, straight_lattice
from flflab.measurement.lattice.tilting import axis_of, discs_at
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]
F, A, L, B, f, D, P, PIXEL = 50.0, 12.5, 60.0, 1.15, 0.917, 0.336, 0.4, 0.0166
CAMERA = Camera(
    MainLens(F, F / A),
    MicrolensArray("square", (25, 25), (P, P), D, (f,), L),
    Sensor((366, 275), PIXEL, L + B),
)


def drawn(y: Array, rise: Array) -> tuple[Array, Array, Array]:
    """Where the micro-images of microlenses at ``y`` lie, and the radii of both shadows: rays
    through three pairs of points, mm.
    """
    away, gap = L + rise, B - rise

    def land(m: Array | float, q: Array) -> Array:
        slope_before = (q - m) / away
        return q + gap * (slope_before - (q - y) / f)

    return (
        land(0.0, y),
        np.abs(land(A / 2, y) - land(0.0, y)),
        np.abs(land(0.0, y + D / 2) - land(0.0, y)),
    )


def images(roll: float, yaw: float, pitch: float, border: int = 0) -> Images:
    """Exact centres and radii behind a turned array; those on the sensor and more."""
    j, i = (part.ravel() for part in np.mgrid[-5 - border : 6 + border, -7 - border : 8 + border])
    cos, sin = math.cos(roll), math.sin(roll)
    x, y = P * (cos * i - sin * j), P * (sin * i + cos * j)
    rise = math.tan(yaw) * x + math.tan(pitch) * y
    (cx, lens, microlens), (cy, _, _) = drawn(x, rise), drawn(y, rise)
    centres = np.stack([cx, cy], axis=1) / PIXEL + [182.5, 137.0]
    radii = np.stack([lens, microlens], axis=1) / PIXEL
    indices, kind = np.stack([i, j], axis=1).astype(np.int64), np.zeros(len(i), dtype=np.int64)
    covariance = np.broadcast_to(np.eye(4) * 1e-4**2, (len(i), 4, 4)).copy()
    return Images(indices, centres, radii, covariance, kind)


def fitted(seen: Images) -> Straight:
    """What explains them."""
    return straight_lattice(seen, [central_smms(CAMERA)], axis_of(CAMERA), PIXEL)


@pytest.mark.parametrize(
    "degrees", [(3.0, 1.0, -1.0), (-1.0, 0.1, 0.0), (0.0, 0.0, 0.3), (0.0, 0.0, 0.0)]
)
def test_roll_and_tilt_come_back_from_drawn_rays(degrees: tuple[float, float, float]) -> None:
    roll, yaw, pitch = np.radians(degrees)
    found = fitted(images(roll, yaw, pitch))
    np.testing.assert_allclose(found.values[TILT], np.tan([yaw, pitch]), atol=1e-6)
    assert pitch_and_angle("square", found.vectors)[1] == pytest.approx(roll, abs=1e-6)


def test_uncertainties_of_a_noisy_attitude_cover_the_truth() -> None:
    exact = images(0.01, 0.003, -0.002)
    rng, scores = np.random.default_rng(1), list[Array]()
    for _ in range(60):
        noise = rng.normal(0, 0.01, (len(exact.indices), 4))
        centres, radii = exact.centres_px + noise[:, :2], exact.radii_px + noise[:, 2:]
        covariance = np.broadcast_to(np.eye(4) * 1e-4, (len(noise), 4, 4)).copy()
        found = fitted(replace(exact, centres_px=centres, radii_px=radii, covariance_px=covariance))
        error = found.values[TILT] - np.tan([0.003, -0.002])
        scores.append(error / np.sqrt(np.diag(found.covariance)[TILT]))
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all((rms > 0.75) & (rms < 1.25)), rms


def test_micro_images_that_scatter_more_than_their_noise_tell_the_tilt_less_surely() -> None:
    exact, rng = images(0.0, 0.002, 0.0), np.random.default_rng(2)
    moved = rng.normal(0.0, [0.1, 0.1, 0.05, 0.05], (len(exact.indices), 4))
    shaken = replace(
        exact, centres_px=exact.centres_px + moved[:, :2], radii_px=exact.radii_px + moved[:, 2:]
    )
    found = fitted(shaken)
    spread = np.sqrt(np.diag(found.covariance)[TILT])
    assert np.all(np.abs(found.values[TILT] - [0.002, 0.0]) < 4 * spread)
    assert spread[0] > 20 * np.sqrt(np.diag(fitted(exact).covariance)[TILT][0])


def test_micro_images_that_do_not_tell_the_tilt_are_refused() -> None:
    lattice = replace(nominal_lattice(CAMERA, 1.0), tilt_uncertainty=np.array([0.05, 1e-4]))
    with pytest.raises(MeasurementError, match="do not determine the array's tilt"):
        attitude_of(lattice)


def tilted_white(brute: Any, yaw: float, pitch: float) -> tuple[Array, Images]:
    """A white picture behind a tilted array, micro-image by micro-image by the overlap of its own
    drawn shadows, and these.
    """
    drawn_there = images(0.0, yaw, pitch, border=1)
    picture = np.zeros(CAMERA.sensor.resolution[::-1])
    for centre, (lens, microlens) in zip(drawn_there.centres_px, drawn_there.radii_px, strict=True):
        picture += brute.micro_image(picture.shape, centre, lens, microlens)
    return picture, drawn_there


@pytest.mark.parametrize("degrees", [(0.2, -0.1), (1.0, 0.5), (-0.02, 0.0)])
def test_the_lattice_of_a_tilted_array_has_every_centre_and_radius_where_rays_draw_it(
    brute: Any, degrees: tuple[float, float]
) -> None:
    yaw, pitch = np.radians(degrees)
    picture, true = tilted_white(brute, yaw, pitch)
    lattice = lattice_behind(CAMERA, 64 + 3000 * picture, SensorNoise(0.3, 1.0, 64.0, 4095.0))
    place = np.argmin(
        np.hypot(*(true.centres_px[:, None] - lattice.centres_px).transpose(2, 0, 1)), axis=0
    )
    assert len(place) >= 165
    np.testing.assert_allclose(lattice.centres_px, true.centres_px[place], atol=5e-3)
    radii = np.array([[1, 1], [1, -1]]) @ [lattice.outside_radius_px, lattice.inside_radius_px] / 2
    discs = discs_at(central_smms(CAMERA), PIXEL, radii, lattice.rises)
    np.testing.assert_allclose(discs, true.radii_px[place], atol=0.03)
    np.testing.assert_allclose(lattice.tilt, np.tan([yaw, pitch]), rtol=0.01, atol=2e-5)
    middle = true.radii_px[len(true.radii_px) // 2]  # on the axis: a tilt changes nothing there
    assert [lattice.outside_radius_px, lattice.inside_radius_px] == pytest.approx(
        [middle[0] + middle[1], middle[0] - middle[1]], abs=0.03
    )


@pytest.mark.full
def test_uncertainties_of_the_lattices_tilt_cover_the_truth(brute: Any) -> None:
    picture, _ = tilted_white(brute, 0.002, -0.001)
    noise, rng, scores = (
        SensorNoise(0.3, 1.0, 64.0, 4095.0),
        np.random.default_rng(6),
        list[Array](),
    )
    for _ in range(12):
        lattice = lattice_behind(CAMERA, brute.expose(picture, noise, 3000, rng), noise)
        scores.append((lattice.tilt - np.tan([0.002, -0.001])) / lattice.tilt_uncertainty)
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.4  # 24 scores: 1 +- 0.14


def slanted_white(gap: float, shape: tuple[int, int], pixel: float) -> Array:
    """A white picture by rays to 6 x 6 points of every pixel from 60 of its microlens, each
    bringing cos^4 of its slope; all light is 1.
    """
    x, y = (
        ((np.arange(6 * count) + 0.5) / 6 - 0.5 - (count - 1) / 2) * pixel for count in shape[::-1]
    )
    x, y = np.meshgrid(x, y)
    centre_x, centre_y = (P * np.rint(at / (1 + gap / L) / P) for at in (x, y))
    number = np.arange(60) + 0.5
    light = np.zeros_like(x)
    for radius, turn in zip(
        D / 2 * np.sqrt(number / 60), number * math.pi * (3 - math.sqrt(5)), strict=True
    ):
        to_x, to_y = (
            radius * math.cos(turn),
            radius * math.sin(turn),
        )  # on the microlens, from its centre
        after_x, after_y = (x - centre_x - to_x) / gap, (y - centre_y - to_y) / gap
        from_x, from_y = (
            centre_x + to_x - L * (after_x + to_x / f),
            centre_y + to_y - L * (after_y + to_y / f),
        )
        light += (from_x**2 + from_y**2 < A**2 / 4) / (1 + after_x**2 + after_y**2) ** 2
    return (light / 60).reshape(shape[0], 6, shape[1], 6).mean((1, 3))


@pytest.mark.ci
@pytest.mark.parametrize("shadow_px", [1.0, 4.0])
def test_beside_the_exit_pupil_the_fall_off_of_slanted_light_does_not_look_like_another_radius(
    shadow_px: float,
) -> None:
    pixel, pupil = 0.008, 1 / (1 / f - 1 / L)
    gap = pupil + 2 * shadow_px * pixel / D / (1 / f - 1 / L)
    camera = replace(CAMERA, sensor=Sensor((240, 180), pixel, L + gap))
    picture = 64 + 3000 * slanted_white(gap, (180, 240), pixel)
    lattice = lattice_behind(camera, picture, SensorNoise(0.3, 1.0, 64.0, 4095.0))
    lens = A * gap / L / 2 / pixel
    assert lattice.outside_radius_px == pytest.approx(lens + shadow_px, abs=0.02)
    assert lattice.inside_radius_px == pytest.approx(lens - shadow_px, abs=0.02)


def test_the_cone_of_rays_is_in_the_exit_pupil_what_it_is_beside_it() -> None:
    pupil = 1 / (1 / f - 1 / L)
    at, before, behind = (
        cone_of(replace(CAMERA, sensor=replace(CAMERA.sensor, distance=L + pupil + aside)))
        for aside in (0.0, -1e-9, 1e-9)
    )
    assert at.by_place == pytest.approx(PIXEL / pupil)
    assert [abs(cone.rim) for cone in (at, before, behind)] == pytest.approx([D / 2 / pupil] * 3)
    assert before.rim == pytest.approx(
        -behind.rim
    )  # the disc is turned over, and no wider than a point
    tables = [light_across(10.0, 1e-3, cone) for cone in (at, before, behind)]
    inside = int(
        9 / tables[0][0]
    )  # nearer to the rim of 10 px it matters which half of the disc is there
    for _, table in tables:
        np.testing.assert_allclose(table[:inside], tables[0][1][:inside], atol=1e-4)
        assert np.isfinite(table).all()


def test_the_exit_pupil_is_found_from_sizes_alone() -> None:
    slope = nominal_slopes(CAMERA)[0]
    pupil = L + 1 / (1 / f - 1 / L)
    places = np.array([61.15, pupil + 0.09, pupil - 0.09])
    values = np.abs(1.02 * slope * (places - pupil)) * [
        -1,
        1,
        1,
    ]  # the slope is 2 % off; of the first the sign is known
    found = find_crossing(places, values, np.full(3, 1e-4), slope, signed=False)
    assert found.place == pytest.approx(pupil, abs=1e-6)
    assert found.slope == pytest.approx(1.02 * slope, rel=1e-3)


def test_one_place_is_extrapolated_with_the_uncertainty_of_the_slope() -> None:
    found = find_crossing(np.array([61.0]), np.array([0.02]), np.array([1e-5]), 0.2)
    assert [found.place, found.uncertainty, found.slope] == pytest.approx(
        [60.9, 0.01, 0.2], rel=1e-2
    )
