# longer than 450 lines because one subject's sentences of behaviour stand together
"""The kernels against dense quadrature in numpy, and what every picture must obey."""

import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flflab.image.flat_target.form import add_plane
from flflab.image.geometry.setup import Setup, make_setup
from flflab.image.light.ruled import add_ruled
from flflab.image.light.sampled import add_dots
from flflab.image.light.strips import BLOCK, MEAN, ROWS, strip_means, strip_nodes
from flflab.image.light.texels import add_texels
from flflab.image.radiance.profile import prepare, profile_mean, profile_table
from flflab.image.scene import one_plane
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, pixel_positions
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, Target, White

Array = npt.NDArray[np.float64]

FOCUS = 506.7016
SINE = Chirp((1.5, 4.5), width=40.0, height=40.0)


def one_micro_image(f_number: float = 4.0, columns: int = 110, rows: int = 104) -> Camera:
    """The laboratory's camera with one microlens, and a sensor that sees one side of its
    micro-image.
    """
    array = MicrolensArray(
        layout="square",
        count=(1, 1),
        pitch=(0.4, 0.4),
        aperture=0.336,
        focal_lengths=(0.917,),
        distance=60.0,
    )
    return Camera(
        MainLens(50.0, f_number), array, Sensor((columns, rows), 0.00166, 61.15, (0.08, 0.075))
    )


def setup_of(
    target: Target, distance: float, tolerance: float = 0.002, f_number: float = 4.0
) -> Setup:
    scene = one_plane(one_micro_image(f_number), target, distance)
    return make_setup(scene, scene.planes[0], tolerance)


def formed(setup: Setup, target: Target, wanted: npt.NDArray[np.bool_] | None = None) -> Array:
    columns, rows = setup.sensor.resolution
    image = np.zeros((rows, columns))
    add_plane(image, setup, target, wanted)
    return image


def dense(
    setup: Setup,
    target: Target,
    column: int,
    row: int,
    places: int = 8,
    strips: int = 120,
    nodes: int = 32,
) -> float:
    """One pixel of a setup of one entry: Gauss's rule over the pixel and along each of many strips
    of the clipped pupil.
    """
    xs, ys = pixel_positions(setup.sensor)
    pupils = setup.pupils
    at, shares = np.polynomial.legendre.leggauss(places)
    along, weights = np.polynomial.legendre.leggauss(nodes)
    slope, reach = float(pupils.slope[0]), float(pupils.reach[0])
    total = 0.0
    for dx, wx in zip(at, shares, strict=True):
        for dy, wy in zip(at, shares, strict=True):
            e = np.array(
                [xs[column] - pupils.centre_x[0], ys[row] - pupils.centre_y[0]]
            ) + 0.5 * setup.pixel_width * np.array([dx, dy])
            x, y, radius = e[0] / slope, e[1] / slope, reach / abs(slope)
            low, high = max(-1.0, y - radius), min(1.0, y + radius)
            if low >= high:
                continue
            angle = np.pi * (np.arange(strips) + 0.5) / strips
            v = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)
            thick = 0.5 * (high - low) * np.sin(angle) * np.pi / strips
            own, other = np.sqrt(1 - v**2), np.sqrt(np.maximum(0.0, radius**2 - (v - y) ** 2))
            left, right = np.maximum(-own, x - other), np.minimum(own, x + other)
            length = np.maximum(0.0, right - left)
            u = 0.5 * (left + right)[:, None] + 0.5 * length[:, None] * along
            t = np.stack([u, np.broadcast_to(v[:, None], u.shape)])
            place = (
                setup.origin[0][:, None, None]
                + np.einsum("ij,jkl->ikl", setup.by_pupil[0], t)
                + (setup.by_sensor[0] @ e)[:, None, None]
            )
            seen = target.radiance(place[0], place[1])
            if setup.falloff:
                middle = (
                    np.array([pupils.slant_x[0], pupils.slant_y[0]]) + pupils.slant_scale[0] * e
                )
                slant = middle[:, None, None] + pupils.slant_spread[0] * t
                seen = seen / (1 + (slant**2).sum(axis=0)) ** 2
            total += (
                wx * wy / 4 * float((seen * weights / 2 * (thick * length)[:, None]).sum()) / np.pi
            )
    return float(pupils.level[0]) * total


def some_pixels(image: Array, count: int) -> npt.NDArray[np.int64]:
    lit = np.argwhere(image > 0)
    return lit[np.random.default_rng(5).integers(0, len(lit), count)]


def farthest(setup: Setup, target: Target, count: int = 12) -> float:
    image = formed(setup, target)
    return max(
        abs(float(image[row, column]) - dense(setup, target, column, row))
        for row, column in some_pixels(image, count)
    )


def mapped(setup: Setup, change: Array) -> Setup:
    """The same seen by a target whose axes are changed by a matrix."""
    return replace(
        setup,
        origin=setup.origin @ change.T,
        by_pupil=change @ setup.by_pupil,
        by_sensor=change @ setup.by_sensor,
    )


def turn(angle: float) -> Array:
    return np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])


@pytest.mark.parametrize("falloff", [False, True])
@pytest.mark.parametrize("distance", [FOCUS, 480.0])
@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 2])
def test_a_turned_target_is_imaged_as_dense_quadrature_says(
    angle: float, distance: float, falloff: bool
) -> None:
    setup = replace(mapped(setup_of(SINE, distance), turn(angle)), falloff=falloff)
    assert farthest(setup, SINE) < setup.tolerance


def test_a_skew_map_is_imaged_as_dense_quadrature_says() -> None:
    skew = turn(0.1) @ np.array([[1.02, 0.01], [-0.03, 0.97]])
    assert farthest(mapped(setup_of(SINE, 480.0), skew), SINE) < 0.002


@pytest.mark.parametrize("distance", [FOCUS, 480.0, 450.0])
def test_the_tightest_tolerance_is_kept_far_below_a_ten_thousandth(distance: float) -> None:
    setup = setup_of(SINE, distance, tolerance=1e-5)
    probe = some_pixels(formed(replace(setup, tolerance=0.01), SINE), 8)
    wanted = np.zeros(setup.sensor.resolution[::-1], dtype=np.bool_)
    wanted[probe[:, 0], probe[:, 1]] = True
    image = formed(setup, SINE, wanted)
    errors = [
        image[row, column] - dense(setup, SINE, column, row, 16, 500, 16) for row, column in probe
    ]
    assert np.abs(errors).max() < 1e-4
    assert math.sqrt(np.mean(np.square(errors))) < 1e-5


@pytest.mark.parametrize(
    "target", [Chirp((0.4, 2.5), 8.0, 8.0), Bars((2.5, 0.4), 8.0, 8.0)], ids=["sine", "bars"]
)
@pytest.mark.parametrize("width", [8.0, 3.1, 0.3], ids="{} mm".format)
def test_a_profile_cut_by_a_card_has_the_means_of_what_is_left(target: Bars, width: float) -> None:
    """Sums over 200,000 places; the card cuts bars anywhere."""
    table, law = profile_table(target, width)
    across = (np.arange(200_000) + 0.5) / 200_000 - 0.5
    for middle in (-1.7, -0.52, 0.03, 1.49):
        for box in (0.06, 0.9):
            x = middle + box * across
            mean = np.where(np.abs(x) <= width / 2, target.radiance(x, 0.0), 0.0).mean()
            assert profile_mean(middle, box, 0.0, table, law) == pytest.approx(mean, abs=2e-5)


@pytest.mark.parametrize(
    "target",
    [Bars((1.9, 1.7), 19.5, 19.5), Bars((4.7, 4.7), 23.0, 23.0), Chirp((0.7, 3.1), 12.3, 12.3)],
    ids=str,
)
def test_a_card_that_ends_where_a_bar_does_leaves_no_cell_without_width(target: Bars) -> None:
    """Rounding put such an end before the bar's in a fifth of them, and the picture held no numbers
    there.
    """
    edges = target.position(np.arange(1, math.ceil(target.cycles / 2)) / 2)
    for edge in edges[edges < 0]:
        table, law = profile_table(target, -2 * float(edge))
        assert (np.diff(table[:, 0]) > 1e-9).all()
        across = np.linspace(1.2 * edge, -1.2 * edge, 200)
        found = [profile_mean(float(x), 0.05, 0.02, table, law) for x in across]
        assert np.isfinite(found).all()
        assert 0.0 <= min(found) <= max(found) <= 1.0


@pytest.mark.parametrize("target", [SINE, Bars((2.0, 2.0), 40.0, 40.0)])
def test_more_strips_come_nearer_by_the_power_they_promise(target: Bars) -> None:
    spread, radius, places = 0.25, 1.9, np.zeros((3, 4))
    boxes = np.array([[0.06, 0.0]] * 3)
    sums = prepare(
        -1.0, 1.0, spread, boxes, 1e-9, *profile_table(target, target.width), np.zeros(1), places
    )
    counts = np.array([8, 16, 32, 64, 2048])
    points = np.zeros((ROWS, BLOCK))
    points[0, :12], points[1, :12] = 0.3 * np.arange(12) - 2.2, 0.17 * np.arange(12) - 0.9

    def means(strips: Array, count: int) -> Array:
        landing, place = (0.44 / 3, 0.2 / 3, 0.0, spread, 1.0, 0.0), places[0]
        strip_means(
            points.ravel(),
            12,
            landing,
            (1.0, radius),
            strips,
            count,
            sums,
            place,
            place,
            0,
            (0.0, 0.0, 0.0, 0.0),
        )
        return points.ravel()[MEAN : MEAN + 12].copy()

    found = [
        means(strips, int(count)) for strips, count in zip(strip_nodes(counts), counts, strict=True)
    ]
    errors = [math.sqrt(np.mean((some - found[-1]) ** 2)) for some in found[:-1]]
    assert np.polyfit(np.log(counts[:-1]), np.log(errors), 1)[0] < -1.7


@pytest.mark.parametrize("pieces", [1, 2, 4])
@pytest.mark.parametrize("cycles", [0.7, 2.0])
def test_a_strips_fall_off_is_that_of_rays_weighed_one_by_one(cycles: float, pieces: int) -> None:
    target, spread, radius, places = Bars((cycles, cycles), 40.0, 40.0), 0.25, 1.9, np.zeros((3, 4))
    boxes, slant = np.full((3, 2), 1e-6), (0.1, -0.05, 0.02, 0.28)
    sums = prepare(
        -1.0, 1.0, spread, boxes, 1e-6, *profile_table(target, target.width), np.zeros(1), places
    )
    points = np.zeros((ROWS, BLOCK))
    points[0, :12], points[1, :12] = ex, ey = 0.3 * np.arange(12) - 2.2, 0.17 * np.arange(12) - 0.9
    strips, landing, place = (
        strip_nodes(np.array([512]))[0],
        (0.44 / 3, 0.2 / 3, 0.0, spread, 1.0, 0.0),
        places[0],
    )
    strip_means(
        points.ravel(), 12, landing, (1.0, radius), strips, 512, sums, place, place, pieces, slant
    )
    x, y = np.meshgrid((np.arange(3000) + 0.5) / 1500 - 1, (np.arange(400) + 0.5) / 200 - 1)
    weights = [
        1
        / (
            1
            + (slant[0] + slant[2] * at_x + slant[3] * x) ** 2
            + (slant[1] + slant[2] * at_y + slant[3] * y) ** 2
        )
        ** 2
        for at_x, at_y in zip(ex, ey, strict=True)
    ]
    for number, weight in enumerate(weights):
        lit = (np.hypot(x, y) < 1) & (np.hypot(x - ex[number], y - ey[number]) < radius)
        seen = target.radiance(landing[0] + landing[1] * ex[number] + spread * x, np.zeros_like(x))
        change = 4 * (math.hypot(slant[0], slant[1]) + slant[3]) * slant[3]
        assert points[2, number] == pytest.approx(
            (weight * seen)[lit].mean(), abs=0.037 * change / pieces**2 + 2e-4
        )


def test_white_falls_off_on_the_axis_as_the_closed_form_says() -> None:
    setup = replace(setup_of(White(), FOCUS), falloff=True, pixel_width=0.0)
    xs, ys = pixel_positions(setup.sensor)
    column, row = int(np.argmin(np.abs(xs))), int(np.argmin(np.abs(ys)))
    spread = float(setup.pupils.slant_spread[0])
    assert formed(setup, White())[row, column] == pytest.approx(1 / (1 + spread**2), abs=2e-4)


def falls_off(
    setup: Setup, entry: int, ex: Array, ey: Array, rings: int = 60, spokes: int = 240
) -> Array:
    """Light of a micro-image at points (mm from its centre) under a white target, by points of even
    weight over the whole pupil.
    """
    pupils = setup.pupils
    radius = np.sqrt((np.arange(rings) + 0.5) / rings)[:, None]
    angle = (np.arange(spokes) + 0.5 * (np.arange(rings)[:, None] % 2)) * 2 * np.pi / spokes
    t, u = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    passes = (
        np.hypot(pupils.slope[entry] * t - ex[:, None], pupils.slope[entry] * u - ey[:, None])
        <= pupils.reach[entry]
    )
    along = (pupils.slant_x[entry] + pupils.slant_scale[entry] * ex)[:, None] + pupils.slant_spread[
        entry
    ] * t
    across = (pupils.slant_y[entry] + pupils.slant_scale[entry] * ey)[
        :, None
    ] + pupils.slant_spread[entry] * u
    return pupils.level[entry] * (passes / (1 + along**2 + across**2) ** 2).mean(axis=1)


@pytest.mark.parametrize(("pixel", "tolerance"), [(0.01, 0.04), (0.01, 0.005), (0.002, 0.02)])
def test_the_fall_off_of_overlapping_rims_adds_up_to_less_than_its_share(
    pixel: float, tolerance: float
) -> None:
    """Rims of 2 and 11 pixels: where each pixel has its own mean over the pupil, and where a table
    is read.
    """
    array = MicrolensArray("square", (21, 21), (0.2, 0.2), 0.17, (0.83,), 57.5)
    camera = Camera(MainLens(50.0, 1.9), array, Sensor((48, 40), pixel, 58.45, (0.1, 0.05)))
    scene = one_plane(camera, White(), FOCUS)
    setup = replace(make_setup(scene, scene.planes[0], tolerance), falloff=True, pixel_width=0.0)
    image = formed(setup, White())
    xs, ys = pixel_positions(setup.sensor)
    rows, columns = np.random.default_rng(1).integers(0, ((40,), (48,)), (2, 80))
    seen = np.zeros(80)
    for entry in range(len(setup.blur)):
        ex, ey = xs[columns] - setup.pupils.centre_x[entry], ys[rows] - setup.pupils.centre_y[entry]
        near = np.hypot(ex, ey) < setup.pupils.outside[entry]
        seen[near] += falls_off(setup, entry, ex[near], ey[near])
    assert seen.max() > 2
    assert np.abs(image[rows, columns] - seen).max() < 0.3 * tolerance


def test_white_seen_by_points_is_the_area_common_to_two_discs() -> None:
    setup = replace(setup_of(White(), FOCUS), pixel_width=0.0)
    image = formed(setup, White())
    xs, ys = pixel_positions(setup.sensor)
    distance = np.hypot(xs[None, :], ys[:, None]) / abs(float(setup.pupils.slope[0]))
    radius = float(setup.pupils.reach[0] / abs(setup.pupils.slope[0]))
    with np.errstate(invalid="ignore", divide="ignore"):
        one = np.arccos((distance**2 + 1 - radius**2) / (2 * distance))
        two = np.arccos((distance**2 + radius**2 - 1) / (2 * distance * radius))
        kite = (
            np.sqrt(
                (-distance + 1 + radius)
                * (distance + 1 - radius)
                * (distance - 1 + radius)
                * (distance + 1 + radius)
            )
            / 2
        )
        area = np.where(
            distance <= radius - 1,
            np.pi,
            np.where(distance >= radius + 1, 0.0, one + radius**2 * two - kite),
        )
    assert np.abs(image - area / np.pi).max() < 0.05 * setup.tolerance


@settings(max_examples=15, deadline=None)
@given(distance=st.floats(430.0, 560.0), column=st.integers(1, 109), row=st.integers(1, 103))
def test_a_micro_image_cut_into_tiles_is_the_same(distance: float, column: int, row: int) -> None:
    whole = setup_of(SINE, distance)
    four = np.zeros(4, dtype=np.int64)
    columns, rows = whole.sensor.resolution
    windows = np.array(
        [
            [0, column, 0, row],
            [column, columns, 0, row],
            [0, column, row, rows],
            [column, columns, row, rows],
        ]
    )
    assert (
        np.abs(formed(whole.of(four, windows), SINE) - formed(whole, SINE)).max()
        < 0.1 * whole.tolerance
    )


@settings(max_examples=15, deadline=None)
@given(distance=st.floats(430.0, 560.0), angle=st.floats(-3.0, 3.0))
def test_the_mirrored_target_gives_the_mirrored_picture(distance: float, angle: float) -> None:
    camera = replace(one_micro_image(), sensor=Sensor((150, 140), 0.00166, 61.15))
    scenes = [one_plane(camera, Edge(a), distance) for a in (angle, -angle)]
    upright, mirrored = (
        formed(make_setup(scene, scene.planes[0], 0.002), scene.planes[0].target)
        for scene in scenes
    )
    assert np.abs(upright[::-1] - mirrored).max() < 1e-9


@settings(max_examples=8, deadline=None)
@given(distance=st.floats(440.0, 550.0), seed=st.integers(0, 1000), share=st.floats(0.0, 1.0))
def test_pictures_add_up(distance: float, seed: int, share: float) -> None:
    one, two = np.random.default_rng(seed).random((2, 9, 11))
    setup = setup_of(Picture(one, 9.0), distance, tolerance=0.01)
    sum_of = formed(setup, Picture(share * one + (1 - share) * two, 9.0))
    parts = share * formed(setup, Picture(one, 9.0)) + (1 - share) * formed(
        setup, Picture(two, 9.0)
    )
    assert (
        np.abs(sum_of - parts).max() < 0.01 * setup.tolerance
    )  # what rounds to below black is cut off


@pytest.mark.parametrize("target", [SINE, White(), FourDot(1.0, 1.2), Picture(np.eye(3), 3.0)])
def test_wanted_pixels_are_those_of_the_whole_picture_and_no_others_are_touched(
    target: Target,
) -> None:
    setup = setup_of(target, 490.0, tolerance=0.01)
    wanted = np.random.default_rng(1).random(setup.sensor.resolution[::-1]) < 0.01
    some = formed(setup, target, wanted)
    assert (
        np.abs(some - np.where(wanted, formed(setup, target), 0.0)).max() < 0.05 * setup.tolerance
    )
    assert not some[~wanted].any()


@pytest.mark.parametrize(
    "distance",
    [FOCUS, FOCUS * (1 + 1e-9), FOCUS * (1 + 1e-6), FOCUS + 0.01, 300.0, 300.0 * (1 + 1e-9), 30.0],
)
def test_any_blur_from_none_to_hopeless_is_finite_and_no_brighter_than_white(
    distance: float,
) -> None:
    image = formed(setup_of(SINE, distance), SINE)
    assert np.all(np.isfinite(image))
    assert image.min() >= 0
    assert image.max() <= 1 + 1e-12


@pytest.mark.ci
def test_the_kernels_without_numba_are_the_same_formulas_in_numpy(tmp_path: Path) -> None:
    """A disc, an edge, texels and bars, in waves and in rays; fused sums and single precision
    differ in their last digits.
    """
    draw = (
        "import sys, numpy as np; from flflab.image.promise import drawn; from flflab.image.render"
        " import render; "
    )
    draw += "trials = [(3, True), (42, True), (14, True), (10, False), (16, False)]; "
    draw += (
        "np.save(sys.argv[1], [render(drawn(seed, (12, 10), waves=waves)[0], tolerance=0.1) for"
        " seed, waves in trials])"
    )
    pictures: list[Array] = []
    for disabled in "01":
        file = tmp_path / f"{disabled}.npy"
        subprocess.run(
            [sys.executable, "-c", draw, str(file)],
            env=os.environ | {"NUMBA_DISABLE_JIT": disabled},
            check=True,
            timeout=120,
        )
        pictures.append(np.load(file))
    assert np.all(pictures[0].max(axis=(1, 2)) > 0.1)
    assert np.abs(pictures[1] - pictures[0]).max() < 1e-7


def test_a_kernel_is_compiled_once_however_many_kinds_of_microlenses_there_are() -> None:
    array = MicrolensArray(
        layout="square",
        count=(3, 1),
        pitch=(0.4, 0.4),
        aperture=0.336,
        focal_lengths=(0.917,),
        distance=60.0,
    )
    alike = Camera(MainLens(50.0, 4.0), array, Sensor((60, 40), 0.00166, 61.15))
    unlike = replace(
        alike, array=replace(array, focal_lengths=(0.917, 0.87, 0.96), pattern=((0, 1, 2),))
    )
    kernels = {
        SINE: add_ruled,
        FourDot(0.2, 0.3): add_dots,
        Picture(np.ones((20, 30)), 10.0): add_texels,
    }
    for camera in (alike, unlike):
        for target in kernels:
            scene = one_plane(camera, target, 450.0)
            add_plane(np.zeros((40, 60)), make_setup(scene, scene.planes[0], 0.01), target)
    assert [len(kernel.signatures) for kernel in kernels.values()] == [1, 1, 1]
