"""White pictures behind microlenses of several focal lengths: each kind has a microlens's disc of
its own, d |1 + b/L - b/f|.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flflab.alignment import attitude_of
from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.lattice.with_camera import lattice_behind, white_behind
from flflab.measurement.measure import measure
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import White

NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
TILT = (0.0003, -0.0004)
FOCAL = (0.58267, 0.52402, 0.56057)
CAMERA = Camera(
    MainLens(49.885, 4.0),
    MicrolensArray(
        "hexagonal",
        (30, 30),
        (0.12744, 0.12744),
        0.12744,
        FOCAL,
        56.866,
        pattern=((0, 1, 2), (1, 2, 0)),
        tilt=TILT,
    ),
    Sensor((420, 420), 0.0055, 57.1971),
)


def discs_px(focal: float) -> tuple[float, float]:
    """Radii of the main lens's shadow and of the microlens's, on the axis, by similar triangles."""
    away, gap = 56.866, 57.1971 - 56.866
    return 49.885 / 4 * gap / away / 2 / 0.0055, 0.12744 * abs(
        1 + gap / away - gap / focal
    ) / 2 / 0.0055


@pytest.mark.ci
@pytest.mark.parametrize("falling", [False, pytest.param(True, marks=pytest.mark.ci)])
def test_every_kind_has_its_own_discs_and_the_tilt_is_found(brute: Any, falling: bool) -> None:
    scene = one_plane(CAMERA, White(), 900.0)
    light = render(replace(scene, falloff=Falloff()) if falling else scene, tolerance=5e-4)
    found = white_behind(CAMERA, brute.expose(light, NOISE, 3000, np.random.default_rng(1)), NOISE)
    lattice, white = found.lattice, found.white
    np.testing.assert_allclose(lattice.tilt, TILT, atol=4 * lattice.tilt_uncertainty.max())
    for kind, focal in enumerate(FOCAL):  # a tilt widens as many as it narrows
        radii = np.median(found.radii_px[white.usual & (found.kind == kind)], axis=0)
        np.testing.assert_allclose(radii, discs_px(focal), atol=0.006)


@pytest.mark.ci
def test_the_attitude_of_an_array_of_several_kinds_is_told_by_each_kind_s_own_radii(
    brute: Any,
) -> None:
    """Taken for one kind, their radii left 3,000 to 15,000 times the noise and turned an array by 4
    mrad.
    """
    white = brute.expose(
        render(one_plane(CAMERA, White(), 900.0), tolerance=1e-4),
        NOISE,
        3000,
        np.random.default_rng(1),
    )
    lattice = lattice_behind(CAMERA, white, NOISE)
    found = attitude_of(lattice)
    for (angle, doubt), due in zip(found.angles.values(), (0.0, *np.arctan(TILT)), strict=True):
        assert doubt < 1e-4
        assert abs(angle - due) < 4 * doubt


@pytest.mark.full
def test_where_kinds_are_taken_for_one_the_centres_alone_tell_the_attitude(brute: Any) -> None:
    """The third kind's disc is wider than the main lens's, so a larger radius may be of either: by
    radii 2.3 of what is stated off.
    """
    mixed = replace(CAMERA, array=replace(CAMERA.array, focal_lengths=(0.58267, 0.52402, 0.2)))
    white = brute.expose(
        render(one_plane(mixed, White(), 900.0), tolerance=1e-4),
        NOISE,
        3000,
        np.random.default_rng(1),
    )
    lattice = lattice_behind(mixed, white, NOISE)
    found = attitude_of(lattice)
    for (angle, doubt), due in zip(found.angles.values(), (0.0, *np.arctan(TILT)), strict=True):
        assert abs(angle - due) < 2 * doubt


@pytest.mark.ci
def test_nothing_is_left_out_of_a_white_picture_of_several_kinds(brute: Any) -> None:
    white = brute.expose(
        render(one_plane(CAMERA, White(), 900.0), tolerance=5e-4),
        NOISE,
        3000,
        np.random.default_rng(1),
    )
    measured = measure(white, CAMERA, noise=NOISE)
    assert measured["remarks"] == []
    off = [
        one["outside_radius_px"] - one["model"]["outside_radius_px"]
        for one in measured["lattice"]["micro_images"]
        if one["outside_radius_px"] is not None
    ]
    assert abs(np.mean(off)) < 0.005
