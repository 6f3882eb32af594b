"""Dots far larger than what is looked at: cut where their light does not come from."""

import math
from dataclasses import replace

import numpy as np
import pytest

from flflab.image.diffraction.cut import clipped, cut_dots_spectrum
from flflab.image.diffraction.fields import dots_spectrum
from flflab.image.diffraction.form import add_plane_with_diffraction
from flflab.image.geometry.setup import make_setup
from flflab.image.scene import one_plane
from flflab.optics.camera import Camera, Sensor
from flflab.targets import Edge, FourDot, Target

CENTRES, RADII = np.array([[10.0, -5.0], [60.0, 70.0]]), np.array([30.0, 31.0])
EVERYWHERE = np.full(2, -1e3), np.full(2, 1e3)
FREQUENCIES = np.linspace(-0.3, 0.3, 31)


def test_dots_that_nothing_cuts_have_the_spectrum_of_discs() -> None:
    whole = cut_dots_spectrum(CENTRES, RADII, *EVERYWHERE, 0.3, FREQUENCIES, FREQUENCIES)
    discs = dots_spectrum(CENTRES, RADII, FREQUENCIES, FREQUENCIES)
    assert np.abs(whole - discs).max() < 1e-6 * np.abs(discs).max()


def test_a_cut_dot_has_the_spectrum_of_its_points() -> None:
    low, high = np.array([-10.0, -20.0]), np.array([35.0, 12.0])
    cut = cut_dots_spectrum(CENTRES, RADII, low, high, 0.3, FREQUENCIES, FREQUENCIES)
    count = 1500
    x, y = (low[axis] + (np.arange(count) + 0.5) / count * (high - low)[axis] for axis in (0, 1))
    inside = np.hypot((x - 10.0) / 30.0, (y[:, None] + 5.0) / 31.0) < 1
    waves = [np.exp(-2j * np.pi * FREQUENCIES[:, None] * places) for places in (x, y)]
    points = waves[1] @ inside @ waves[0].T * np.prod((high - low) / count)
    assert np.abs(cut - points).max() < 4e-6 * np.abs(points).max()


def test_the_parts_on_both_sides_of_a_cut_add_up_to_the_dot() -> None:
    (low, high), middle = EVERYWHERE, 17.3
    parts = [(low, np.array([middle, high[1]])), (np.array([middle, low[1]]), high)]
    both = sum(
        cut_dots_spectrum(CENTRES, RADII, *part, 0.5, FREQUENCIES, FREQUENCIES) for part in parts
    )
    whole = cut_dots_spectrum(CENTRES, RADII, low, high, 0.5, FREQUENCIES, FREQUENCIES)
    assert np.abs(both - whole).max() < 1e-9 * np.abs(whole).max()


@pytest.mark.parametrize(
    ("low", "high", "area"),
    [
        ((-3, -3), (0.5, 0.25), 0.25),
        ((0.25, 0.25), (0.75, 0.75), 0.125),
        ((2, 0), (3, 1), 0.0),
        ((-1, -1), (2, 2), 1.0),
        ((0, 0.25), (0.25, 0.5), 1 / 16),
    ],
    ids=["its lower part", "past a side", "outside", "around", "inside"],
)
def test_a_clipped_square_is_what_both_have_in_common(
    low: tuple[float, float], high: tuple[float, float], area: float
) -> None:
    square = np.array([[-0.5, 0.0], [0.5, 0.0], [0.5, 1.0], [-0.5, 1.0]])
    x, y = clipped(square, np.array(low), np.array(high)).reshape(-1, 2).T
    assert 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) == pytest.approx(area)


@pytest.mark.ci
@pytest.mark.parametrize("distance", [506.7016, 480.0], ids=["in focus", "blurred"])
def test_the_rim_of_a_dot_far_larger_than_the_view_is_an_edge(
    camera: Camera, distance: float
) -> None:
    """Across it; along it the rim bends away."""
    lone = replace(
        camera, array=replace(camera.array, count=(1, 1)), sensor=Sensor((120, 120), 0.00166, 61.15)
    )
    tolerance, dots = 1e-3, FourDot(diameter=300.0, spacing=800.0)
    to_rim = -(dots.spacing / 2 - dots.diameter / 2 / math.sqrt(2))

    def seen(target: Target, place: float) -> np.ndarray:
        scene = one_plane(lone, target, distance)
        plane = replace(scene.planes[0], offset=(place, place))
        image = np.zeros((120, 120))
        wanted = np.eye(120, dtype=np.bool_)
        add_plane_with_diffraction(
            image,
            make_setup(replace(scene, planes=(plane,)), plane, tolerance),
            target,
            550e-6,
            wanted,
        )
        return np.diag(image)

    of_dot, of_edge = seen(dots, to_rim), seen(Edge(math.pi / 4), 0.0)
    assert of_edge.max() - of_edge.min() > 0.2
    assert np.abs(of_dot - of_edge).max() < tolerance + 1e-4  # to which the rim bends
