"""Which parts of micro-images look where: held against rays that are refracted one by one."""

import numpy as np
import pytest

from flflab.image.card_parts import split_by_dots
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.motion import Motion
from flflab.image.scene import ALL, Plane, Scene
from flflab.image.setup import make_setup
from flflab.image.traced_rays import Path, landing
from flflab.optics.camera import Camera, microlens_centres, pixel_positions
from flflab.targets import FourDot


@pytest.mark.parametrize("motion", [None, Motion(drift=(0.3, 0.1), vibration=(-0.1, 0.2))], ids=["still", "moving"])
def test_what_looks_into_a_dot_or_past_all_does_so_with_every_ray(camera: Camera, motion: Motion | None) -> None:
    """Rays refracted one by one, thrown at random through small windows of pixels and the microlens before each."""
    dots = FourDot(2.0, 2.2)
    plane = Plane(dots, 490.0, offset=(0.2, -0.1), roll=0.2, tilt=(0.1, 0.0))
    scene = Scene(camera, (plane,), distortion=Distortion(0.01), motion=motion)
    setup = make_setup(scene, plane, 0.002, ALL)
    inside, across = split_by_dots(setup, plane, dots, scene.distortion)
    rng, lens = np.random.default_rng(3), camera.array
    centres = microlens_centres(lens)
    focal_length, gap, depth = (np.array([number]) for number in (lens.focal_lengths[0], camera.gap, lens.distance))
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
        through = centres[nearest] + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        _, crossing, slope = Path(centres[nearest], focal_length, gap, depth, camera.main_lens.focal_length).slopes_and_crossing(
            at, through
        )
        moved = np.zeros((300, 2))
        if motion is not None:
            moved = rng.uniform(-0.5, 0.5, (300, 1)) * motion.drift + rng.uniform(-1, 1, (300, 1)) * motion.vibration
        place = landing(plane, scene.distortion, crossing, slope, moved)[np.hypot(*crossing.T) <= camera.main_lens.aperture / 2]
        shines = dots.radiance(*place.T)
        if seen[row, column] == 2:
            assert shines.all()
        elif seen[row, column] == 0:
            assert not shines.any()
    assert min(np.count_nonzero(seen == told) for told in (0, 1, 2)) > 100
