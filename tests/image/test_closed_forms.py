"""The image against formulas that can be done by hand."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import InputError
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.motion import Motion
from flflab.image.render import TOLERANCE, render
from flflab.image.scene import one_plane
from flflab.optics.camera import Camera, Sensor
from flflab.targets import Bars, Black, Chirp, Edge, FourDot, Picture, Target, White

FOCUS = 506.7016
MAGNIFICATION = 0.0278179  # of the worked example, at focus


def typical(difference: npt.NDArray[np.float64]) -> float:
    """Root mean square of what is not exactly equal."""
    apart = difference[difference != 0]
    return float(np.sqrt(np.mean(apart**2))) if len(apart) else 0.0


def image_of(
    camera: Camera,
    target: Target,
    distance: float,
    *,
    tolerance: float = TOLERANCE,
    offset: tuple[float, float] = (0.0, 0.0),
) -> npt.NDArray[np.float64]:
    return render(one_plane(camera, target, distance, offset), tolerance=tolerance)


def one_micro_image(camera: Camera) -> Camera:
    return replace(camera, array=replace(camera.array, count=(1, 1)))


@pytest.mark.parametrize(
    ("f_number", "shadow_um"), [(1.6, 599.0), (4.0, 239.6), (8.0, 119.8), (16.0, 78.9)]
)
def test_a_white_micro_image_holds_as_much_light_as_the_wider_shadow(
    with_f_number: Callable[[float], Camera],
    f_number: float,
    shadow_um: float,
) -> None:
    camera = with_f_number(f_number)
    wide = replace(one_micro_image(camera), sensor=replace(camera.sensor, resolution=(440, 440)))
    light = image_of(wide, White(), FOCUS).sum() * 1.66**2
    assert light == pytest.approx(
        math.pi / 4 * shadow_um**2, rel=2e-3
    )  # the widths are known to their printed digits


@pytest.mark.parametrize(
    ("f_number", "columns", "nodes", "middle"),
    [
        (2.8, 230, 24, (0.16, 0.03)),
        (5.6, 230, 24, (0.16, 0.03)),
        (14.0, 16, 96, (0.16, 0.03)),
        (12.5, 237, 24, (0.0, 0.0)),
    ],
    ids=["wide", "narrower", "of a pixel", "begins at the centre"],
)
@pytest.mark.parametrize("tolerance", [1e-4, 3e-5])
def test_white_on_a_rim_is_the_area_common_to_two_discs_averaged_over_each_pixel(
    camera: Camera,
    f_number: float,
    columns: int,
    nodes: int,
    middle: tuple[float, float],
    tolerance: float,
) -> None:
    """Where a rim is wide and smooth pixels are looked up at four points, and finely divided at its
    ends and in narrow ones.
    """
    pixel = 0.3818 / columns
    one = replace(one_micro_image(camera), sensor=Sensor((columns, 12), pixel, 61.15, middle))
    one = replace(one, main_lens=replace(one.main_lens, f_number=f_number))
    # On the microlens: its own opening, and where rays from a point of the sensor pass that it
    # bends into the main lens.
    bent = 60.0 * (1 / 0.917 - 1 / 1.15) - 1
    hole, seen = 0.168, 25.0 / f_number / bent
    at, weights = np.polynomial.legendre.leggauss(nodes)
    x = middle[0] + ((np.arange(columns) - (columns - 1) / 2)[:, None] + at / 2) * pixel
    y = middle[1] + ((np.arange(12) - 5.5)[:, None] + at / 2) * pixel
    along, across = (
        np.hypot(x[None, :, None, :], y[:, None, :, None]),
        weights[:, None] * weights / 4,
    )
    shared = common_area(hole, seen, along * 60.0 / 1.15 / bent) / (math.pi * min(hole, seen) ** 2)
    due = np.einsum("rcij,ij->rc", shared, across)
    image = render(one_plane(one, White(), FOCUS), tolerance=tolerance)
    assert np.mean((due > 1e-3) & (due < 0.999)) > 0.1
    assert typical((image - due)[due > 0]) < max(tolerance, 6e-5)


def common_area(
    one: float, other: float, apart: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Of two discs of these radii: two segments, each a sector less a triangle."""
    small, large = min(one, other), max(one, other)
    near = np.clip(apart, large - small, large + small)
    with np.errstate(invalid="ignore", divide="ignore"):
        cut = (near**2 + large**2 - small**2) / (2 * near)
        half_large, half_small = (
            np.arccos(np.clip(place, -1, 1)) for place in (cut / large, (near - cut) / small)
        )
        area = large**2 * (half_large - np.sin(2 * half_large) / 2) + small**2 * (
            half_small - np.sin(2 * half_small) / 2
        )
    return np.where(
        apart <= large - small, math.pi * small**2, np.where(apart >= large + small, 0.0, area)
    )


def test_the_white_level_is_one_in_the_middle_and_nothing_outside_the_total_field(
    camera: Camera,
) -> None:
    image = image_of(
        replace(one_micro_image(camera), sensor=Sensor((241, 241), 0.00166, 61.15)), White(), FOCUS
    )
    across = 1.66 * np.hypot(*np.meshgrid(np.arange(241) - 120, np.arange(241) - 120))
    assert np.all(np.abs(image[across < 160.6 / 2 - 1.66] - 1) < 1e-12)
    assert np.all(image[across > 318.5 / 2 + 1.66] == 0)
    assert np.all(image[(across < 318.5 / 2 - 1.66)] > 0)


def test_white_does_not_depend_on_the_targets_distance(camera: Camera) -> None:
    near, far = image_of(camera, White(), 100.0), image_of(camera, White(), math.inf)
    assert np.array_equal(near, far)


def test_boundless_white_looks_alike_however_it_leans_and_moves(camera: Camera) -> None:
    """And costs no more: neither its tilt nor its moments are formed."""
    still = one_plane(camera, White(), 490.0)
    (plane,) = still.planes
    leaning = replace(
        still,
        planes=(replace(plane, tilt=(0.3, -0.2)),),
        distortion=Distortion(0.5),
        motion=Motion((3.0, 0.0), (0.0, 2.0)),
    )
    assert typical(render(leaning) - render(still)) < 1e-12
    leaning_far = replace(plane, offset=(2000.0, 0.0), tilt=(0.4, 0.0))
    with pytest.raises(InputError, match="reaches the main lens"):
        render(replace(still, planes=(leaning_far,)))


@pytest.mark.parametrize("distance", [FOCUS, 500.0])
def test_a_dot_in_the_bright_field_holds_its_area_in_white(camera: Camera, distance: float) -> None:
    small = FourDot(diameter=0.5, spacing=1.0)
    light = image_of(one_micro_image(camera), small, distance).sum() * 0.00166**2
    magnification = (
        1.15 / distance / abs(60 * (1 / distance - 1 / 50 + 1 / 60))
    )  # b V / |x|, through the microlens's centre
    assert light == pytest.approx(4 * math.pi * (0.25 * magnification) ** 2, rel=1e-3)


def test_the_worked_examples_dot_is_as_large_as_its_magnification_says(camera: Camera) -> None:
    light = (
        image_of(one_micro_image(camera), FourDot(diameter=1.0, spacing=1.2), FOCUS).sum()
        * 0.00166**2
    )
    assert light == pytest.approx(4 * math.pi * (0.5 * MAGNIFICATION) ** 2, rel=1e-4)


@pytest.mark.parametrize("distance", [FOCUS, 490.0])
def test_the_images_of_complementary_edges_add_up_to_white(camera: Camera, distance: float) -> None:
    angle = 0.3
    both = image_of(camera, Edge(angle), distance) + image_of(
        camera, Edge(angle + math.pi), distance
    )
    assert typical(both - image_of(camera, White(), distance)) < 0.002


def test_a_large_white_picture_is_white(camera: Camera) -> None:
    picture = Picture(np.ones((7, 9)), 500.0)
    assert typical(image_of(camera, picture, 490.0) - image_of(camera, White(), 490.0)) < 1e-4


def test_a_picture_of_bars_is_the_bars(camera: Camera) -> None:
    bars = Bars((0.5, 0.5), width=8.0, height=8.0)
    column = (np.arange(800) + 0.5) / 100 - 4
    picture = Picture(np.tile(bars.radiance(column, 0.0), (800, 1)), 8.0)
    assert typical(image_of(camera, picture, 500.0) - image_of(camera, bars, 500.0)) < 0.003


@pytest.mark.parametrize("target", [FourDot(1.0, 2.0), Edge(0.2)])
def test_a_target_that_is_its_own_mirror_image_gives_a_picture_that_is(
    camera: Camera, target: Target
) -> None:
    image = image_of(camera, target, 495.0)
    if isinstance(target, Edge):
        image = image + image[::-1, ::-1]
        assert typical(image - image_of(camera, White(), 495.0)) < 0.002
    else:
        assert typical(image - image[::-1]) < 1e-9
        assert typical(image - image[:, ::-1]) < 1e-9


def test_moving_the_target_by_the_parallax_moves_the_picture_by_one_micro_image(
    camera: Camera,
) -> None:
    pitch_px = 250
    array = replace(camera.array, pitch=(pitch_px * 0.00166 * 60 / 61.15,) * 2)
    there = replace(camera, array=array)
    parallax = array.pitch[0] / 60 * FOCUS
    image = image_of(there, Bars(), FOCUS)
    moved = image_of(there, Bars(), FOCUS, offset=(-parallax, 0.0))
    assert typical(moved[:, pitch_px:] - image[:, :-pitch_px]) < 1e-6


@pytest.mark.parametrize(
    "target", [FourDot(), Bars(), Chirp(), Picture(np.ones((2, 2)), 3.0), Black()]
)
def test_what_has_a_size_is_a_point_at_infinity(camera: Camera, target: Target) -> None:
    assert not image_of(camera, target, math.inf).any()


def test_an_edge_at_infinity_halves_the_picture(camera: Camera) -> None:
    one = one_micro_image(camera)
    assert image_of(one, Edge(), math.inf).sum() == pytest.approx(
        image_of(one, White(), math.inf).sum() / 2, rel=1e-6
    )


@pytest.mark.parametrize("target", [Bars(), FourDot(1.0, 2.0)])
def test_a_tighter_tolerance_is_kept(camera: Camera, target: Target) -> None:
    finest = image_of(camera, target, 498.0, tolerance=0.00005)
    for tolerance in (0.01, 0.002, 0.0005):
        assert typical(image_of(camera, target, 498.0, tolerance=tolerance) - finest) < tolerance


def test_an_array_of_which_the_sensor_sees_nothing_gives_black(camera: Camera) -> None:
    away = replace(camera, sensor=replace(camera.sensor, offset=(100.0, 0.0)))
    assert not image_of(away, White(), FOCUS).any()


def test_a_sensor_of_one_pixel(camera: Camera) -> None:
    one = replace(camera, sensor=replace(camera.sensor, resolution=(1, 1)))
    assert image_of(one, White(), FOCUS)[0, 0] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distance": -1.0}, "-1 mm"),
        ({"distance": 0.0}, "0 mm"),
        ({"distance": math.nan}, "nan"),
        ({"tolerance": 0.0}, "1e-05"),
        ({"tolerance": math.nan}, "nan"),
        ({"offset": (math.nan, 0.0)}, "finite"),
    ],
)
def test_impossible_numbers_are_refused(
    camera: Camera, change: dict[str, float], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        image_of(**{"camera": camera, "target": White(), "distance": FOCUS, **change})  # pyright: ignore[reportArgumentType]


def test_square_apertures_and_an_array_through_the_sensor_are_refused(camera: Camera) -> None:
    with pytest.raises(InputError, match="round"):
        image_of(replace(camera, aperture_shape="square"), White(), FOCUS)
    with pytest.raises(InputError, match="tilt"):
        image_of(replace(camera, array=replace(camera.array, tilt=(0.5, 0.0))), White(), FOCUS)
