"""What crooked rays make of a picture when no card stops them, against rays refracted one by
one.
"""

from dataclasses import replace

import numpy as np
import pytest

from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.motion import Motion
from flflab.image.flat_target.moving import add_moving_plane
from flflab.image.geometry.setup import make_setup
from flflab.image.reference.pixels import trace_pixels
from flflab.image.render import render
from flflab.image.scene import ALL, Plane, Scene
from flflab.optics.camera import Camera, Sensor
from flflab.targets import Bars, Edge, FourDot, Picture, Target

TOLERANCE = 1e-4
SQUARES = Picture(np.random.default_rng(4).integers(0, 2, (40, 40)).astype(np.float64), 40.0)


def leaning(camera: Camera, target: Target, motion: Motion | None) -> Scene:
    """A target far out of focus on a card that leans so much that a blur's halves are unlike."""
    small = replace(camera, sensor=Sensor((40, 32), 0.005, 61.15))
    plane = Plane(target, 460.0, offset=(0.1, -0.2), roll=0.05, tilt=(0.45, -0.2))
    return Scene(small, (plane,), falloff=Falloff(), distortion=Distortion(0.05), motion=motion)


@pytest.mark.parametrize(
    ("target", "motion"),
    [
        pytest.param(Bars((0.8, 0.8), 30.0, 30.0), None, marks=pytest.mark.ci),
        (Edge(0.4), None),
        pytest.param(FourDot(0.9, 1.6), None, marks=pytest.mark.ci),
        pytest.param(SQUARES, None, marks=pytest.mark.ci),
        pytest.param(
            Bars((0.8, 0.8), 30.0, 30.0),
            Motion(drift=(0.05, 0.02), vibration=(-0.01, 0.03)),
            marks=pytest.mark.ci,
        ),
    ],
    ids=["bars", "edge", "dots", "picture", "moving bars"],
)
def test_rays_that_end_where_no_map_says_are_those_traced(
    camera: Camera, target: Target, motion: Motion | None
) -> None:
    scene = leaning(camera, target, motion)
    setup = make_setup(scene, scene.planes[0], TOLERANCE, ALL)
    straight = np.zeros((32, 40))
    add_moving_plane(straight, setup, target)
    told = render(scene, tolerance=TOLERANCE)
    pixels = np.argwhere(np.abs(told - straight) > 0.7 * np.abs(told - straight).max())[:2]
    traced, uncertainty = trace_pixels(scene, pixels[:, ::-1], wanted=TOLERANCE / 5)
    rows, columns = pixels.T
    assert np.all(np.abs(told[rows, columns] - traced) < TOLERANCE + 3 * uncertainty)
    assert np.all(
        np.abs(straight[rows, columns] - traced) > TOLERANCE + 3 * uncertainty
    )  # the map alone would not pass
