"""The fit of bars ends in the same place whatever noise, small errors of the start and however much
of the target each view sees.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.contrast.curve import fit_contrast
from flflab.measurement.lattice.nominal import nominal_lattice
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.targets import Bars, White

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(
    dn_per_electron=0.34125, read_noise_dn=1.02375, offset_dn=64.0, full_scale_dn=4095.0
)
RESOLUTION = (760, 560)
FOCUS = 506.7016


def seen_on_target(camera: Camera) -> tuple[float, float]:
    """Where a pixel of a view in focus looks, mm on the target a mm on the sensor: within a
    micro-image, and from one to the next.
    """
    away, gap, main = camera.array.distance, camera.gap, camera.main_lens.focal_length
    image = 1 / (1 / main - 1 / FOCUS)
    return (away - image) / gap * FOCUS / image, -FOCUS / (away + gap)


@pytest.mark.ci
@pytest.mark.parametrize(("off", "aside"), [(-2.0, 0.0), (2.0, 0.5), (0.0, -1.0)])
def test_a_target_not_where_it_is_said_to_be_gives_the_same_contrast(
    brute: Any, off: float, aside: float
) -> None:
    """Off along the axis and aside, mm: cycles of the finest bars."""
    camera = brute.camera(4.0, RESOLUTION)
    lattice = nominal_lattice(camera, 2730.0)
    _, bars = brute.bars_picture(camera, FOCUS, (0.5, 10.0), 20.0, shift=aside)
    picture = brute.expose(bars, NOISE, 2730, np.random.default_rng(1))
    curve = fit_contrast(picture, lattice, camera, Bars(), FOCUS + off, NOISE)
    sharp = np.sinc(curve.cycles_per_mm * seen_on_target(camera)[0] * camera.sensor.pixel)
    assert len(curve.contrast) >= 10
    assert np.abs(curve.contrast - sharp).max() < 1e-3


@pytest.mark.parametrize("height", [6.0, 8.0], ids="{:g} mm high".format)
def test_all_pixels_between_the_targets_upper_and_lower_edge_are_measured(
    brute: Any, height: float
) -> None:
    """Views of which the target fills a part say where it stands and how the light falls off along
    the bars.
    """
    camera = brute.camera(4.0, RESOLUTION)
    _, bars = brute.bars_picture(camera, FOCUS, (0.5, 10.0), 12.0)
    lattice = nominal_lattice(camera, 2730.0)
    curve = fit_contrast(
        64 + 2730 * bars, lattice, camera, Bars(width=12.0, height=height), FOCUS, NOISE
    )
    across, along = seen_on_target(camera)
    rows, columns = np.mgrid[: RESOLUTION[1], : RESOLUTION[0]]
    middle = (np.array(RESOLUTION) - 1) / 2 * camera.sensor.pixel
    well_within = 0.3  # mm: a pixel's blur, three pixels and a hundredth of the width
    due = 0
    for cx, cy in lattice.centres_px:
        x, y = columns - cx, rows - cy
        place = [
            (across * at + along * centre) * camera.sensor.pixel - along * off
            for at, centre, off in ((x, cx, middle[0]), (y, cy, middle[1]))
        ]
        on_target = (np.abs(place[0]) < 6.0 - well_within) & (
            np.abs(place[1]) < height / 2 - well_within
        )
        due += np.count_nonzero(on_target & (np.hypot(x, y) < lattice.inside_radius_px - 1))
    assert curve.pixels == pytest.approx(due, rel=0.03)


@pytest.mark.full
@pytest.mark.parametrize(
    ("described", "turned", "off", "distance"),
    [
        # one disc for views whose discs differ by 0.6 px is astray
        (
            (-math.tan(math.radians(0.2)), 0.0, 0.0),
            (-0.00454, 2.2e-5, 0.00106),
            (-0.00025, -0.001936),
            507.0396,
        ),
        # of the outer views the target fills a part
        (
            (0.0, math.tan(math.radians(0.2)), math.radians(1.0)),
            (3.3877e-4, 0.00335217, 0.01749326),
            (0.00068709, -0.00075595),
            507.024965,
        ),
    ],
    ids=["yaw", "pitch and roll"],
)
def test_no_draw_of_noise_loses_the_bars_behind_a_turned_array(
    brute: Any,
    described: tuple[float, float, float],
    turned: tuple[float, float, float],
    off: tuple[float, float],
    distance: float,
) -> None:
    """Each array is turned by yaw, pitch (tangents) and roll (rad); array and sensor stand off by
    so much, mm.
    """
    chart, nominal = Bars(width=12.0, height=8.0), brute.camera(4.0, RESOLUTION)
    array = replace(nominal.array, tilt=described[:2], roll=described[2], count=(7, 7))
    nominal = replace(nominal, array=array, sensor=replace(nominal.sensor, distance=61.1497694))
    moved = replace(array, tilt=turned[:2], roll=turned[2], distance=array.distance + off[0])
    real = replace(
        nominal,
        array=moved,
        sensor=replace(nominal.sensor, distance=nominal.sensor.distance + off[1]),
    )
    scenes = (one_plane(real, White(), distance), 3e-5), (one_plane(real, chart, distance), 5e-4)
    white, bars = (
        np.maximum(render(scene, tolerance=tolerance), 0.0) for scene, tolerance in scenes
    )
    lattice = lattice_behind(
        nominal, brute.expose(white, NOISE, 2755, np.random.default_rng(99)), NOISE
    )
    curves = []
    for seed in range(20):
        noisy = brute.expose(np.round(bars, 9), NOISE, 2755, np.random.default_rng(seed))
        curves.append(fit_contrast(noisy, lattice, nominal, chart, 507.0, NOISE))
        assert curves[-1].chi2_per_pixel < 1.5, seed
    same = np.array([curve.contrast for curve in curves])
    score = (same - same.mean(axis=0)) / np.array([curve.uncertainty for curve in curves])
    assert 1 / 3 < np.sqrt(np.mean(score**2)) < 1.2
