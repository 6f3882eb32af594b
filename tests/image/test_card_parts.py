"""Which parts of micro-images look where past cards, and that together they are the picture of
single rays.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.cards.parts import split, split_by_dots
from flflab.image.cards.single_rays import add_single_rays
from flflab.image.cards.windows import cards_of
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.motion import Motion
from flflab.image.geometry.setup import make_setup
from flflab.image.reference.rays import Path, landing
from flflab.image.render import render
from flflab.image.scene import ALL, Plane, Scene
from flflab.optics.camera import Camera, Sensor, microlens_centres, pixel_positions
from flflab.targets import Black, FourDot, Picture, White

Array = npt.NDArray[np.float64]


@pytest.mark.parametrize(
    "motion", [None, Motion(drift=(0.3, 0.1), vibration=(-0.1, 0.2))], ids=["still", "moving"]
)
def test_what_looks_into_a_dot_or_past_all_does_so_with_every_ray(
    camera: Camera, motion: Motion | None
) -> None:
    """Rays refracted one by one, thrown at random through small windows of pixels and the microlens
    before each.
    """
    dots = FourDot(2.0, 2.2)
    plane = Plane(dots, 490.0, offset=(0.2, -0.1), roll=0.2, tilt=(0.1, 0.0))
    scene = Scene(camera, (plane,), distortion=Distortion(0.01), motion=motion)
    setup = make_setup(scene, plane, 0.002, ALL)
    inside, across = split_by_dots(setup, plane, dots, scene.distortion)
    rng, lens = np.random.default_rng(3), camera.array
    centres = microlens_centres(lens)
    focal_length, gap, depth = (
        np.array([number]) for number in (lens.focal_lengths[0], camera.gap, lens.distance)
    )
    xs, ys = pixel_positions(camera.sensor)
    seen = np.zeros(camera.sensor.resolution[::-1], dtype=np.int64)
    for parts, told in ((inside, 2), (across, 1)):
        for left, right, low, high in parts.window:
            seen[low:high, left:right] = told
    half = camera.sensor.pixel / 2
    for row, column in rng.integers(0, seen.shape, (4000, 2)):
        at = np.array([xs[column], ys[row]]) + rng.uniform(-half, half, (300, 2))
        nearest = int(np.argmin(np.hypot(*(centres * (1 + camera.gap / lens.distance) - at[0]).T)))
        radius, angle = lens.aperture / 2 * np.sqrt(rng.random(300)), rng.uniform(0, 2 * np.pi, 300)
        through = centres[nearest] + radius[:, None] * np.stack(
            [np.cos(angle), np.sin(angle)], axis=1
        )
        _, crossing, slope = Path(
            centres[nearest], focal_length, gap, depth, camera.main_lens.focal_length
        ).slopes_and_crossing(at, through)
        moved = np.zeros((300, 2))
        if motion is not None:
            moved = (
                rng.uniform(-0.5, 0.5, (300, 1)) * motion.drift
                + rng.uniform(-1, 1, (300, 1)) * motion.vibration
            )
        place = landing(plane, scene.distortion, crossing, slope, moved)[
            np.hypot(*crossing.T) <= camera.main_lens.aperture / 2
        ]
        shines = dots.radiance(*place.T)
        if seen[row, column] == 2:
            assert shines.all()
        elif seen[row, column] == 0:
            assert not shines.any()
    assert min(np.count_nonzero(seen == told) for told in (0, 1, 2)) > 100


def cut_and_hidden(camera: Camera, motion: Motion | None = None, scale: float = 1.0) -> Scene:
    """Large dots, cut by their own card's sides; another card hides the dark between them, and its
    corners parts of dots.
    """
    near = Plane(
        Black(),
        502.0,
        offset=(0.3 * scale, -0.2 * scale),
        roll=0.5,
        size=(3.0 * scale, 0.5 * scale),
    )
    offset, size = (0.2 * scale, -0.1 * scale), (3.4 * scale, 2.8 * scale)
    dots = Plane(
        FourDot(1.6 * scale, 2.2 * scale),
        504.0,
        offset=offset,
        roll=0.2,
        tilt=(0.1, 0.0),
        size=size,
    )
    small = replace(camera, sensor=Sensor((90, 70), 0.00498 * scale, 61.15))
    return Scene(small, (near, dots), falloff=Falloff(), distortion=Distortion(0.01), motion=motion)


@pytest.mark.parametrize(
    "motion",
    [None, pytest.param(Motion(drift=(0.05, 0.02), vibration=(-0.01, 0.03)), marks=pytest.mark.ci)],
    ids=["still", "moving"],
)
def test_the_parts_of_dots_past_cards_are_together_what_single_rays_sum_up_to(
    camera: Camera, motion: Motion | None
) -> None:
    scene, tolerance = cut_and_hidden(camera, motion), 0.002
    plane, cards = scene.planes[1], cards_of(scene, 1)
    setup, singly = make_setup(scene, plane, tolerance, ALL), np.zeros((70, 90))
    parts = split(setup, plane, scene.distortion, cards)
    assert motion is not None or parts.shadow
    assert motion is not None or all(
        len(some.blur) > 0
        for some in (parts.clear, *(before for before, _ in (*parts.light, *parts.shadow)))
    )
    add_single_rays(singly, setup, plane, scene.distortion, cards)
    assert np.abs(render(scene, tolerance=tolerance) - singly).max() < tolerance
    assert singly.max() > 0.9


def test_dots_past_cards_in_waves_too_short_to_bend_are_those_in_rays(camera: Camera) -> None:
    scene, tolerance = cut_and_hidden(camera), 0.004
    short = replace(scene, diffraction=Diffraction(1e-6))
    assert (
        np.abs(render(short, tolerance=tolerance) - render(scene, tolerance=tolerance)).max()
        < tolerance
    )


def cut_squares(camera: Camera, motion: Motion | None = None) -> Scene:
    """A picture of black and white squares whose card's sides cut them."""
    squares = Picture(np.random.default_rng(2).integers(0, 2, (12, 12)).astype(np.float64), 6.0)
    small = replace(camera, sensor=Sensor((30, 26), 0.00332, 61.15))
    return Scene(small, (Plane(squares, 500.0, size=(3.0, 2.5)),), motion=motion)


def mean_of_standing(scene: Scene, moments: int, tolerance: float) -> Array:
    """The mean picture at so many moments of the exposure; targets drift or tremble, not both."""
    (plane,), motion = scene.planes, scene.motion or Motion()
    turns = (np.arange(moments) + 0.5) / moments
    ways = (turns - 0.5)[:, None] * motion.drift + np.cos(np.pi * turns)[:, None] * motion.vibration
    places = [replace(plane, offset=(float(x), float(y))) for x, y in ways]
    return np.mean(
        [
            render(replace(scene, planes=(place,), motion=None), tolerance=tolerance)
            for place in places
        ],
        axis=0,
    )


def test_a_picture_cut_by_its_own_card_that_trembles_far_is_the_mean_of_standing_ones(
    camera: Camera,
) -> None:
    """One moment and two agreed by chance in some pixels, which were up to 7.7 tolerances off."""
    scene, tolerance = cut_squares(camera, Motion(vibration=(0.0, 0.5))), 0.01
    assert (
        np.abs(render(scene, tolerance=tolerance) - mean_of_standing(scene, 40, tolerance)).max()
        < tolerance
    )


@pytest.mark.parametrize(
    "motion", [Motion((0.1, 0.0)), Motion((0.2, 0.0), (0.0, 0.1))], ids=["a little", "far"]
)
def test_a_moving_picture_past_its_own_card_in_waves_too_short_to_bend_is_that_in_rays(
    camera: Camera, motion: Motion
) -> None:
    """Rays are taken away from waves and must have moved as these have, by few moments or by
    many.
    """
    scene, tolerance = cut_squares(camera, motion), 0.03
    short = replace(scene, diffraction=Diffraction(1e-6))
    assert (
        np.abs(render(short, tolerance=tolerance) - render(scene, tolerance=tolerance)).max()
        < tolerance
    )


@pytest.mark.ci
def test_waves_of_a_picture_past_its_own_card_move_as_it_does(camera: Camera) -> None:
    scene, tolerance = (
        replace(cut_squares(camera, Motion((0.2, 0.0))), diffraction=Diffraction(800e-6)),
        0.03,
    )
    assert (
        np.abs(render(scene, tolerance=tolerance) - mean_of_standing(scene, 16, tolerance)).max()
        < tolerance
    )


def test_waves_of_dots_are_what_they_were_where_a_card_stops_no_ray(camera: Camera) -> None:
    """Light bends into the dark beside a dot as well, and where a card hides some of the dark."""
    scene, tolerance = (
        replace(cut_and_hidden(camera, scale=0.25), diffraction=Diffraction(800e-6)),
        0.004,
    )
    near, dots = scene.planes[0], replace(scene.planes[1], size=None)
    white = replace(dots, target=White())
    with_card, without = (
        render(replace(scene, planes=planes), tolerance=tolerance)
        for planes in ((near, dots), (dots,))
    )
    hidden, whole = (
        render(replace(scene, planes=planes, diffraction=None), tolerance=1e-4)
        for planes in ((near, white), (white,))
    )
    clear = (np.abs(hidden - whole) < 1e-9) & (whole > 0)
    bent = without - render(replace(scene, planes=(dots,), diffraction=None), tolerance=tolerance)
    assert np.count_nonzero(clear & (np.abs(bent) > 5 * tolerance)) > 20
    assert np.abs(with_card - without)[clear].max() < tolerance
