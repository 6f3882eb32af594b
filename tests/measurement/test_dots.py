"""Dots traced ray by ray: how many views, where, and where in space."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import MeasurementError
from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.dots.views import DotViews, count_views
from flflab.measurement.lattice.falloff import unshaded
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.targets import FourDot, White

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
RESOLUTION = (1240, 1240)
FOCUS = 506.7016
TARGET = FourDot(diameter=1.0, spacing=4.0)


def white_of(brute: Any, camera: Camera) -> Array:
    b, away, pixel = camera.gap, camera.array.distance, camera.sensor.pixel
    lens, cone = (
        camera.main_lens.aperture * b / away / 2,
        camera.array.aperture * abs(1 + b / away - b / camera.array.focal_lengths[0]) / 2,
    )
    middle = (np.asarray(RESOLUTION) - 1) / 2
    return brute.white_picture(
        RESOLUTION[::-1],
        "square",
        0.4 * (1 + b / away) / pixel,
        0.0,
        tuple(middle),
        lens / pixel,
        cone / pixel,
    )


def counted(
    brute: Any, camera: Camera, distance: float, offset: Array, nominal: Camera, level: float = 3000
) -> tuple[DotViews, ...]:
    rng = np.random.default_rng(2)
    # formed exactly; where dots land is found by rays of this test's own
    scenes = [
        one_plane(camera, target, distance, (float(offset[0]), float(offset[1])))
        for target in (White(), TARGET)
    ]
    white, dots = (
        brute.expose(render(scene, tolerance=1e-4), NOISE, level, rng) for scene in scenes
    )
    lattice = lattice_behind(nominal, white, NOISE)
    return count_views(dots, white, lattice, nominal, TARGET, distance, NOISE)


def expected_views(brute: Any, camera: Camera, distance: float, dot: Array) -> tuple[Array, Array]:
    """Landings (px) within half of the light's circle, and how far from its rim the doubtful ones
    are.
    """
    b, away, pixel = camera.gap, camera.array.distance, camera.sensor.pixel
    lenses, landed = brute.landings(camera, distance, dot)
    centres = lenses * (1 + b / away) / pixel + (np.asarray(RESOLUTION) - 1) / 2
    lens, cone = (
        camera.main_lens.aperture * b / away / 2,
        camera.array.aperture * abs(1 + b / away - b / camera.array.focal_lengths[0]) / 2,
    )
    r = np.linspace(lens - cone, lens, 2000) / pixel
    # two-disc illumination by counting: the share of the small disc's points inside the large one
    grid = np.linspace(-1, 1, 401)
    x, y = (part[np.hypot(*np.meshgrid(grid, grid)) <= 1] for part in np.meshgrid(grid, grid))
    share = np.array(
        [
            np.mean(np.hypot(one + x * cone / pixel, y * cone / pixel) <= lens / pixel)
            for one in r[::40]
        ]
    )
    limit = np.interp(-0.5, -share, r[::40])
    away_px = np.hypot(*(landed - centres).T)
    on_sensor = np.all((landed > -0.5) & (landed < np.asarray(RESOLUTION) - 0.5), axis=1)
    on_sensor &= np.all((centres > -0.5) & (centres < np.asarray(RESOLUTION) - 0.5), axis=1)
    return landed[on_sensor & (away_px <= limit)], away_px - limit


@pytest.mark.parametrize(
    ("f_number", "distance", "offset"),
    [
        (4.0, FOCUS, (0.0, 0.0)),
        (5.6, 497.0, (0.3, 0.1)),
        pytest.param(2.8, FOCUS, (0.13, -0.2), marks=pytest.mark.ci),
        pytest.param(8.0, FOCUS, (0.0, 0.0), marks=pytest.mark.ci),
    ],
)
def test_every_dot_is_counted_and_placed(
    brute: Any, f_number: float, distance: float, offset: tuple[float, float]
) -> None:
    camera = brute.camera(f_number, RESOLUTION)
    found = counted(brute, camera, distance, np.array(offset), camera)
    for dot in found:
        true = TARGET.centres[dot.dot] + offset
        landed, margin = expected_views(brute, camera, distance, true)
        doubtful = np.count_nonzero(np.abs(margin) < 0.3)
        assert abs(dot.views - len(landed)) <= doubtful
        if doubtful == 0:
            assert dot.views == len(landed)
        nearest = (
            np.hypot(*(dot.centres_px[:, None] - landed[None]).transpose(2, 0, 1)).min(axis=1)
            if len(landed)
            else np.zeros(0)
        )
        assert np.all(nearest < 4 * dot.centre_uncertainty_px.max(axis=1))
        if dot.views >= 2:
            error = dot.position_mm - np.array([*true, -distance])
            assert np.all(np.abs(error) < 4 * dot.uncertainty_mm)
            assert abs(error[2]) < 0.2
        else:
            assert np.isnan(dot.position_mm).all()


@pytest.mark.parametrize(
    "distance",
    [
        590.0,
        *(pytest.param(away, marks=pytest.mark.ci) for away in (392.0, 441.0, FOCUS, 514.0, 624.0)),
    ],
)
def test_without_noise_dots_are_where_they_are_cut_or_not_blurred_or_not(
    brute: Any, distance: float
) -> None:
    camera, offset = brute.camera(4.0, (640, 640)), np.array([0.21, -0.13])
    small = FourDot(diameter=0.8, spacing=3.0)
    scenes = [one_plane(camera, target, distance, (0.21, -0.13)) for target in (White(), small)]
    white, dots = (render(scene, tolerance=1e-4) * 3000 + 64 for scene in scenes)
    lattice = lattice_behind(camera, white, NOISE)
    errors: list[Array] = []
    depths: list[float] = []
    for dot in count_views(dots, white, lattice, camera, small, distance, NOISE):
        landed = brute.landings(camera, distance, small.centres[dot.dot] + offset)[1]
        errors += [
            centre - landed[int(np.argmin(np.hypot(*(landed - centre).T)))]
            for centre in dot.centres_px
        ]
        if dot.views >= 2:
            depths.append((dot.position_mm[2] + distance) / dot.uncertainty_mm[2])
    assert len(errors) >= 4
    assert np.sqrt(np.mean(np.square(errors))) < 3e-4
    assert np.abs(errors).max() < 1e-3
    assert np.all(np.abs(depths) < 0.2)  # of what the noise of one picture would make


def centre_errors(brute: Any, real: Camera, nominal: Camera, distance: float) -> list[Array]:
    """Dots' centres, without noise, less where the rays through the microlenses' middles land,
    px.
    """
    white, dots = (
        render(one_plane(real, target, distance), tolerance=3e-5) * 2700 + 64
        for target in (White(), TARGET)
    )
    errors: list[Array] = []
    for dot in count_views(
        dots, white, lattice_behind(nominal, white, NOISE), nominal, TARGET, distance, NOISE
    ):
        landed = brute.landings(real, distance, TARGET.centres[dot.dot])[1]
        errors += [
            centre - landed[int(np.argmin(np.hypot(*(landed - centre).T)))]
            for centre in dot.centres_px
        ]
    return errors


@pytest.mark.parametrize(
    ("f_number", "off_mm"),
    [
        (5.6, 0.005),
        *(
            pytest.param(n, off, marks=pytest.mark.ci)
            for n, off in ((4.0, 0.01), (4.0, -0.005), (5.6, -0.01))
        ),
    ],
)
def test_spots_show_by_themselves_that_the_frame_is_out_of_focus(
    brute: Any, f_number: float, off_mm: float
) -> None:
    """A gap that the camera file has wrong blurs spots that an aperture cuts to one side: they were
    taken for elsewhere, by 0.2 px.
    """
    nominal = brute.camera(f_number, (640, 640))
    camera = replace(
        nominal, sensor=replace(nominal.sensor, distance=nominal.sensor.distance + off_mm)
    )
    errors = centre_errors(brute, camera, nominal, FOCUS)
    assert len(errors) >= 4
    assert np.abs(errors).max() < 0.004


@pytest.mark.parametrize("distance", [507.0, pytest.param(506.4, marks=pytest.mark.ci)])
def test_less_than_a_tenth_of_a_pixel_out_of_focus_depth_is_as_near_the_truth_as_further_out(
    brute: Any, distance: float
) -> None:
    """Too few rays stood for a cone of so little blur: what cut spots said of the focus put all
    dots 0.014 mm off.
    """
    camera = brute.camera(5.6, (640, 640))
    white, dots = (
        render(one_plane(camera, target, distance), tolerance=1e-4) * 3000 + 64
        for target in (White(), TARGET)
    )
    lattice = lattice_behind(camera, white, NOISE)
    depths = [
        dot.position_mm[2]
        for dot in count_views(dots, white, lattice, camera, TARGET, distance, NOISE)
    ]
    assert np.abs(np.array(depths) + distance).max() < 0.005


@pytest.mark.ci
@pytest.mark.parametrize(
    ("array", "distance", "off_mm"),
    [(64.0, 507.0, 0.001), (64.0, 507.0, -0.001), (61.0, 560.0, 0.001)],
)
def test_an_array_elsewhere_blurs_whole_spots_too(
    brute: Any, array: float, distance: float, off_mm: float
) -> None:
    """Where no spot is cut, or few are, whole ones were taken for sharp or for less soft, and depth
    was 0.17 and 0.03 mm off.
    """
    like = brute.camera(3.2, (760, 560))
    behind = array - 1 / (1 / like.main_lens.focal_length - 1 / distance)
    gap = 1 / (1 / like.array.focal_lengths[0] - 1 / behind)
    nominal = replace(
        like,
        array=replace(like.array, distance=array),
        sensor=replace(like.sensor, distance=array + gap),
    )
    real = replace(
        like,
        array=replace(like.array, distance=array + off_mm),
        sensor=replace(like.sensor, distance=array + gap - off_mm),
    )
    errors = centre_errors(brute, real, nominal, distance)
    assert len(errors) >= 24
    assert np.abs(errors).max() < 0.002


@pytest.mark.ci
def test_behind_a_turned_array_near_focus_all_dots_stand_at_one_depth(brute: Any) -> None:
    """Micro-images left and right are blurred to either side of the focus, by a quarter of a pixel:
    two dots stood 0.04 mm off.
    """
    nominal = brute.camera(4.0, (760, 560))
    near = replace(nominal.sensor, distance=nominal.sensor.distance - 0.0007)
    real = replace(nominal, array=replace(nominal.array, tilt=(3.5e-3, 0.0)), sensor=near)
    white, dots = (
        render(one_plane(real, target, 507.0), tolerance=3e-5) * 2700 + 64
        for target in (White(), TARGET)
    )
    lattice = lattice_behind(nominal, white, NOISE)
    depths = [
        dot.position_mm[2]
        for dot in count_views(dots, white, lattice, nominal, TARGET, 507.0, NOISE)
    ]
    assert np.ptp(depths) < 0.002


@pytest.mark.parametrize(("f_number", "diameter"), [(4.0, 0.5), (4.0, 1.0), (5.6, 1.0), (5.6, 2.0)])
def test_dots_close_together_are_not_taken_for_one_another(
    brute: Any, f_number: float, diameter: float
) -> None:
    """Centroids took in the next dot's light up to 8 px beyond this one's edge: depth was up to 2.5
    mm off, or none was found.
    """
    fine, close = brute.camera(f_number, (320, 320)), FourDot(diameter, 1.5 * diameter)
    camera = replace(fine, sensor=replace(fine.sensor, pixel=4 * fine.sensor.pixel))
    white, dots = (
        render(one_plane(camera, target, FOCUS), tolerance=1e-4) * 2700 + 64
        for target in (White(), close)
    )
    lattice = lattice_behind(camera, white, NOISE)
    found = count_views(dots, white, lattice, camera, close, FOCUS, NOISE)
    assert np.abs([dot.position_mm[2] + FOCUS for dot in found]).max() < 0.05


def test_behind_a_turned_array_without_a_microlens_on_the_axis_dots_stand_where_they_are(
    brute: Any,
) -> None:
    """The nearest one stands half a pitch aside, 0.6 um along the axis, which was taken for the
    array's own place: 0.2 mm off.
    """
    straight = brute.camera(4.0, (980, 980))
    camera = replace(straight, array=replace(straight.array, count=(24, 24), tilt=(3e-3, 0.0)))
    white, dots = (
        render(one_plane(camera, target, FOCUS), tolerance=1e-4) * 2700 + 64
        for target in (White(), TARGET)
    )
    lattice = lattice_behind(camera, white, NOISE)
    found = count_views(dots, white, lattice, camera, TARGET, FOCUS, NOISE)
    assert np.abs([dot.position_mm[2] + FOCUS for dot in found]).max() < 0.01


@pytest.mark.parametrize(
    ("f_number", "distance"),
    [
        (4.0, 470.0),
        *(
            pytest.param(n, away, marks=pytest.mark.ci)
            for n, away in ((4.0, 450.0), (4.0, FOCUS), (4.0, 590.0), (2.8, 450.0))
        ),
    ],
)
def test_natural_fall_off_leaves_dots_where_they_are(
    brute: Any, f_number: float, distance: float
) -> None:
    """Less steep rays draw dots out of focus aside, by 0.13 mm of depth at 530 mm; what is left is
    that of nine micro-images' pitch, 2e-5.
    """
    camera = brute.camera(f_number, (640, 640))
    scenes = [
        replace(one_plane(camera, target, distance), falloff=Falloff())
        for target in (White(), TARGET)
    ]
    white, dots = (64.0 + 3000.0 * render(scene, tolerance=1e-4) for scene in scenes)
    found = count_views(
        dots,
        white,
        lattice_behind(camera, white, NOISE),
        camera,
        TARGET,
        distance,
        NOISE,
    )
    landed = np.concatenate(
        [brute.landings(camera, distance, TARGET.centres[dot.dot])[1] for dot in found]
    )
    centres = np.concatenate([dot.centres_px for dot in found])
    off = np.hypot(*(centres[:, None] - landed[None]).transpose(2, 0, 1)).min(axis=1)
    assert len(off) >= 16
    assert off.max() < 0.002
    deep = np.abs([dot.position_mm[2] + distance for dot in found])
    assert deep.max() < 0.04
    assert np.all(deep < [dot.uncertainty_mm[2] for dot in found])


def test_fall_off_is_taken_out_of_dark_pixels_as_of_bright_ones(brute: Any) -> None:
    """Only what noise let look bright was put right, and the focus of dim dots was a third of its
    uncertainty off.
    """
    camera = brute.camera(4.0, (640, 640))
    light = 3000 * render(
        replace(one_plane(camera, White(), FOCUS), falloff=Falloff()), tolerance=1e-3
    )
    lattice = lattice_behind(camera, 64 + light, NOISE)
    bright, dim = unshaded(64 + light, lattice, NOISE), unshaded(64 + light / 1000, lattice, NOISE)
    assert np.abs(bright - 64 - light).max() > 20
    np.testing.assert_allclose(1000 * (dim - 64), bright - 64, atol=0.05)


def test_how_depths_move_together_is_part_of_their_uncertainty(brute: Any) -> None:
    camera = brute.camera(4.0, (640, 640))
    rng = np.random.default_rng(3)
    white, dots = (
        brute.expose(render(one_plane(camera, target, FOCUS), tolerance=1e-3), NOISE, 3000, rng)
        for target in (White(), TARGET)
    )
    for dot in count_views(
        dots, white, lattice_behind(camera, white, NOISE), camera, TARGET, FOCUS, NOISE
    ):
        together = float(np.sqrt((dot.common_mm[2] ** 2).sum()))
        assert 0 < together < dot.uncertainty_mm[2]


@pytest.mark.ci
def test_a_gap_off_by_a_hundredth_does_not_lose_a_view(brute: Any) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    nominal = replace(
        camera, sensor=replace(camera.sensor, distance=camera.sensor.distance + 0.0115)
    )
    exact = counted(brute, camera, FOCUS, np.zeros(2), camera)
    off = counted(brute, camera, FOCUS, np.zeros(2), nominal)
    assert [dot.views for dot in off] == [dot.views for dot in exact]


def test_a_black_picture_is_refused_and_so_is_a_wrong_shape(brute: Any) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    white = brute.expose(white_of(brute, camera), NOISE, 3000, np.random.default_rng(1))
    lattice = lattice_behind(camera, white, NOISE)
    black = np.random.default_rng(1).normal(64, 2, white.shape)
    with pytest.raises(MeasurementError, match=r"no pattern of dots .* 0 % of the expected light"):
        count_views(black, white, lattice, camera, TARGET, FOCUS, NOISE)
    with pytest.raises(MeasurementError, match="shape"):
        count_views(black[1:], white, lattice, camera, TARGET, FOCUS, NOISE)
