"""Targets that move during the exposure, against standing ones and against rays traced one by one
at scrambled moments of it.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.effects.motion import Motion
from flflab.image.flat_target.moments import places_of
from flflab.image.geometry.setup import make_setup
from flflab.image.geometry.tiles import shrink
from flflab.image.reference.pixels import trace_pixels
from flflab.image.render import render
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, Target

Array = npt.NDArray[np.float64]

PIXELS = 2
TOLERANCE = 0.002
CHECKS = Picture(np.indices((6, 8)).sum(axis=0) % 2 * 1.0, 0.5)


@pytest.fixture(scope="module")
def camera() -> Camera:
    array = MicrolensArray(
        layout="square",
        count=(5, 5),
        pitch=(0.125, 0.125),
        aperture=0.125,
        focal_lengths=(1.0,),
        distance=60.0,
    )
    return Camera(MainLens(50.0, 4.0), array, Sensor((60, 40), 0.00166, 61.15))


def mean_of_standing(scene: Scene, moments: Iterable[tuple[float, float]]) -> Array:
    """The mean picture at moments of the exposure: parts of the drift and of the vibration's
    amplitude.
    """
    (plane,), motion = scene.planes, scene.motion or Motion()
    ways = [
        even * np.array(motion.drift) + swing * np.array(motion.vibration) + plane.offset
        for even, swing in moments
    ]
    places = [replace(plane, offset=(float(x), float(y))) for x, y in ways]
    return np.mean(
        [
            render(replace(scene, planes=(place,), motion=None), tolerance=TOLERANCE)
            for place in places
        ],
        axis=0,
    )


@pytest.mark.parametrize(
    ("target", "distance", "drift"),
    [
        (Bars((3.0, 6.0), 8.0, 0.5), 506.7016, (0.2, -0.3)),
        pytest.param(Bars((3.0, 6.0), 8.0, 0.5), 480.0, (2.0, 2.0), marks=pytest.mark.ci),
        (Chirp((1.0, 2.0), 8.0, 0.4), 506.7016, (2.0, 2.0)),
        pytest.param(Edge(0.3), 480.0, (0.2, -0.3), marks=pytest.mark.ci),
    ],
)
def test_what_drifts_is_the_mean_of_standing_ones(
    camera: Camera, target: Target, distance: float, drift: tuple[float, float]
) -> None:
    scene = Scene(
        camera,
        (Plane(target, distance, (0.05, 0.2), roll=0.1, tilt=(0.05, -0.1)),),
        motion=Motion(drift),
    )
    even = (np.arange(200) + 0.5) / 200 - 0.5
    assert (
        np.abs(
            render(scene, tolerance=TOLERANCE) - mean_of_standing(scene, [(at, 0.0) for at in even])
        ).max()
        < TOLERANCE / 2
    )


@pytest.mark.parametrize("target", [FourDot(1.2, 1.5), CHECKS])
def test_rims_and_borders_that_move_are_the_mean_of_standing_ones(
    camera: Camera, target: Target
) -> None:
    scene = Scene(
        camera, (Plane(target, 500.0, (0.05, 0.2), roll=0.1),), motion=Motion((0.02, -0.03))
    )
    even = (np.arange(16) + 0.5) / 16 - 0.5
    moving, standing = (
        render(scene, tolerance=TOLERANCE),
        mean_of_standing(scene, [(at, 0.0) for at in even]),
    )
    assert np.abs(moving - standing).max() < TOLERANCE / 2


@pytest.mark.parametrize("target", [FourDot(1.2, 1.5), CHECKS])
@pytest.mark.parametrize(
    "vibration", [(0.008, -0.0122), (0.01, 0.005)], ids=["along-one-line", "across"]
)
def test_rims_and_borders_that_drift_and_tremble_are_the_mean_of_standing_ones(
    camera: Camera, target: Target, vibration: tuple[float, float]
) -> None:
    scene = Scene(
        camera,
        (Plane(target, 500.0, (0.05, 0.2), roll=0.1),),
        motion=Motion((0.02, -0.03), vibration),
    )
    phases = (np.arange(12) + 0.5) / 12
    standing = mean_of_standing(
        scene, [(even - 0.5, np.cos(np.pi * turn)) for even in phases for turn in phases]
    )
    assert np.abs(render(scene, tolerance=TOLERANCE) - standing).max() < TOLERANCE / 2


def test_drift_and_vibration_along_one_line_take_as_many_moments_as_one_of_them(
    camera: Camera,
) -> None:
    drift, vibration = Motion((0.3, -0.4)), Motion(vibration=(-0.15, 0.2))
    counts = [
        len(moments_of(camera, motion)[1])
        for motion in (drift, vibration, Motion(drift.drift, vibration.vibration))
    ]
    assert counts[2] <= np.sqrt(2) * max(counts[:2]) + 1


@pytest.mark.parametrize(
    "motion",
    [Motion((0.03, -0.04)), Motion(vibration=(0.02, 0.01)), Motion((0.03, -0.04), (0.02, 0.01))],
)
def test_moments_are_spread_as_widely_as_the_motion(camera: Camera, motion: Motion) -> None:
    """A drift d has the variance d^2 / 12, a sine of amplitude v one of v^2 / 2."""
    places, shares = moments_of(camera, motion)
    assert shares.sum() == pytest.approx(1.0)
    assert shares @ places == pytest.approx(0.0, abs=1e-5)
    spread = (
        np.outer(motion.drift, motion.drift) / 12 + np.outer(motion.vibration, motion.vibration) / 2
    )
    assert (places.T * shares) @ places == pytest.approx(spread, abs=0.01 * np.trace(spread))


def moments_of(camera: Camera, motion: Motion) -> tuple[Array, Array]:
    """Places of a target at 500 mm, mm, and shares of the exposure."""
    plane = Plane(CHECKS, 500.0)
    return places_of(make_setup(Scene(camera, (plane,), motion=motion), plane, TOLERANCE))


@pytest.mark.ci
def test_bars_that_drift_and_tremble_are_the_mean_of_standing_ones(camera: Camera) -> None:
    scene = Scene(
        camera,
        (Plane(Bars((3.0, 6.0), 8.0, 0.5), 506.7016, (0.05, 0.2), roll=0.1),),
        motion=Motion((0.15, -0.08), (0.05, 0.12)),
    )
    phases = (np.arange(24) + 0.5) / 24
    standing = mean_of_standing(
        scene, [(even - 0.5, np.cos(np.pi * turn)) for even in phases for turn in phases]
    )
    assert np.abs(render(scene, tolerance=TOLERANCE) - standing).max() < TOLERANCE


@pytest.mark.parametrize(
    "distance", [506.7016, pytest.param(495.0, marks=pytest.mark.full)], ids=["sharp", "blurred"]
)
def test_the_ends_of_bars_askew_tremble_along_themselves_while_they_drift(distance: float) -> None:
    """What moves across the lines does so at every height of their ends."""
    across, along = np.array([np.cos(0.3), np.sin(0.3)]), np.array([-np.sin(0.3), np.cos(0.3)])
    (drift_x, drift_y), (swing_x, swing_y) = 0.3 * across, 0.1 * along
    plane = Plane(Bars((2.0, 3.0), 1.2, 0.9), distance, (0.1, 0.03), roll=0.3)
    array = MicrolensArray(
        layout="square",
        count=(5, 5),
        pitch=(0.4, 0.4),
        aperture=0.336,
        focal_lengths=(0.917,),
        distance=60.0,
    )
    camera = Camera(MainLens(50.0, 4.0), array, Sensor((70, 60), 0.00166, 61.15))
    scene = Scene(camera, (plane,), motion=Motion((drift_x, drift_y), (swing_x, swing_y)))
    phases = (np.arange(24) + 0.5) / 24
    standing = mean_of_standing(
        scene, [(even - 0.5, np.cos(np.pi * turn)) for even in phases for turn in phases]
    )
    assert np.abs(render(scene, tolerance=TOLERANCE) - standing).max() < TOLERANCE / 2


@pytest.mark.parametrize(
    ("target", "distance", "motion"),
    [
        pytest.param(
            Bars((3.0, 6.0), 8.0, 0.5), 506.7016, Motion((0.2, 0.2)), marks=pytest.mark.full
        ),
        pytest.param(
            Chirp((1.0, 2.0), 8.0, 0.4), 480.0, Motion(vibration=(0.05, 0.1)), marks=pytest.mark.ci
        ),
        pytest.param(
            Edge(0.3), 506.7016, Motion((0.15, -0.08), (0.05, 0.12)), marks=pytest.mark.full
        ),
    ],
)
def test_lines_and_their_ends_that_move_are_those_traced(
    camera: Camera, target: Target, distance: float, motion: Motion
) -> None:
    scene = Scene(
        camera, (Plane(target, distance, (0.05, 0.2), roll=0.1, tilt=(0.05, -0.1)),), motion=motion
    )
    moving, standing = (
        render(one, tolerance=TOLERANCE) for one in (scene, replace(scene, motion=None))
    )
    changed = np.argsort(np.abs(moving - standing).ravel())[::-1][: 100 * PIXELS : 100]
    rows, columns = np.unravel_index(changed, moving.shape)
    traced, uncertainty = trace_pixels(
        scene, np.stack([columns, rows], axis=1), wanted=TOLERANCE / 2
    )
    assert (np.abs(moving[rows, columns] - traced) < TOLERANCE + 2 * uncertainty).all()
    assert uncertainty.max() < TOLERANCE / 2
    assert np.abs(standing[rows, columns] - traced).max() > 20 * TOLERANCE


def test_an_edge_that_moves_along_itself_does_not_change(camera: Camera) -> None:
    along = Motion((-0.3 * np.sin(0.2), 0.3 * np.cos(0.2)), (-0.1 * np.sin(0.2), 0.1 * np.cos(0.2)))
    scene = Scene(camera, (Plane(Edge(0.2), 495.0),), motion=along)
    assert np.abs(render(scene) - render(replace(scene, motion=None))).max() < 1e-9


def test_a_window_without_columns_and_rows_holds_no_wanted_pixels() -> None:
    left, right, bottom, top = shrink(np.ones((9, 9), dtype=np.bool_), 5, 3, 7, 2)
    assert left >= right
    assert bottom >= top
