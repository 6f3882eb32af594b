"""Exact rays through spherical surfaces, against closed forms, 50 digits and another program's
rays.
"""

from typing import Any

import mpmath
import numpy as np
import pytest

from flflab.accuracy.lenses import ACHROMAT, DOUBLE_GAUSS, MAIN_LENSES, PLANO_CONVEX
from flflab.accuracy.thick import Lens, at_plane, first_order, mirrored, scaled, trace
from flflab.errors import InputError

mp: Any = mpmath


def test_every_ray_to_the_aplanatic_point_of_a_sphere_meets_the_axis_in_one_place() -> None:
    radius, index = 10.0, 1.5
    aim, image = radius * (1 + index), radius * (1 + 1 / index)  # behind the vertex
    lens = Lens(
        (1 / radius, 1 / (image - 5)), (5.0,), (index, 1.0)
    )  # the second surface is concentric with the image: it bends nothing
    heights = np.linspace(0.1, 0.7, 13) * radius
    start = np.stack([0.6 * heights, 0.8 * heights, np.zeros_like(heights)], axis=-1)
    direction = np.array([0.0, 0.0, aim]) - start
    met, leaving = trace(lens, start, direction / np.linalg.norm(direction, axis=-1, keepdims=True))
    assert np.abs(at_plane(met[-1], leaving, image)).max() < 1e-13
    assert np.linalg.norm(leaving, axis=-1) == pytest.approx(np.ones(13), abs=1e-15)


def test_a_thick_lens_has_the_lensmakers_focal_length_and_principal_planes() -> None:
    first, second, thickness, index = 40.0, -65.0, 8.0, 1.6
    known = first_order(Lens((1 / first, 1 / second), (thickness,), (index, 1.0)))
    power = (index - 1) * (
        1 / first - 1 / second + (index - 1) * thickness / (index * first * second)
    )
    assert known.focal_length == pytest.approx(1 / power, rel=1e-14)
    assert known.front == pytest.approx(
        -(index - 1) * thickness / (index * second * power), rel=1e-13
    )
    assert known.rear == pytest.approx(
        thickness - (index - 1) * thickness / (index * first * power), rel=1e-13
    )


@pytest.mark.parametrize(
    ("name", "focal_length", "back", "tolerance"),
    [
        ("plano-convex", 25.8 / 0.5168, 25.8 / 0.5168 - 6 / 1.5168, 1e-12),
        ("achromat", 50.0, 43.4, 0.01),
        ("double Gauss", 50.0, None, 0.01),
    ],
)
def test_the_lenses_have_the_focal_lengths_their_makers_state(
    name: str, focal_length: float, back: float | None, tolerance: float
) -> None:
    lens = MAIN_LENSES[name]
    known = first_order(lens)
    assert known.focal_length == pytest.approx(focal_length, rel=tolerance)
    if back is not None:
        assert known.rear + known.focal_length - lens.vertex[-1] == pytest.approx(
            back, rel=tolerance
        )


@pytest.mark.parametrize("lens", MAIN_LENSES.values(), ids=MAIN_LENSES)
def test_rays_near_the_axis_meet_first_order_with_an_error_that_falls_as_the_square_of_their_height(
    lens: Lens,
) -> None:
    known, heights = first_order(lens), np.geomspace(0.01, 1, 9)
    start = np.stack([heights, 0 * heights, 0 * heights - 1], axis=-1)
    met, leaving = trace(lens, start, np.broadcast_to([0.0, 0.0, 1.0], start.shape))
    crossing = met[-1][:, 2] - met[-1][:, 0] * leaving[:, 2] / leaving[:, 0]
    slope = np.polyfit(
        np.log(heights), np.log(np.abs(crossing - known.rear - known.focal_length)), 1
    )[0]
    assert slope == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("lens", [ACHROMAT, DOUBLE_GAUSS], ids=["achromat", "double Gauss"])
def test_a_ray_sent_back_through_the_mirrored_lens_returns_on_its_way(lens: Lens) -> None:
    start, direction = np.array([3.0, -2.0, -5.0]), np.array([0.05, 0.1, 1.0]) / np.sqrt(1.0125)
    met, leaving = trace(lens, start, direction)
    turn, flip = np.array([1.0, 1.0, -1.0]), np.array([0.0, 0.0, lens.vertex[-1]])
    back, home = trace(mirrored(lens), met[-1] * turn + flip, -leaving * turn)
    assert back[::-1] * turn + flip == pytest.approx(met, abs=1e-12)
    assert -home * turn == pytest.approx(direction, abs=1e-13)


def test_skew_rays_through_the_double_gauss_are_those_of_batoid() -> None:
    # batoid 0.9.0, RefractiveInterface with ConstMedium at every surface; (x, y) at z = 70 mm
    start = np.array([[5.0, 3, -10], [-8, 2, -10], [1, -9, -10], [-4, -4, -10]])
    direction = np.array([[0.02, -0.05, 1], [0.1, 0.0, 1], [-0.03, 0.11, 1], [0.2, 0.1, 1]])
    met, leaving = trace(
        DOUBLE_GAUSS, start, direction / np.linalg.norm(direction, axis=1, keepdims=True)
    )
    expected = [
        [0.827902798154, -2.662218949287],
        [5.396118512489, -0.077137204678],
        [-1.564215152562, 5.941560038200],
        [10.297309469732, 5.226253836815],
    ]
    assert at_plane(met[-1], leaving, 70.0) == pytest.approx(np.array(expected), abs=1e-11)


def test_the_rms_spot_of_the_plano_convex_lens_is_that_of_batoid() -> None:
    # batoid 0.9.0, the same 20,000 rays of a beam at F/4, 45 mm behind the last vertex
    number = np.arange(20000) + 0.5
    radius, angle = 6.25 * np.sqrt(number / 20000), number * np.pi * (3 - np.sqrt(5))
    start = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * radius - 1], axis=-1)
    met, leaving = trace(PLANO_CONVEX, start, np.broadcast_to([0.0, 0.0, 1.0], start.shape))
    spot = np.sqrt((at_plane(met[-1], leaving, 51.0) ** 2).sum(axis=1).mean())
    assert spot == pytest.approx(0.040127428171, abs=1e-12)


def test_a_steep_ray_is_refracted_as_sines_of_50_digits_say() -> None:
    height = 12.0
    with mpmath.workdps(50):
        radius, index, thickness = mp.mpf("25.8"), mp.mpf("1.5168"), mp.mpf(6)
        incidence = mp.asin(mp.mpf(height) / radius)
        inside = incidence - mp.asin(mp.sin(incidence) / index)
        sag = radius - mp.sqrt(radius**2 - mp.mpf(height) ** 2)
        at_back = height - (thickness - sag) * mp.tan(inside)
        expected = float(at_back - 30 * mp.tan(mp.asin(index * mp.sin(inside))))
    met, leaving = trace(PLANO_CONVEX, np.array([height, 0.0, -3.0]), np.array([0.0, 0.0, 1.0]))
    assert at_plane(met[-1], leaving, 36.0)[0] == pytest.approx(expected, abs=1e-13)


def test_a_ray_beside_the_lens_and_one_totally_reflected_are_not_numbers() -> None:
    ball = Lens((0.0, 1 / -8.0), (4.0,), (1.8, 1.0))
    start = np.array([[9.0, 0.0, -1.0], [6.0, 0.0, -1.0], [1.0, 0.0, -1.0]])
    _, leaving = trace(ball, start, np.broadcast_to([0.0, 0.0, 1.0], start.shape))
    assert np.isnan(leaving[:, 2]).tolist() == [True, True, False]


def test_a_scaled_lens_has_the_focal_length_asked_for() -> None:
    assert first_order(scaled(DOUBLE_GAUSS, 50.0)).focal_length == pytest.approx(50.0, rel=1e-14)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (((0.1,), (1.0,), (1.0,)), "one gap fewer"),
        (((0.1, 0.0), (1.0,), (1.5, 1.4)), "air, 1, is due"),
        (((0.1, 0.0), (1.0,), (1.5, 1.0), 2), "0 to 1 are there"),
    ],
)
def test_what_is_no_lens_is_refused(arguments: tuple[Any, ...], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Lens(*arguments)


def test_a_lens_without_a_focal_length_is_refused() -> None:
    with pytest.raises(InputError, match="afocal"):
        first_order(Lens((0.0, 0.0), (3.0,), (1.5, 1.0)))
