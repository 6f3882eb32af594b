"""Depth maps of ray pictures: the distance that stands there, within what is stated, and no value
where nothing can be told.
"""

from dataclasses import replace

import numpy as np
import pytest
import ray_pictures as rays
from judged import at_virtual_depth, judged, map_of, osinski, raytrix_like

from flflab.depth_map.depth import map_of as map_of_prepared
from flflab.depth_map.depth import prepare
from flflab.depth_map.geometry import derivatives, disparity_of, distance_of, undistorted
from flflab.optics.camera import MainLens
from flflab.optics.distortion import BrownDistortion

RANGE = 420.0, 640.0


def test_distance_and_disparity_are_inverse_and_their_derivatives_are_differences() -> None:
    camera = osinski()
    away = np.array([400.0, 507.0, 900.0])
    delta = disparity_of(away, camera)
    assert distance_of(delta, camera) == pytest.approx(away, rel=1e-12)
    found = derivatives(delta, camera)
    step = 1e-5
    lens = replace(camera, main_lens=replace(camera.main_lens, focal_length=50 + step))
    gap = replace(camera, sensor=replace(camera.sensor, distance=camera.sensor.distance + step))
    further = replace(
        camera,
        array=replace(camera.array, distance=60 + step),
        sensor=replace(camera.sensor, distance=camera.sensor.distance + step),
    )
    for moved, slope in (
        (lens, found.by_focal_length),
        (gap, found.by_gap),
        (further, found.by_array_distance),
    ):
        assert (distance_of(delta, moved) - away) / step == pytest.approx(slope, rel=1e-3)
    assert (distance_of(delta + 1e-7, camera) - away) / 1e-7 == pytest.approx(
        found.by_disparity, rel=1e-3
    )


def test_distortion_is_taken_off_the_cloud() -> None:
    lens = MainLens(50.0, 4.0, 0.0, BrownDistortion((2e-4, -1e-6, 0.0), (1e-4, -5e-5)))
    true = np.array([[0.03, -0.02], [0.0, 0.05], [-0.04, 0.01]])
    away = np.array([400.0, 507.0, 900.0])
    image = 1 / (1 / 50.0 - 1 / away)[:, None]
    seen = -lens.distortion.displace(-true * image) / image if lens.distortion else true
    assert undistorted(seen, away, lens) == pytest.approx(true, abs=1e-9)
    assert undistorted(seen, away, MainLens(50.0, 4.0)) is seen


@pytest.mark.ci
@pytest.mark.timeout(300)
def test_a_blank_wall_has_no_depth() -> None:
    camera = replace(osinski(), sensor=replace(osinski().sensor, resolution=(540, 460), pixel=5e-3))
    wall = rays.Card(507.0, np.full((4, 4), 0.5), 1.0)
    found = map_of(camera, [wall], 1, workmanship=False, distances=RANGE, count=16)
    assert np.isfinite(found.disparity).sum() <= 1e-4 * found.seen.sum()
    assert [note.code for note in found.remarks].count("no-value") == 1


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "distance",
    [
        pytest.param(480.0, marks=pytest.mark.full),
        pytest.param(507.0, marks=pytest.mark.full),
        pytest.param(540.0, marks=pytest.mark.ci),
    ],
)
def test_a_textured_plane_stands_where_it_is_within_what_is_stated(distance: float) -> None:
    camera = osinski(1500, 1300)
    seed = round(distance)
    found = map_of(
        camera, [rays.plane(camera, distance, seed)], seed, workmanship=False, distances=RANGE
    )
    figures = judged(found, distance)
    assert abs(figures.bias) <= 0.1, figures
    assert figures.rms <= {480.0: 0.17, 507.0: 0.14, 540.0: 0.25}[distance], figures
    assert 0.98 <= figures.density <= 1, figures
    assert figures.within_2 >= 0.88, figures
    assert figures.beyond_5 <= 1e-3, figures


@pytest.mark.ci
@pytest.mark.timeout(300)
def test_a_pinholes_views_would_be_wrong_out_of_focus() -> None:
    camera = osinski(1500, 1300)
    built = rays.build(camera, None)
    raw, white = rays.pair(built, [rays.plane(camera, 540.0, 5)], 5, 64)
    bias = [
        judged(
            map_of_prepared(
                prepare(raw, camera, white, RANGE, cut_aperture=cut), camera, None, silent
            ),
            540.0,
        ).bias
        for cut in (True, False)
    ]
    assert abs(bias[1]) > 5 * abs(bias[0])


def silent(step: str, share: float) -> None:
    """Nobody looks."""


@pytest.mark.full
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("depth", "rms_percent"), [(2.5, 0.06), (3.5, 0.12), (5.0, 0.25), (8.0, None)]
)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_camera_of_three_focal_lengths_sees_depth(
    depth: float, rms_percent: float | None, seed: int
) -> None:
    camera = raytrix_like()
    distance = at_virtual_depth(camera, depth)
    card = rays.plane(camera, distance, seed)
    figures = judged(map_of(camera, [card], seed, workmanship=bool(seed % 2)), distance)
    assert figures.within_2 >= 0.9, figures
    if rms_percent is not None:
        assert abs(figures.bias) <= 0.001 * distance, figures
        assert figures.rms <= 0.01 * rms_percent * distance, figures


@pytest.mark.full
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("contrast", "most"), [(0.02, 1.0), (0.005, 0.0)])
def test_fading_texture_loses_values_and_not_their_truth(contrast: float, most: float) -> None:
    camera = osinski(1500, 1300)
    card = rays.plane(camera, 507.0, 2)
    faded = 0.5 + (card.texture - 0.5) * contrast / card.texture.std()
    found = map_of(camera, [replace(card, texture=faded)], 2, workmanship=False, distances=RANGE)
    assert found.density <= most
    if most:
        assert judged(found, 507.0).within_2 >= 0.9


@pytest.mark.full
@pytest.mark.timeout(600)
def test_hard_bars_are_covered_or_refused() -> None:
    camera = osinski(1500, 1300)
    bars = np.repeat(np.r_[np.ones(16), np.zeros(16)][None, :], 4, axis=0)
    found = map_of(
        camera, [rays.Card(507.0, bars, 0.5 / 32)], 2, workmanship=False, distances=RANGE
    )
    assert judged(found, 507.0).within_2 >= 0.9
