"""A second path for what is left: useful pixels, mean views, stereo limits, virtual depth, marginal
angle, contrast, by rays alone.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.optics.camera import Camera
from flflab.optics.contrast import transfer
from flflab.optics.focus import image_distance, magnification, marginal_angle, virtual_depth
from flflab.optics.resolution import central_smms, mean_row_views, stereo
from flflab.optics.solution import solve_camera
from flflab.optics.useful import row_fields

Array = npt.NDArray[np.float64]
Build = Callable[..., Camera]
Trace = Callable[[Camera, float, float, float, Array], tuple[Array, Array, npt.NDArray[np.bool_]]]
CENTRES = 0.4 * (np.arange(25) - 12)


def light_by_rays(camera: Camera, places: Array, rays: int = 1201) -> Array:
    """Share of each microlens's slit through which rays traced back from sensor points pass the
    main lens, shape (25, points).
    """
    length, gap, focal = camera.array.distance, camera.gap, camera.array.focal_lengths[0]
    steps = (np.arange(rays) + 0.5) / rays - 0.5

    def share(centre: float, some: Array) -> Array:
        q = centre + steps[:, None] * camera.array.aperture
        slope = (some - q) / gap + (q - centre) / focal
        return np.asarray(
            np.mean(np.abs(q - slope * length) <= camera.main_lens.aperture / 2, axis=0)
        )

    blocks = np.array_split(places, 1 + len(places) // 64)  # the processor's cache holds one
    return np.array(
        [np.concatenate([share(centre, some) for some in blocks]) for centre in CENTRES.tolist()]
    )


@pytest.mark.parametrize(
    ("f_number", "array", "gap"),
    [(2.0, 60.0, 1.15), (4.0, 60.0, 1.15), (16.0, 60.0, 1.15), (4.0, 55.0, 0.775)],
)
def test_useful_pixels_of_the_row_are_those_that_one_microlens_lights_well_enough(
    f_number: float, array: float, gap: float, laboratory: Build
) -> None:
    camera = laboratory(f_number, array, gap)
    places = (np.arange(3664, dtype=np.float64) - 3663 / 2) * 1.66e-3
    shares = light_by_rays(camera, places)
    brightest = shares.max()
    lit = shares > 0
    home = CENTRES * (1 + gap / array)
    on_sensor = np.abs(home) <= 3664 * 1.66e-3 / 2
    alone = lit.sum(axis=0) == 1
    useful = alone & np.any((shares >= 0.5 * brightest) & lit & on_sensor[:, None], axis=0)
    # Two pixels at each end of a micro-image lie within a ray of the threshold.
    assert solve_camera(camera).useful_pixels[0] == pytest.approx(
        int(useful.sum()), abs=2 * int(on_sensor.sum())
    )


def chief_views_by_rays(camera: Camera, distance: float, height: float, trace: Trace) -> int:
    """Microlenses whose limiting stop's central ray passes and lands in the useful interval; two
    traced rays give all others.
    """
    row, half = row_fields(camera), camera.main_lens.aperture / 2
    seen = 0
    for centre, useful in zip(CENTRES.tolist(), row.useful, strict=True):
        (q0, q1), _, _ = trace(camera, distance, height, centre, np.array([0.0, 1.0]))
        slope = q1 - q0
        limited = camera.array.aperture < camera.main_lens.aperture * abs(slope)
        m = (centre - q0) / slope if limited else 0.0
        _, landed, through = trace(camera, distance, height, centre, np.array([m]))
        passes = abs(m) <= half and (limited or bool(through[0]))
        seen += bool(passes and useful[0] - 1e-12 <= landed[0] <= useful[1] + 1e-12)
    return seen


@pytest.mark.parametrize(
    ("f_number", "array", "gap", "distance"),
    [(2.0, 60.0, 1.15, 506.7), (4.0, 60.0, 1.15, 480.0), (2.8, 55.0, 0.775, 300.0)],
)
def test_the_mean_number_of_views_is_that_of_a_period_of_traced_points(
    f_number: float, array: float, gap: float, distance: float, laboratory: Build, trace: Trace
) -> None:
    camera = laboratory(f_number, array, gap)
    period = 0.4 * distance / array
    heights = period * (np.arange(400) + 0.5) / 400
    traced = np.mean(
        [chief_views_by_rays(camera, distance, float(height), trace) for height in heights]
    )
    assert mean_row_views(row_fields(camera), camera, 1 / distance) == pytest.approx(
        float(traced), abs=0.01
    )


@pytest.mark.parametrize(
    ("f_number", "array", "gap"),
    [(2.0, 60.0, 1.15), (4.0, 60.0, 1.15), (8.0, 60.0, 1.15), (4.0, 55.0, 0.775)],
)
def test_the_stereo_limits_are_where_traced_points_lose_their_second_view(
    f_number: float, array: float, gap: float, laboratory: Build, trace: Trace
) -> None:
    camera = laboratory(f_number, array, gap)
    found = stereo(camera)
    limit = found.nearest or found.farthest
    assert limit is not None
    step = 2e-3 * limit * (1 if found.nearest else -1)

    def most(distance: float) -> int:
        heights = 0.4 * distance / array * np.linspace(0, 1, 41)
        return max(
            chief_views_by_rays(camera, distance, float(height), trace) for height in heights
        )

    assert most(limit - step) < 2 <= most(limit + step)


@pytest.mark.parametrize("distance", [250.0, 320.0, 506.7, 2000.0])
def test_image_distance_and_virtual_depth_are_where_traced_rays_cross(
    distance: float, laboratory: Build, trace: Trace
) -> None:
    camera = laboratory(4.0)
    at_array, _, _ = trace(camera, distance, 0.3, 0.0, np.array([-2.0, 3.0]))
    slope = (at_array - np.array([-2.0, 3.0])) / 60.0
    crossing = 60 - float((at_array[1] - at_array[0]) / (slope[1] - slope[0]))
    assert float(image_distance(central_smms(camera), 1 / distance)) == pytest.approx(
        crossing, rel=1e-10
    )
    assert float(virtual_depth(central_smms(camera), 1 / distance)) == pytest.approx(
        abs(60 - crossing) / 1.15, rel=1e-9
    )


@pytest.mark.parametrize("f_number", [2.0, 4.0, 16.0])
def test_the_marginal_angle_is_that_of_rays_traced_back_from_the_sensor(
    f_number: float, laboratory: Build
) -> None:
    camera = laboratory(f_number)
    row = row_fields(camera)
    for index in (12, 20):
        q = CENTRES[index] + np.linspace(-0.5, 0.5, 100_001) * 0.336
        slope = (row.centre[index] - q) / 1.15
        m = q - (slope + (q - CENTRES[index]) / 0.917) * 60
        angles = np.arctan(slope[np.abs(m) <= camera.main_lens.aperture / 2 + 1e-9])
        assert float(marginal_angle(row.smms)[index]) == pytest.approx(
            float(np.ptp(angles)), abs=2e-5
        )


@pytest.mark.parametrize(
    ("f_number", "distance"), [(4.0, 506.7016), (4.0, 525.0), (8.0, 470.0), (4.0, 299.0)]
)
def test_contrast_is_the_mean_phase_of_traced_rays_over_pixels(
    f_number: float, distance: float, laboratory: Build, trace: Trace
) -> None:
    camera = laboratory(f_number)
    steps = np.linspace(-0.5, 0.5, 1501) * camera.main_lens.aperture
    at_array, landed, _ = trace(camera, distance, 0.0, 0.0, steps)
    # Round stops: every ray of the row stands for a chord of the disc that limits it.
    rim = min(camera.main_lens.aperture / 2, 0.168 / abs(float(at_array[-1] / steps[-1])))
    fine = np.linspace(-rim, rim, 20_001)
    chord = np.sqrt(np.maximum(rim**2 - fine**2, 0.0))
    spots = landed[-1] / steps[-1] * fine
    q_up, s_up, _ = trace(camera, distance, 0.01, 0.0, np.array([0.0, 1.0]))
    slope = q_up[1] - q_up[0]
    m = -q_up[0] / slope if camera.main_lens.aperture * abs(slope) > 0.336 else 0.0
    enlarged = abs(s_up[0] + m * (s_up[1] - s_up[0])) / 0.01
    for frequency in (0.5, 3.0, 8.0):
        u = frequency / enlarged
        spread = float(np.sum(chord * np.cos(2 * np.pi * u * spots)) / np.sum(chord))
        expected = spread * float(np.sinc(u * 1.66e-3))
        found = float(transfer(central_smms(camera), 1 / distance, 1.66e-3, np.asarray(frequency)))
        assert found == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize(
    ("f_number", "distance", "frequency"),
    [(4.0, 520.0, 9.0), (4.0, 470.0, 3.0), (16.0, 480.0, 6.0)],
)
def test_contrast_with_fall_off_is_the_mean_phase_of_rays_that_count_by_their_slope(
    f_number: float, distance: float, frequency: float, laboratory: Build, trace: Trace
) -> None:
    camera = laboratory(f_number)
    at_array, landed, _ = trace(camera, distance, 0.0, 0.0, np.array([1.0]))
    at_array, landed = (
        float(at_array[0]),
        float(landed[0]),
    )  # per mm from the middle of the main lens
    rim = min(camera.main_lens.aperture / 2, 0.168 / abs(at_array))
    # the cone of a pixel, not that of a point of the target: s = 0 sees m by q = m b / (L kappa)
    b, away = camera.gap, camera.array.distance
    steepest = min(
        0.168 / b,
        camera.main_lens.aperture
        / 2
        / (away * abs(1 + b / away - b / camera.array.focal_lengths[0])),
    )
    x, y = np.meshgrid(np.linspace(-1, 1, 2001), np.linspace(-1, 1, 2001))
    light = (np.hypot(x, y) <= 1) / (1 + (np.hypot(x, y) * steepest) ** 2) ** 2
    smms, at = central_smms(camera), (1 / distance, 1.66e-3, np.asarray(frequency))
    u = frequency / float(magnification(smms, 1 / distance))
    expected = float(
        (light * np.cos(2 * np.pi * u * landed * rim * x)).sum()
        / light.sum()
        * np.sinc(u * 1.66e-3)
    )
    assert float(transfer(smms, *at, falloff=1.0)) == pytest.approx(expected, abs=4e-5)
    assert abs(float(transfer(smms, *at)) - expected) > 1e-3


def test_the_useful_width_shrinks_with_crosstalk_forbidden_and_grows_with_it_allowed(
    laboratory: Build,
) -> None:
    camera = laboratory(2.0, minimum=0.0)
    allowed = replace(camera, useful=replace(camera.useful, maximum_crosstalk=0.3))
    before, after = (float(np.ptp(row_fields(one).useful[12])) for one in (camera, allowed))
    shares = light_by_rays(camera, np.linspace(0, 0.2, 4001))
    others = np.delete(shares, 12, axis=0).max(axis=0) / shares.max()
    for width, crosstalk in ((before, 0.0), (after, 0.3)):
        assert width / 2 == pytest.approx(
            float(np.linspace(0, 0.2, 4001)[np.argmax(others > crosstalk)]), abs=2e-4
        )
