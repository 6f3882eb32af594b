"""Where the usual formulas divide by zero or cancel, the model's limits are finite and right."""

from collections.abc import Callable
from dataclasses import replace

import mpmath
import numpy as np
import pytest

from flflab.errors import InputError
from flflab.optics.camera import Camera, microlens_centres
from flflab.optics.contrast import contrast_paper, dimming_disc_transfer, disc_transfer
from flflab.optics.focus import blur, depth_of_field, image_distance, virtual_depth
from flflab.optics.illumination import illumination_radius
from flflab.optics.resolution import central_smms
from flflab.optics.solution import array_arrangement, solve_camera
from flflab.optics.useful import row_fields, sensor_fields
from flflab.optics.views import row_views, sensor_views


@pytest.fixture(autouse=True)
def floating_point_errors_raise() -> object:
    with np.errstate(all="raise", under="ignore"):
        yield


def blur_in_50_digits(camera: Camera, distance: float) -> float:
    with mpmath.workdps(50):
        focal, length, gap, small = (
            mpmath.mpf(x)
            for x in (
                camera.main_lens.focal_length,
                camera.array.distance,
                camera.gap,
                camera.array.focal_lengths[0],
            )
        )
        half_lens, half_small = (
            mpmath.mpf(camera.main_lens.aperture) / 2,
            mpmath.mpf(camera.array.aperture) / 2,
        )

        def land(m: mpmath.mpf) -> tuple[mpmath.mpf, mpmath.mpf]:
            slope = m / mpmath.mpf(distance) - m / focal
            q = m + slope * length
            return q, q + (slope - q / small) * gap

        q, s = land(half_lens)
        return float(2 * abs(s) * min(1, half_small / abs(q) if q else 1))


@pytest.mark.parametrize("gap", [0.917, 0.917 / (1 - 0.917 / 60), 1.15, 0.775, 1e-6])
@pytest.mark.parametrize("distance", [300.0, 299.999999999, 506.7016, 49.0, 1e12])
def test_blur_is_exact_with_the_image_on_the_array_and_the_sensor_in_the_pupil(
    gap: float, distance: float, laboratory: Callable[..., Camera]
) -> None:
    camera = laboratory(gap=gap)
    expected = blur_in_50_digits(camera, distance)
    # 8 units of roundoff of every term that enters x, times what the aperture makes of them.
    smms = central_smms(camera)
    terms = camera.array.distance / distance + camera.array.distance / 50.0 + 1
    slack = (
        8
        * np.finfo(float).eps
        * camera.main_lens.aperture
        * (abs(float(smms.kappa)) * terms + 3 * camera.gap / 0.917)
    )
    assert float(blur(central_smms(camera), 1 / distance)) == pytest.approx(
        expected, rel=1e-11, abs=slack
    )


def test_the_sensor_in_the_exit_pupil_has_no_penumbra(laboratory: Callable[..., Camera]) -> None:
    camera = laboratory(gap=60 * 0.917 / (60 - 0.917))
    solution = solve_camera(camera)
    smms = central_smms(camera)
    assert solution.in_exit_pupil
    assert float(smms.inside_radius) == pytest.approx(float(smms.outside_radius), rel=1e-9)
    assert np.isfinite(
        [edge for lens in solution.row.useful for edge in lens if not np.isnan(edge)]
    ).all()


def test_a_target_at_infinity_and_one_in_the_front_focus_are_ordinary(
    laboratory: Callable[..., Camera],
) -> None:
    camera = laboratory()
    row, fields = row_fields(camera), sensor_fields(camera)
    assert row_views(row, 0.0, 0.0).total >= 1
    assert sensor_views(fields, 0.0, np.zeros(2)).chief >= 1
    assert np.isinf(image_distance(central_smms(camera), 1 / 50.0))
    assert np.isfinite(virtual_depth(central_smms(camera), 0.0))


def test_an_image_on_the_array_is_seen_by_one_microlens(laboratory: Callable[..., Camera]) -> None:
    camera = laboratory()
    assert row_views(row_fields(camera), 1 / 300.0, 0.0).total == 1
    assert sensor_views(sensor_fields(camera), 1 / 300.0, np.zeros(2)).total == 1


def test_an_afocal_array_is_called_afocal(laboratory: Callable[..., Camera]) -> None:
    camera = laboratory()
    afocal = replace(camera, array=replace(camera.array, focal_lengths=(camera.gap,)))
    assert array_arrangement(afocal) == "afocal"
    assert solve_camera(afocal).depth_of_field is not None


@pytest.mark.parametrize("f_number", [1.0, 4.0, 22.0])
@pytest.mark.parametrize("gap", [1.15, 0.775, 0.93, 0.9312])
def test_the_ends_of_the_depth_of_field_have_the_permitted_blur(
    f_number: float, gap: float, laboratory: Callable[..., Camera]
) -> None:
    camera = laboratory(f_number, gap=gap)
    smms = central_smms(camera)
    circle = camera.sensor.pixel
    intervals = depth_of_field(smms, circle)
    for low, high in intervals:
        inside = (low + min(high, low + 1)) / 2
        assert float(blur(smms, inside)) <= circle * (1 + 1e-9)
        for end in (low, high):
            if 0 < end < np.inf:
                assert float(blur(smms, end)) == pytest.approx(circle, rel=1e-8)
    grid = np.linspace(1e-5, 0.02, 20001)
    inside = np.zeros(grid.shape, dtype=bool)
    for low, high in intervals:
        inside |= (grid >= low) & (grid <= high)
    sharp = np.array([float(blur(smms, vergence)) <= circle for vergence in grid])
    assert np.count_nonzero(sharp != inside) <= 2


def test_the_illumination_radius_lies_between_inside_and_outside(
    laboratory: Callable[..., Camera],
) -> None:
    smms = sensor_fields(laboratory(4.0)).smms
    radius = illumination_radius(smms, 0.5)
    assert np.all((radius > smms.inside_radius) & (radius < smms.outside_radius))


def test_the_paper_s_contrast_is_one_up_to_half_a_cycle_and_zero_at_whole_cycles() -> None:
    u = np.array([0.0, 0.1, 0.5, 0.75, 1.0, 1.25, 2.0])
    assert contrast_paper(u) == pytest.approx([1, 1, 1, 1 / 3, 0, 0.2, 0])


def test_the_paper_s_contrast_is_that_of_all_phases_of_resized_bars() -> None:
    for u in (0.3, 0.55, 0.8, 0.95, 1.2, 1.45):
        phases = np.linspace(0, 1, 2001)

        # Mean of a 50 % square wave over a pixel of u cycles, by the antiderivative of the wave.
        def bright(t: np.ndarray) -> np.ndarray:
            return np.floor(t) * 0.5 + np.minimum(t - np.floor(t), 0.5)

        values = (bright(phases + u) - bright(phases)) / u
        expected = (values.max() - values.min()) / (values.max() + values.min())
        assert float(contrast_paper(np.array([u]))[0]) == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("z", [0.0, 1e-9, 1e-5, 0.99e-4, 1.01e-4, 0.5, 3.8, 40.0])
def test_the_disc_s_transfer_keeps_its_digits_near_zero(z: float) -> None:
    with mpmath.workdps(50):
        expected = float(2 * mpmath.besselj(1, z) / z) if z else 1.0
    assert float(disc_transfer(z / np.pi, np.array(1.0))) == pytest.approx(
        expected, abs=1e-15, rel=1e-13
    )


@pytest.mark.parametrize("z", [0.0, 1e-9, 1e-4, 0.5, 3.8, 24.9, 25.1, 60.0])
@pytest.mark.parametrize("loss", [0.0417, 1.0])
def test_a_disc_that_dims_towards_its_rim_has_the_transfer_of_its_light(
    z: float, loss: float
) -> None:
    """The mean of J0(z r) over the disc, weighted by 1 - loss r^2: by quadrature, of 50 digits."""
    with mpmath.workdps(50):
        parts = mpmath.linspace(0, 1, 12)
        light = mpmath.mpf(mpmath.quad(lambda r: r * (1 - loss * r * r), parts))
        seen = mpmath.mpf(
            mpmath.quad(lambda r: r * (1 - loss * r * r) * mpmath.besselj(0, z * r), parts)
        )
        expected = float(seen / light)
    assert float(dimming_disc_transfer(z / np.pi, np.array(1.0), loss)) == pytest.approx(
        expected, abs=2e-15
    )


def test_mirrored_points_are_seen_as_often(laboratory: Callable[..., Camera]) -> None:
    fields = sensor_fields(laboratory(2.8))
    for point in np.random.Generator(np.random.Philox(key=3)).uniform(-6, 6, (20, 2)):
        assert sensor_views(fields, 1 / 480, point / 480) == sensor_views(
            fields, 1 / 480, -point / 480
        )


def test_microlenses_of_an_odd_array_lie_symmetrically_about_the_axis(
    laboratory: Callable[..., Camera],
) -> None:
    centres = microlens_centres(laboratory().array)
    assert centres.sum(axis=0) == pytest.approx([0, 0], abs=1e-9)
    assert centres[0] == pytest.approx([-4.8, -4.8])


@pytest.mark.parametrize(
    ("field", "value"),
    [("focal_length", float("nan")), ("f_number", -1.0), ("f_number", float("inf"))],
)
def test_an_impossible_lens_is_refused_by_name(
    field: str, value: float, laboratory: Callable[..., Camera]
) -> None:
    camera = laboratory()
    with pytest.raises(InputError, match=f"main_lens.{field}"):
        replace(camera, main_lens=replace(camera.main_lens, **{field: value}))
