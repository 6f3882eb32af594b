"""Fall-off over the pupil in waves: against sums over its points, and against rays."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.diffraction.kinds import Kind
from flflab.image.diffraction.modes import find_modes
from flflab.image.diffraction.shading import FIT, ODD, Shading
from flflab.image.diffraction.smear import Smear
from flflab.image.diffraction.table import transfer_table
from flflab.image.diffraction.weighted import weighted_values
from flflab.image.effects.falloff import Falloff
from flflab.image.geometry.setup import make_setup
from flflab.image.render import render
from flflab.image.scene import Plane, Scene, in_light, one_plane
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars, Edge, FourDot, Picture, Target

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Weight = Callable[[Array, Array], Array]

WEIGHTS: tuple[Weight, ...] = (
    lambda t, u: t,
    lambda t, u: 2 * (t * t + u * u) - 1,
    lambda t, u: t * t - u * u,
    lambda t, u: u,
    lambda t, u: t * u,
)
GREEN = 550e-6
SLOPE, REACH, BLUR, CUTOFF = 6.0, 20.0, 4.0, 1.5
LARGE = Picture(np.random.default_rng(0).integers(0, 2, (9, 12)).astype(np.float64), 80.0)


@pytest.fixture
def kind() -> Kind:
    rims = np.array([[REACH - SLOPE, SLOPE, REACH, REACH + SLOPE]])
    still = Smear(np.zeros(2), np.zeros(2))
    return Kind(
        np.zeros(1, dtype=np.int64), np.ones(1), SLOPE, REACH, BLUR, CUTOFF, np.eye(2), rims, still
    )


def summed(distance: float, angle: float, frequency: float, count: int) -> ComplexArray:
    """Weighted share times transfer of the clipped pupil as sums over a grid of its points,
    ``count`` to a radius.
    """
    along = (np.arange(2 * count) + 0.5) / count - 1
    x, y = np.meshgrid(along, along)
    shift, toward, across = (
        2 * frequency / CUTOFF,
        np.array([np.cos(angle), np.sin(angle)]),
        np.array([-np.sin(angle), np.cos(angle)]),
    )
    points = [np.stack([x + half, y], axis=-1) for half in (-shift / 2, shift / 2)]
    inside = [
        (np.hypot(*p.transpose(2, 0, 1)) <= 1)
        & (np.hypot(*(p - distance / SLOPE * toward).transpose(2, 0, 1)) <= REACH / SLOPE)
        for p in points
    ]
    waves = np.exp(2j * np.pi * BLUR * frequency * x) * (inside[0] & inside[1]) / (count**2 * np.pi)
    return np.array(
        [
            np.sum(waves * sum(weight(p @ toward, p @ across) for p in points) / 2)
            for weight in WEIGHTS
        ]
    )


@pytest.mark.parametrize(
    ("node", "angle", "frequency"),
    [(0, 3, 11), (11, 20, 17), (11, 50, 25), (17, 33, 0), (20, 10, 7)],
)
def test_transfers_of_weighted_pupils_are_sums_over_their_points(
    kind: Kind, node: int, angle: int, frequency: int
) -> None:
    table = transfer_table(kind, 16.0, 24, 65)
    values, _ = weighted_values(table)
    nodes = table.band * (1 - np.cos(np.linspace(0, np.pi, values.shape[-1]))) / 2
    due = summed(
        float(table.radii[node]), float(table.angles[angle]), float(nodes[frequency]), 1500
    )
    assert np.abs(values[:, node, angle, frequency] - due).max() < 2e-5


@pytest.mark.parametrize("angle", [0.3, 1.9, -1.0])
def test_terms_of_weighted_pupils_add_up_to_their_transfers_in_any_direction(
    kind: Kind, angle: float
) -> None:
    """A point to the left of the frequency's direction sees what one to the right does,
    mirrored.
    """
    table, node, frequency = transfer_table(kind, 16.0, 24, 65), 11, np.array([0.05, 0.2, 0.4])
    modes = find_modes(table, 1.0, 1e-5, shading=Shading(FIT, (1.0,) * 6))
    base, beyond = modes.places(frequency)
    spectra = modes.fine[:, base] + beyond * (modes.fine[:, base + 1] - modes.fine[:, base])
    turned = np.where(
        modes.weights < ODD, np.cos(modes.orders * angle), np.sin(modes.orders * angle)
    ) * np.where(modes.orders % 2, 1j, 1.0)
    amounts = turned * (
        modes.radial[:, 2 * node - 1 : 2 * node + 2] @ np.array([1.0, 4.0, 1.0]) / 6
    )
    due = np.array([summed(float(table.radii[node]), angle, one, 500) for one in frequency]).T
    for index in range(len(WEIGHTS)):
        of_it = modes.weights == index + 1
        assert np.abs(amounts[of_it] @ spectra[of_it] - due[index]).max() < 2e-4


def steep(gap: float) -> Camera:
    """A corner of a micro-image at F/2, of wide pixels, where slopes are up to 0.4 a millimetre
    behind the array.
    """
    array = MicrolensArray("square", (1, 1), (0.4, 0.4), 0.39, (0.917,), 60.0)
    return Camera(
        MainLens(50.0, 2.0),
        array,
        Sensor((16, 16), 0.012, 60.0 + gap, offset=(0.12 * gap / 1.15, 0.1 * gap / 1.15)),
    )


def misses_of_waves(target: Target, distance: float, gap: float, tolerance: float) -> float:
    """By how much fall-off in waves so short that nothing bends differs from that of rays."""
    scene = Scene(steep(gap), (Plane(target, distance, offset=(-1.5, -1.2)),), falloff=Falloff())
    bent, plain = (in_light(one, GREEN / 64) for one in (scene, replace(scene, falloff=None)))
    by_waves = render(bent, tolerance=tolerance) - render(plain, tolerance=tolerance)
    by_rays = render(scene, tolerance=1e-4) - render(replace(scene, falloff=None), tolerance=1e-4)
    return float(np.abs(by_waves - by_rays).max())


@pytest.mark.ci
@pytest.mark.parametrize("distance", [400.0, 470.0])
@pytest.mark.parametrize(
    "target",
    [Edge(0.3), Bars((0.05, 0.3), 60.0, 40.0), LARGE, FourDot(6.0, 14.0)],
    ids=lambda target: target.kind,
)
def test_fall_off_over_a_blurred_pupil_is_that_of_rays_where_waves_are_short(
    target: Target, distance: float
) -> None:
    """By the weight's mean and the middle that it gives the pupil, up to 0.0054 of white off."""
    assert misses_of_waves(target, distance, 1.15, 1e-3) < 1e-3


@pytest.mark.ci
@pytest.mark.parametrize(
    "target", [Bars((0.05, 0.3), 60.0, 40.0), FourDot(6.0, 14.0)], ids=lambda target: target.kind
)
def test_fall_off_behind_a_rim_narrower_than_a_pixel_is_that_of_rays_where_waves_are_short(
    target: Target,
) -> None:
    """Pixels in the bright field are divided into fewer parts than those on the rim; by the mean up
    to 0.0065 of white off.
    """
    assert misses_of_waves(target, 400.0, 0.95, 1e-3) < 1e-3


@pytest.fixture
def lone(camera: Camera) -> Camera:
    """One microlens on the axis."""
    return replace(
        camera, array=replace(camera.array, count=(1, 1)), sensor=Sensor((200, 200), 0.00166, 61.15)
    )


@pytest.mark.ci
def test_fall_off_counts_by_the_mean_over_the_clipped_pupil(lone: Camera) -> None:
    plain = one_plane(lone, Edge(0.1), 506.7016)
    with_falloff = replace(plain, falloff=Falloff())
    lit = render(plain) > 0.5
    by_rays = render(with_falloff)[lit] / render(plain)[lit]
    bent, dimmed = (
        render(in_light(scene, GREEN), tolerance=0.002)[lit] for scene in (plain, with_falloff)
    )
    assert np.abs(dimmed / bent - by_rays).max() < 0.003


@pytest.mark.ci
@pytest.mark.parametrize(
    "target",
    [Bars((0.15, 0.15), 70.0, 70.0), Picture(np.random.default_rng(3).random((12, 16)), 70.0)],
)
def test_fall_off_over_a_blurred_pupil_turns_the_look_to_its_brighter_side(
    with_gap: Callable[[float], Camera], target: Target
) -> None:
    """In short waves pictures are those of rays."""
    camera = with_gap(1.03)
    sensor = replace(camera.sensor, resolution=(60, 60), offset=(15.2, 8.1))
    aside = replace(camera, array=replace(camera.array, offset=(15.0, 8.0)), sensor=sensor)
    scene = Scene(aside, (Plane(target, 1000.0, offset=(-250.0, -133.0)),), falloff=Falloff())
    waves, rays = (
        render(in_light(scene, GREEN / 128), tolerance=0.002),
        render(scene, tolerance=1e-4),
    )
    assert np.abs(waves - rays).max() < 0.002


@pytest.mark.ci
def test_fall_off_does_not_jump_where_a_rim_is_a_pixel_wide(lone: Camera) -> None:
    """Unlike microlenses share tables: one whose rim is a little wider must not be weighed by
    another rule.
    """
    scene = replace(one_plane(lone, Edge(0.1), 495.0), falloff=Falloff())
    rim = 2 * abs(make_setup(scene, scene.planes[0], 0.002).pupils.slope[0])

    def seen(width: float) -> Array:
        sensor = replace(lone.sensor, resolution=(24, 24), pixel=rim / width)
        return render(
            in_light(replace(scene, camera=replace(lone, sensor=sensor)), GREEN), tolerance=0.002
        )

    assert np.abs(seen(1.000001) - seen(0.999999)).max() < 1e-5
