# longer than 450 lines because one subject's sentences of behaviour stand together
"""Diffracted pictures against the scalar Fresnel integral summed from path lengths, against closed
forms, and against rays.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.special import j0, j1

from flflab.image.diffraction.form import add_plane_with_diffraction
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.motion import Motion
from flflab.image.geometry.setup import make_setup
from flflab.image.render import render
from flflab.image.scene import Plane, Scene, one_plane
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, pixel_positions
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, Target, White

pytestmark = pytest.mark.ci

Array = npt.NDArray[np.float64]
Nodes = tuple[Array, Array]

FOCUS = 506.7016
GREEN = 550e-6
CUTOFF = (
    2 * 0.168 / 1.15 * 1.66e-3 / GREEN
)  # cycles/pixel of the worked example's microlens: its aperture over the gap


MORE_PIXELS = [(FOCUS, (100, 100)), (FOCUS, (130, 120)), (FOCUS, (110, 158)), (495.0, (160, 110))]


def diffracted(
    scene: Scene,
    wavelength: float = GREEN,
    tolerance: float = 0.002,
    wanted: npt.NDArray[np.bool_] | None = None,
) -> Array:
    columns, rows = scene.camera.sensor.resolution
    image = np.zeros((rows, columns))
    plane = scene.planes[0]
    add_plane_with_diffraction(
        image, make_setup(scene, plane, tolerance), plane.target, wavelength, wanted
    )
    return image


@pytest.fixture(scope="module")
def lone(camera: Camera) -> Camera:
    """One microlens on the axis."""
    return replace(
        camera, array=replace(camera.array, count=(1, 1)), sensor=Sensor((200, 200), 0.00166, 61.15)
    )


def gauss(intervals: Array, detail: float) -> Nodes:
    """Quadrature nodes and weights over the intervals, pieces no longer than ``detail``."""
    places, weights = np.polynomial.legendre.leggauss(5)
    found: list[Array] = []
    for low, high in intervals:
        ends = np.linspace(low, high, max(2, math.ceil((high - low) / detail) + 1))
        half = np.diff(ends)[:, None] / 2
        found.append(
            np.stack([(ends[:-1, None] + half * (1 + places)).ravel(), (half * weights).ravel()])
        )
    return tuple(np.concatenate(found, axis=1))


def fresnel(
    camera: Camera,
    distance: float,
    column: int,
    row: int,
    x: Nodes,
    y: Nodes,
    lit: Array | None = None,
    falloff: float = 0.0,
    wavelength: float = GREEN,
) -> float:
    """A pixel of the lone microlens, by a sum over points of the microlens of exp(i k path) for
    points of the target, squared.

    The path from the sensor through a point q of the microlens to the target is stationary over the
    main lens; whether q counts is asked of the ray; a wave counts by the root of the cosine of its
    slope to the power ``falloff``. The pupil sum repeats itself over the target: nodes must stay
    within one period.
    """
    L, b, D = camera.array.distance, camera.sensor.distance - camera.array.distance, distance
    F, A, f, d = (
        camera.main_lens.focal_length,
        camera.main_lens.aperture,
        camera.array.focal_lengths[0],
        camera.array.aperture,
    )
    W = 1 / L - 1 / F + 1 / D
    count = 220
    step = d / count
    q = (np.arange(count) + 0.5) * step - d / 2
    k = 2 * math.pi / wavelength
    fine = q[:, None] + step * (np.arange(4) - 1.5) / 4
    across, up = (np.exp(-1j * k / (L * D * W) * np.outer(nodes[0], q)) for nodes in (x, y))
    positions = pixel_positions(camera.sensor)
    places, weights = np.polynomial.legendre.leggauss(3)
    total = 0.0
    for i in range(9):
        s = [
            float(positions[axis][at]) + places[part] * camera.sensor.pixel / 2
            for axis, at, part in ((0, column, i % 3), (1, row, i // 3))
        ]
        main = [fine - L * ((part - fine) / b + fine / f) for part in s]
        inside = (fine[:, None, :, None] ** 2 + fine[None, :, None, :] ** 2 <= d * d / 4) & (
            main[1][:, None, :, None] ** 2 + main[0][None, :, None, :] ** 2 <= A * A / 4
        )
        slope = (s[1] - q[:, None]) ** 2 + (s[0] - q) ** 2
        pupil = inside.mean(axis=(2, 3)) * (1 + slope / b**2) ** (-falloff / 4)
        path = [
            (q - part) ** 2 / (2 * b) - q**2 / (2 * f) + q**2 / (2 * L) - (q / L) ** 2 / (2 * W)
            for part in s
        ]
        field = up @ (pupil * np.exp(1j * k * (path[1][:, None] + path[0]))) @ across.T
        seen = np.abs(field) ** 2 * (1.0 if lit is None else lit)
        light = (
            float(y[1] @ seen @ x[1]) * (step / (wavelength * L * D * abs(W))) ** 2
        )  # over the light of all periods: the pupil's area
        total += weights[i % 3] * weights[i // 3] / 4 * light * step**2
    return total / (math.pi * d * d / 4)


def bar_nodes(target: Bars, detail: float) -> Nodes:
    edges = target.position(np.minimum(np.arange(0, 2 * target.cycles + 1) / 2, target.cycles))
    return gauss(np.stack([edges[0::2][: len(edges) // 2], edges[1::2]], axis=1), detail)


@pytest.mark.parametrize(
    ("distance", "pixel"),
    [
        (FOCUS, (50, 60)),
        (495.0, (100, 160)),
        *(pytest.param(*case, marks=pytest.mark.ci) for case in MORE_PIXELS),
    ],
)
def test_bars_are_the_fresnel_integral_over_the_clipped_pupil(
    lone: Camera, distance: float, pixel: tuple[int, int]
) -> None:
    """In the bright field, on the rim and at the upper border, in and out of focus."""
    target = Bars((1.0, 8.0), 8.0, 7.0)
    wanted = np.zeros((200, 200), dtype=np.bool_)
    wanted[pixel[1], pixel[0]] = True
    image = diffracted(one_plane(lone, target, distance), wanted=wanted)
    expected = fresnel(
        lone, distance, *pixel, bar_nodes(target, 0.1), gauss(np.array([[-3.5, 3.5]]), 0.1)
    )
    assert abs(image[pixel[1], pixel[0]] - expected) < 0.001
    assert image.sum() == image[pixel[1], pixel[0]]


@pytest.mark.parametrize(
    ("distance", "pixel"),
    [
        (FOCUS, (57, 70)),
        pytest.param(FOCUS, (66, 66), marks=pytest.mark.ci),
        pytest.param(495.0, (62, 72), marks=pytest.mark.ci),
    ],
)
def test_a_dot_is_the_fresnel_integral_over_the_clipped_pupil(
    lone: Camera, distance: float, pixel: tuple[int, int]
) -> None:
    target = FourDot(diameter=1.0, spacing=4.0)
    image = diffracted(one_plane(lone, target, distance))
    x = y = gauss(np.array([[-2.6, -1.4], [1.4, 2.6]]), 0.02)
    lit = target.radiance(x[0][None, :], y[0][:, None])
    assert abs(image[pixel[1], pixel[0]] - fresnel(lone, distance, *pixel, x, y, lit)) < 0.002


@pytest.mark.parametrize(
    "frequency",
    [6.0, pytest.param(1.0, marks=pytest.mark.ci), pytest.param(3.0, marks=pytest.mark.ci)],
)
def test_a_sine_in_focus_keeps_what_airy_and_pixel_leave_of_it(
    lone: Camera, frequency: float
) -> None:
    image = diffracted(
        one_plane(lone, Chirp((frequency, frequency), 30.0, 30.0), FOCUS), tolerance=1e-3
    )
    row = image[90:110, 70:130]
    cycles = frequency * 0.00166 / 0.0278179  # a pixel
    places = np.arange(70, 130)
    basis = np.stack(
        [np.ones(60), np.cos(2 * np.pi * cycles * places), np.sin(2 * np.pi * cycles * places)],
        axis=1,
    )
    mean, *wave = np.linalg.lstsq(basis, row.mean(axis=0), rcond=None)[0]
    u = cycles / CUTOFF
    airy = 2 / math.pi * (math.acos(u) - u * math.sqrt(1 - u * u))
    assert math.hypot(*wave) / mean == pytest.approx(airy * np.sinc(cycles), abs=1e-3)


def test_a_small_dot_is_the_airy_pattern(lone: Camera) -> None:
    """Through the pixel, whose sides are a third of the pattern's diameter."""
    image = diffracted(one_plane(lone, FourDot(0.01, 0.06), FOCUS))
    places, weights = np.polynomial.legendre.leggauss(6)
    u = np.arange(95, 105)[:, None] - 99.5 + places / 2
    radius = 0.005 * 0.0278179 / 0.00166
    centres = 0.03 * 0.0278179 / 0.00166 * np.array([[i, j] for i in (-1, 1) for j in (-1, 1)])
    expected = np.zeros((10, 10))
    for x, y in centres:
        z = math.pi * CUTOFF * np.hypot((u - x)[None, :, None, :], (u - y)[:, None, :, None])
        airy = math.pi * CUTOFF**2 / 4 * (2 * j1(z) / z) ** 2
        expected += math.pi * radius**2 * np.einsum("abij,i,j->ab", airy, weights, weights) / 4
    assert np.abs(image[95:105, 95:105] / expected.max() - expected / expected.max()).max() < 0.01


@pytest.mark.parametrize("tolerance", [1e-3, 3e-5])
def test_a_large_dot_is_the_hankel_integral_near_its_edge_and_far_from_it(
    lone: Camera, tolerance: float
) -> None:
    """The finer the tolerance, the farther its light counts, and a coarse and a fine field make it
    together.
    """
    dots = FourDot(diameter=3.0, spacing=30.0)
    scene = one_plane(lone, dots, FOCUS)
    scene = replace(
        scene, planes=(replace(scene.planes[0], offset=(15.0, 15.0)),)
    )  # one of them on the axis
    wanted = np.zeros((200, 200), dtype=np.bool_)
    columns = np.array([100, 112, 123, 124, 125, 126, 130, 140])
    wanted[100, columns] = True
    seen = diffracted(scene, tolerance=tolerance, wanted=wanted)[100, columns]
    radius = 1.5 * 0.0278179 / 1.66e-3
    places, weights = np.polynomial.legendre.leggauss(4)
    x = columns[:, None, None] - 99.5 + places / 2
    distance = np.hypot(x, 0.5 + places[:, None] / 2)
    nodes, shares = np.polynomial.legendre.leggauss(1500)
    frequency = CUTOFF / 2 * (1 + nodes)
    part = frequency / CUTOFF
    airy = 2 / math.pi * (np.arccos(part) - part * np.sqrt(1 - part**2))
    spectrum = (
        2 * math.pi * radius * j1(2 * math.pi * radius * frequency) * airy * CUTOFF / 2 * shares
    )
    light = j0(2 * math.pi * distance[..., None] * frequency) @ spectrum
    mean = (light * weights * weights[:, None]).sum(axis=(1, 2)) / 4
    assert np.abs(seen - mean).max() < tolerance


@pytest.mark.parametrize(
    "plane",
    [
        Plane(Edge(0.3), 500.0, offset=(0.2, 0.1), tilt=(0.1, -0.05)),
        Plane(Bars((0.5, 1.5), 6.0, 4.0), 500.0, roll=0.2),
        Plane(FourDot(1.0, 3.0), FOCUS),
    ],
    ids=["tilted edge", "bars", "dots"],
)
def test_a_moving_target_is_the_mean_of_standing_ones(lone: Camera, plane: Plane) -> None:
    """Over a drift of half a pixel and a vibration of a quarter of one: Gauss's two places of
    either.
    """
    camera = replace(lone, sensor=Sensor((16, 12), 0.00664, 61.15))
    moving = Scene(
        camera, (plane,), diffraction=Diffraction(GREEN), motion=Motion((0.12, 0.05), (0.03, -0.06))
    )
    ways = [
        drift * np.array([0.12, 0.05]) + sway * np.array([0.03, -0.06])
        for drift in (-0.5 / math.sqrt(3), 0.5 / math.sqrt(3))
        for sway in (-math.sqrt(0.5), math.sqrt(0.5))
    ]
    standing = replace(moving, motion=None)
    mean = np.zeros((12, 16))
    for way in ways:
        x, y = np.array(plane.offset) + way
        mean += render(
            replace(standing, planes=(replace(plane, offset=(float(x), float(y))),))
        ) / len(ways)
    assert np.abs(render(moving) - mean).max() < 0.002
    assert np.abs(render(standing) - mean).max() > 0.01


def test_white_stays_white(camera: Camera) -> None:
    assert np.array_equal(
        diffracted(one_plane(camera, White(), 490.0)), render(one_plane(camera, White(), 490.0))
    )


@pytest.mark.parametrize("distance", [FOCUS, 490.0])
def test_complementary_edges_add_up_to_white(lone: Camera, distance: float) -> None:
    both = diffracted(one_plane(lone, Edge(0.3), distance)) + diffracted(
        one_plane(lone, Edge(0.3 + math.pi), distance)
    )
    assert np.abs(both - render(one_plane(lone, White(), distance))).max() < 0.001


@pytest.mark.ci
def test_no_light_of_a_target_in_the_bright_field_is_lost(lone: Camera) -> None:
    target = Bars((2.0, 2.0), 0.5, 0.5)
    image, rays = (
        diffracted(one_plane(lone, target, FOCUS), tolerance=1e-3),
        render(one_plane(lone, target, FOCUS)),
    )
    assert image[60:140, 60:140].sum() == pytest.approx(
        rays.sum(), rel=0.04
    )  # the rest lies far out
    assert image.max() < rays.max()


@pytest.mark.parametrize("target", [Edge(0.2), Bars((1.0, 2.0), 200.0, 200.0)])
def test_short_waves_leave_the_picture_of_rays(lone: Camera, target: Target) -> None:
    scene = one_plane(lone, target, 480.0)
    rays = render(scene, tolerance=5e-4)
    errors = [
        float(np.abs(diffracted(scene, wavelength, tolerance=2e-3) - rays).max())
        for wavelength in (GREEN, GREEN / 8)
    ]
    assert errors[1] < 0.25 * errors[0]
    assert errors[1] < 0.03


@pytest.mark.parametrize("gap", [1.0, 1.017, 1.02, 1.03, 1.04])
def test_bars_in_short_waves_are_those_of_rays_on_rims_narrower_than_a_pixel(
    with_gap: Callable[[float], Camera], gap: float
) -> None:
    """Light there comes from one side of the pupil, which a blur of five pixels shows elsewhere."""
    scene = one_plane(with_gap(gap), Bars((0.15, 0.15), 70.0, 70.0), 1000.0)
    assert np.abs(diffracted(scene, GREEN / 128) - render(scene, tolerance=1e-4)).max() < 0.001


@pytest.mark.parametrize("cutoff", [80.0, 160.0])
def test_where_bars_end_short_waves_are_rays(lone: Camera, cutoff: float) -> None:
    """Half of what an edge loses to waves falls with them; between 40 frequencies a pixel's own was
    lost, 0.2 of white and more.
    """
    camera = replace(lone, sensor=Sensor((10, 10), 0.012, 61.15, offset=(0.1, 0.1)))
    scene = one_plane(camera, Bars((0.2, 0.2), 60.0, 7.0), FOCUS)
    waves = diffracted(scene, 0.336 * 0.012 / (1.15 * cutoff), tolerance=1e-3)
    assert np.abs(waves - render(scene, tolerance=1e-4)).max() < 0.16 / cutoff


def test_a_slow_chirp_in_focus_loses_contrast_by_the_wavelength(lone: Camera) -> None:
    """A sine far below the cutoff keeps 1 - 4 / pi of their ratio; that of the middle, 0.2
    cycles/mm, is all that the microlens sees.
    """
    scene = one_plane(lone, Chirp((0.1, 0.3), 120.0, 120.0), FOCUS)
    rays = render(scene, tolerance=1e-4)
    image = 1 / (1 / lone.main_lens.focal_length - 1 / FOCUS)
    pixel_there = lone.sensor.pixel * (lone.array.distance - image) / lone.gap * FOCUS / image
    for finer in (8, 16):
        lost = diffracted(scene, GREEN / finer, tolerance=1e-3) - rays
        due = 2 / math.pi * 0.2 * abs(pixel_there) / (finer * CUTOFF)
        assert np.abs(lost[60:140, 60:140]).max() == pytest.approx(due, rel=0.1)


@pytest.mark.parametrize(("width", "height"), [(36.0, 30.0), (200.0, 30.0), (200.0, 8.0)])
def test_the_mean_light_of_bars_lacks_what_the_airy_pattern_has_beyond_their_edges(
    lone: Camera, width: float, height: float
) -> None:
    """Rayleigh's J0^2 + J1^2 beyond the border in every direction; bars of two pixels' period leave
    no other trace in a mean.
    """
    b, away = lone.gap, lone.array.distance
    image = 1 / (1 / lone.main_lens.focal_length - 1 / FOCUS)
    scale = b / (away - image) * image / FOCUS
    bars = Bars((scale / 0.00332, scale / 0.00332), width, height)
    angle = (np.arange(20_000) + 0.5) / 20_000 * math.pi / 2
    border = np.minimum(width / np.cos(angle), height / np.sin(angle)) / 2 * scale
    v = 2 * math.pi * 0.168 / b * border / GREEN
    picture = diffracted(one_plane(lone, bars, FOCUS), tolerance=1e-4)
    assert 2 * picture[90:110, 60:140].mean() == pytest.approx(
        1 - float(np.mean(j0(v) ** 2 + j1(v) ** 2)), abs=3e-5
    )


@pytest.mark.ci
def test_a_picture_of_bars_is_the_bars(lone: Camera) -> None:
    bars = Bars((0.5, 0.5), width=8.0, height=8.0)
    column = (np.arange(400) + 0.5) / 50 - 4
    picture = Picture(np.tile(bars.radiance(column, 0.0), (400, 1)), 8.0)
    small = replace(lone, sensor=Sensor((120, 80), 0.00166, 61.15))
    difference = diffracted(one_plane(small, picture, 500.0), tolerance=4e-3) - diffracted(
        one_plane(small, bars, 500.0), tolerance=4e-3
    )
    assert np.abs(difference).max() < 0.004


def test_texels_wider_than_what_the_sensor_sees_of_them_are_there(lone: Camera) -> None:
    """The middle of a white texel is out of sight, and so are its ends."""
    picture = Picture(np.ones((2, 2)), 300.0)
    scene = Scene(lone, (Plane(picture, 495.0, offset=(70.0, 72.0)),))
    assert np.abs(diffracted(scene) - render(one_plane(lone, White(), 495.0))).max() < 0.002


def test_where_the_image_lies_on_the_array_rays_alone_count(camera: Camera) -> None:
    on_array = one_plane(camera, Edge(0.1), 300.0)  # 1/50 = 1/60 + 1/300
    assert np.array_equal(diffracted(on_array), render(on_array))


def fall_off_misses(
    camera: Camera, distance: float, pixel: tuple[int, int], wavelength: float, tolerance: float
) -> float:
    """By how much a pixel misses what fall-off takes of the Fresnel integral of bars."""
    target = Bars((1.0, 1.5), 8.0, 7.0)
    plain = one_plane(camera, target, distance)
    wanted = np.zeros(camera.sensor.resolution, dtype=np.bool_)
    wanted[pixel[1], pixel[0]] = True
    scenes = plain, replace(plain, falloff=Falloff())
    seen = [
        diffracted(scene, wavelength, tolerance, wanted)[pixel[1], pixel[0]] for scene in scenes
    ]
    nodes = bar_nodes(target, 0.1), gauss(np.array([[-3.5, 3.5]]), 0.1)
    due = [
        fresnel(camera, distance, *pixel, *nodes, falloff=power, wavelength=wavelength)
        for power in (0.0, 4.0)
    ]
    return float(abs(seen[1] - seen[0] - due[1] + due[0]))


@pytest.mark.parametrize(
    ("distance", "pixel"),
    [(FOCUS, (58, 131)), (480.0, (40, 60)), (480.0, (110, 20)), (470.0, (150, 150))],
)
def test_fall_off_weighs_every_wave_by_the_slope_of_its_ray(
    lone: Camera, distance: float, pixel: tuple[int, int]
) -> None:
    """In and out of focus, in the bright field and on the rim."""
    assert fall_off_misses(lone, distance, pixel, GREEN, 3e-4) < 2e-4


@pytest.mark.parametrize("wavelength", [0.002, 0.01])
@pytest.mark.parametrize(
    ("distance", "pixel"), [(FOCUS, (6, 9)), (470.0, (3, 12)), (400.0, (8, 8))]
)
def test_fall_off_weighs_long_waves_from_steep_directions(
    distance: float, pixel: tuple[int, int], wavelength: float
) -> None:
    """At F/2, where slopes are up to 0.4, in light whose Airy radius is up to three wide pixels: by
    the mean weight up to 0.005 off.
    """
    array = MicrolensArray("square", (1, 1), (0.4, 0.4), 0.39, (0.917,), 60.0)
    steep = Camera(MainLens(50.0, 2.0), array, Sensor((16, 16), 0.012, 61.15, offset=(0.12, 0.1)))
    assert fall_off_misses(steep, distance, pixel, wavelength, 3e-4) < 3e-4


def test_a_card_lets_diffraction_fade_with_the_rays_that_it_stops(lone: Camera) -> None:
    """As the card moves on, what diffraction changes in the picture does so little by little, also
    where its edge reaches new pixels.
    """
    camera = replace(lone, sensor=Sensor((16, 12), 0.00664, 61.15))

    def change(edge: float) -> Array:
        card = Plane(White(), 480.0, offset=(edge - 2.0, 0.0), size=(4.0, 4.0))
        scene = Scene(
            camera, (card, Plane(Bars((0.5, 1.5), 6.0, 4.0), FOCUS)), diffraction=Diffraction(GREEN)
        )
        return render(scene) - render(replace(scene, diffraction=None))

    changes = [change(edge) for edge in (-0.16, -0.14, -0.12, -0.10, -0.08)]
    assert np.abs(changes[0]).max() > 0.05
    assert np.abs(np.diff(changes, axis=0)).max() < 0.015


@pytest.mark.ci
def test_a_stopped_down_camera_is_softer(with_f_number: Callable[[float], Camera]) -> None:
    """At F/16 the main lens limits: the cutoff falls to the cone that it lets pass."""
    camera: Camera = replace(with_f_number(16.0), main_lens=MainLens(50.0, 32.0))
    sine = Chirp((2.0, 2.0), 30.0, 30.0)
    scene = one_plane(replace(camera, sensor=Sensor((31, 31), 0.00166, 61.15)), sine, FOCUS)
    row = diffracted(scene)[15, 5:26]
    cycles = 2.0 * 0.00166 / 0.0278179
    basis = np.stack(
        [np.ones(21), *(turn(2 * np.pi * cycles * np.arange(5, 26)) for turn in (np.cos, np.sin))],
        axis=1,
    )
    mean, *wave = np.linalg.lstsq(basis, row, rcond=None)[0]
    half_angle = (50 / 32) / 2 / (60 * 0.234923)
    u = cycles / (2 * half_angle * 1.66e-3 / GREEN)
    airy = 2 / math.pi * (math.acos(u) - u * math.sqrt(1 - u * u))
    assert math.hypot(*wave) / mean == pytest.approx(airy * np.sinc(cycles), abs=0.02)


def test_microlenses_nearly_alike_blur_an_edge_as_each_does_among_its_own() -> None:
    """Those that share a table of transfer functions must not share a blur that the tolerance can
    tell from theirs.
    """

    def seen(*focal_lengths: float) -> Array:
        kinds = (tuple(range(len(focal_lengths))),)
        array = MicrolensArray(
            "square", (2, 1), (0.2, 0.4), 0.16, focal_lengths, 60.0, pattern=kinds
        )
        camera = Camera(MainLens(50.0, 8.0), array, Sensor((220, 40), 0.00166, 61.15))
        return diffracted(one_plane(camera, Edge(0.2), 400.0), tolerance=2e-4)

    both, left, right = seen(0.917, 0.9173668), seen(0.917), seen(0.9173668)
    assert np.abs(left - right).max() > 1e-3
    assert np.abs(both - np.where(np.arange(220) < 110, left, right)).max() < 1e-4


def test_the_dark_beside_an_edge_is_as_dark_at_a_rough_tolerance(lone: Camera) -> None:
    """On the rim, too, where less of the pupil sends its tail there than in the middle."""
    scene = one_plane(lone, Edge(0.3), FOCUS)
    fine = diffracted(scene, tolerance=5e-4)
    assert np.abs(diffracted(scene, tolerance=0.02) - fine)[fine < 0.001].max() < 0.001


@pytest.mark.parametrize(
    "target", [Bars((1.0, 3.0), 6.0, 4.0), Picture(np.random.default_rng(3).random((12, 16)), 6.0)]
)
def test_a_small_sensor_sees_what_a_large_one_sees_there(lone: Camera, target: Target) -> None:
    """What is left out because no pixel looks there changes nothing that a pixel sees: near the
    target's border, across it, beyond it.
    """
    plane = Plane(target, 495.0, offset=(0.2, 0.3), roll=0.1, tilt=(0.05, -0.03))
    whole = diffracted(Scene(lone, (plane,)))
    assert (whole > 0.2).any()
    for column, row in ((80, 80), (90, 20), (90, 160), (30, 90), (150, 140)):
        offset = ((column + 7.5 - 99.5) * 0.00166, (row + 5.5 - 99.5) * 0.00166)
        small = replace(lone, sensor=replace(lone.sensor, resolution=(16, 12), offset=offset))
        seen = diffracted(Scene(small, (plane,)))
        assert np.abs(seen - whole[row : row + 12, column : column + 16]).max() < 0.0006, (
            column,
            row,
        )
