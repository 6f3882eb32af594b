"""The worked example: figures from rays and closed forms that share no code with the model, to
their printed digits.
"""

from collections.abc import Callable

import numpy as np
import pytest

from flflab.optics.camera import Camera
from flflab.optics.resolution import central_smms
from flflab.optics.smms import camera_smms, image_offset
from flflab.optics.solution import solve_camera, solve_distance
from flflab.optics.useful import sensor_fields
from flflab.verdict.prediction import predicted_view_indices

FOCUS = 506.7016
# f-number, w_m, inside, outside, overlap, useful width (um), chief views row and sensor, depth of
# field (mm), R_u row, ELR row, stereo from
TABLE = [
    (1.6, 599.0, 520.0, 677.9, 270.2, 137.4, 1, 1, (499.61, 514.31), 1240, 315, 416.0),
    (2.0, 479.2, 400.2, 558.1, 150.4, 257.2, 3, 9, (499.61, 514.31), 2324, 591, 352.5),
    (2.8, 342.3, 263.3, 421.2, 13.5, 342.3, 3, 9, (499.61, 514.31), 3094, 786, 337.8),
    (4.0, 239.6, 160.6, 318.5, -89.1, 239.6, 3, 5, (499.61, 514.31), 2164, 550, 357.1),
    (5.6, 171.1, 92.2, 250.1, -157.6, 171.1, 1, 1, (499.61, 514.31), 1546, 393, 386.6),
    (8.0, 119.8, 40.9, 198.7, -208.9, 119.8, 1, 1, (499.61, 514.31), 1082, 275, 441.2),
    # The table of the sources says "no stereo" here; two microlenses of a row do share points from
    # 833.3 mm on, as rays show.
    (16.0, 59.9, 19.0, 138.8, -268.8, 78.9, 1, 1, (497.21, 516.57), 714, 181, 833.3),
]


@pytest.mark.parametrize("line", TABLE, ids=[f"F/{line[0]}" for line in TABLE])
def test_every_figure_of_the_table_comes_out(
    line: tuple[object, ...], laboratory: Callable[..., Camera]
) -> None:
    (
        f_number,
        lens_width,
        inside,
        outside,
        overlap,
        useful,
        row,
        sensor,
        depth,
        pixels,
        resolution,
        stereo,
    ) = line
    camera = laboratory(f_number)
    solution = solve_camera(camera)
    target = solve_distance(
        camera, FOCUS, solution.useful_pixels, sensor_fields(camera), solution.row
    )
    middle = len(solution.row.centre) // 2
    smms = central_smms(camera)
    um = 1e3
    found = [
        float(smms.lens_width) * um, 2 * float(smms.inside_radius) * um,
        2 * float(smms.outside_radius) * um,
        solution.overlap * um, float(np.ptp(solution.row.useful[middle])) * um,
    ]  # fmt: skip
    assert found == pytest.approx([lens_width, inside, outside, overlap, useful], abs=0.0501)
    assert (target.row_views.chief, target.sensor_views.chief) == (row, sensor)
    assert solution.depth_of_field[0] == pytest.approx(depth, abs=0.00501)
    assert solution.useful_pixels[0] == pixels
    assert target.resolution[0] == pytest.approx(resolution, abs=0.501)
    assert solution.stereo.nearest == pytest.approx(stereo, abs=0.0501)


def test_the_constants_of_the_example_come_out(laboratory: Callable[..., Camera]) -> None:
    camera = laboratory(4.0)
    solution = solve_camera(camera)
    assert solution.sharp_distance is not None
    target = solve_distance(
        camera, solution.sharp_distance, solution.useful_pixels, sensor_fields(camera), solution.row
    )
    smms = camera_smms(camera)
    assert smms.kappa[0] == pytest.approx(-0.234923, abs=5e-7)
    assert image_offset(smms, 1 / FOCUS)[0] == pytest.approx(-0.0815871, abs=5e-8)
    assert solution.sharp_distance == pytest.approx(FOCUS, abs=5e-5)
    assert solution.image_pitch == pytest.approx(0.407667, abs=5e-7)
    assert target.image_distance == pytest.approx(55.4740, abs=5e-5)
    assert target.virtual_depth == pytest.approx(3.935622, abs=5e-7)
    assert target.magnification == pytest.approx(0.0278179, abs=5e-8)
    assert smms.microlens_width[0] * 1e3 == pytest.approx(78.9, abs=0.05)
    assert np.degrees(solution.marginal_angles[12]) == pytest.approx(16.62, abs=0.005)
    assert np.degrees(solve_camera(laboratory(16.0)).marginal_angles[12]) == pytest.approx(
        12.65, abs=0.005
    )
    assert (solution.arrangement, solution.in_exit_pupil) == ("keplerian", False)


@pytest.mark.parametrize(
    ("distance", "depth", "blur_um"),
    [
        (470, 3.520, 10.1),
        (490, 3.755, 4.1),
        (500, 3.865, 1.6),
        (525, 4.119, 3.8),
        (560, 4.433, 9.6),
    ],
)
def test_virtual_depth_and_blur_through_focus(
    distance: float, depth: float, blur_um: float, laboratory: Callable[..., Camera]
) -> None:
    camera = laboratory(4.0)
    target = solve_distance(
        camera, distance, (1, 1), sensor_fields(camera), solve_camera(camera).row
    )
    assert target.virtual_depth == pytest.approx(depth, abs=5e-4)
    assert target.blur * 1e3 == pytest.approx(blur_um, abs=0.05)


@pytest.mark.parametrize(("f_number", "views"), [(2.8, 9), (4.0, 6), (5.6, 3), (8.0, 1)])
def test_dots_off_the_axis_are_seen_as_often_as_stated(
    f_number: float, views: int, laboratory: Callable[..., Camera]
) -> None:
    points = 4.0 * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1.0]])
    assert [len(seen) for seen in predicted_view_indices(laboratory(f_number), FOCUS, points)] == [
        views
    ] * 4


def test_the_galilean_example_is_sharp_where_stated(laboratory: Callable[..., Camera]) -> None:
    camera = laboratory(4.0, array=55.0, gap=0.775)
    solution = solve_camera(camera)
    assert solution.sharp_distance is not None
    target = solve_distance(
        camera, solution.sharp_distance, solution.useful_pixels, sensor_fields(camera), solution.row
    )
    assert (solution.arrangement, target.arrangement) == ("galilean", "galilean")
    assert solution.sharp_distance == pytest.approx(299.9, abs=0.05)
    assert target.virtual_depth == pytest.approx(6.458, abs=0.0005)
    assert target.magnification == pytest.approx(0.031, abs=5e-4)


def test_a_camera_that_focuses_on_no_real_target_says_so(laboratory: Callable[..., Camera]) -> None:
    assert solve_camera(laboratory(4.0, array=55.0, gap=1.0)).sharp_distance is None
