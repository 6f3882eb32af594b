"""How often the stated 95 % intervals hold the truth: lattice and dots measured again and again in
new noise of fixed seeds.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.dots.views import count_views
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import FourDot, White

Array = npt.NDArray[np.float64]

NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
SHAPE, PITCH, ANGLE, ORIGIN, RADII = (90, 112), 24.0, 0.03, (57.3, 46.6), (8.0, 2.5)
CAMERA = Camera(
    MainLens(50.0, 4.0),
    MicrolensArray("square", (25, 25), (0.4, 0.4), 0.336, (0.917,), 60.0),
    Sensor((SHAPE[1], SHAPE[0]), 0.4 * (1 + 1.15 / 60) / PITCH, 61.15),
)  # whose discs are about as large
LEVEL = 3000.0  # 10,000 electrons: 1 %


def lattice_scores(brute: Any, repeats: int) -> Array:
    """Errors over stated uncertainties: pitch, angle, origin, inside, outside, a centre in the
    corner, and light; shape (repeats, 9).
    """
    image = brute.white_picture(SHAPE, "square", PITCH, ANGLE, ORIGIN, *RADII)
    vectors = brute.vectors_of("square", PITCH, ANGLE)
    rng = np.random.default_rng(11)
    scores = np.zeros((repeats, 9))
    for n in range(repeats):
        found = lattice_behind(CAMERA, brute.expose(image, NOISE, LEVEL, rng), NOISE)
        corner = int(np.argmin(np.hypot(*found.centres_px.T)))
        i, j = np.rint(np.linalg.solve(vectors, found.centres_px[corner] - ORIGIN))
        move = np.concatenate(
            [np.eye(2), found.indices[corner, 0] * np.eye(2), found.indices[corner, 1] * np.eye(2)],
            axis=1,
        )
        doubt = np.sqrt(np.diag(move @ found.covariance_px @ move.T))
        scores[n, 0] = (found.pitch_px - PITCH) / found.pitch_uncertainty_px
        scores[n, 1] = (found.angle - ANGLE) / found.angle_uncertainty
        scores[n, 2:4] = (found.origin_px - ORIGIN) / found.origin_uncertainty_px
        scores[n, 4] = (
            found.inside_radius_px - (RADII[0] - RADII[1])
        ) / found.inside_uncertainty_px
        scores[n, 5] = (found.outside_radius_px - sum(RADII)) / found.outside_uncertainty_px
        scores[n, 8] = (found.light[0] - LEVEL) / found.light_uncertainty_dn
        scores[n, 6:8] = (found.centres_px[corner] - ORIGIN - vectors @ [i, j]) / doubt
    return scores


def dot_scores(brute: Any, places: int, repeats: int, electrons: float) -> tuple[Array, Array]:
    """Errors over stated uncertainties of centres, shape (n, 2), and of positions in space, shape
    (m, 3).

    Every picture of dots in new noise, five of them after each new white picture.
    """
    camera, target = brute.camera(4.0, (640, 640)), FourDot(diameter=0.8, spacing=3.0)
    noise = SensorNoise(3000.0 / electrons, 2.0, 64.0, 4095.0)
    rng = np.random.default_rng(12)
    centres: list[Array] = []
    positions: list[Array] = []
    for _ in range(places):
        offset, blurred = (
            rng.uniform(-0.4, 0.4, 2),
            1 / rng.uniform(1 / 624, 1 / 420),
        )  # up to 20 px wide
        distance = float(rng.choice([506.7016, rng.uniform(498, 516), blurred]))
        scene = [
            one_plane(camera, kind, distance, (float(offset[0]), float(offset[1])))
            for kind in (White(), target)
        ]
        white, dots = (render(one, tolerance=5e-5) for one in scene)
        lattice = lattice_behind(camera, brute.expose(white, noise, LEVEL, rng), noise)
        for n in range(repeats):
            if n % 5 == 4:
                lattice = lattice_behind(camera, brute.expose(white, noise, LEVEL, rng), noise)
            for dot in count_views(
                brute.expose(dots, noise, LEVEL, rng),
                lattice,
                camera,
                target,
                distance,
                noise,
            ):
                true = target.centres[dot.dot] + offset
                landed = brute.landings(camera, distance, true)[1]
                for centre, doubt in zip(dot.centres_px, dot.centre_uncertainty_px, strict=True):
                    centres.append(
                        (centre - landed[int(np.argmin(np.hypot(*(landed - centre).T)))]) / doubt
                    )
                if dot.views >= 2:
                    positions.append((dot.position_mm - [*true, -distance]) / dot.uncertainty_mm)
    return np.array(centres), np.array(positions)


def covered(scores: Array) -> Array:
    """Share of intervals of 95 % that hold the truth, column by column."""
    return np.mean(np.abs(scores) < 1.959964, axis=0)


@pytest.mark.full
def test_intervals_of_the_lattice_cover(brute: Any) -> None:
    share = covered(lattice_scores(brute, 100))
    print(f"pitch, angle, origin, inside, outside, corner, light {share}")
    assert np.all(share > 0.95 - 4 * math.sqrt(0.95 * 0.05 / 100)), share


@pytest.mark.full
@pytest.mark.parametrize("electrons", [1e4, 1e3])
def test_intervals_of_dots_cover(brute: Any, electrons: float) -> None:
    centres, positions = (covered(one) for one in dot_scores(brute, 4, 15, electrons))
    print(f"centres {centres}, positions {positions}")
    # 960 centres and 240 positions, but those of one picture share its law and lattice
    off = 4 * np.sqrt(2 * 0.95 * 0.05 / np.array([960, 240]))
    # each lens's own centre counts how lenses are built, and this array is perfect
    assert np.all((centres > 0.95 - off[0]) & (centres < 0.995)), centres
    assert np.all(np.abs(positions - 0.95) < off[1]), positions
