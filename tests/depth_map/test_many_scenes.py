"""Depth maps of the whole worked example, and of many scenes: how flat planes are, how wide the
hole beside a card is, and how much of the truth the stated sigmas hold.
"""

import numpy as np
import pytest
import ray_pictures as rays
from judged import judged, map_of, osinski, tilted_truth
from scipy.ndimage import gaussian_filter, map_coordinates

RANGE = 420.0, 640.0
WHOLE = 3664, 2748

pytestmark = [pytest.mark.full, pytest.mark.timeout(900)]


@pytest.mark.parametrize(("seed", "workmanship", "rms"), [(3, False, 0.15), (4, True, 0.18)])
def test_a_tilted_plane_has_its_slope(seed: int, workmanship: bool, rms: float) -> None:
    camera, slope = osinski(*WHOLE), float(np.tan(np.radians(25)))
    card = rays.plane(camera, 507.0, seed, slope=slope)
    found = map_of(camera, [card], seed, workmanship=workmanship, distances=RANGE)
    figures = judged(found, tilted_truth(found, 507.0, slope))
    assert figures.density >= 0.98, figures
    assert figures.rms <= rms, figures
    points = found.points()
    assert np.polyfit(points[:, 0], points[:, 2], 1)[0] == pytest.approx(slope, abs=0.001)


def test_stated_sigmas_hold_what_they_say_over_many_scenes_and_arrays() -> None:
    camera, every = osinski(1500, 1300), list[tuple[float, float, float]]()
    for distance in (480.0, 507.0, 540.0):
        for seed in range(8):
            card = rays.plane(camera, distance, 300 + seed)
            figures = judged(
                map_of(camera, [card], seed, workmanship=bool(seed % 2), distances=RANGE), distance
            )
            assert figures.density >= 0.94, figures
            every.append((figures.within_1, figures.within_2, figures.beyond_5))
    within_1, within_2, beyond_5 = np.mean(every, axis=0)
    assert 0.6 < within_1 < 0.78
    assert 0.91 < within_2 < 0.985
    assert beyond_5 <= 1e-3


@pytest.mark.parametrize(("seed", "workmanship"), [(2, False), (3, True)])
def test_a_card_before_a_plane_leaves_a_hole_and_no_wrong_plane(
    seed: int, workmanship: bool
) -> None:
    camera = osinski(*WHOLE)
    near = rays.plane(camera, 485.0, seed, size=(9.0, 8.0))
    far = rays.plane(camera, 530.0, 50 + seed)
    found = map_of(camera, [near, far], seed, workmanship=workmanship, distances=RANGE)
    x, y = np.meshgrid(*found.directions())
    inside = (np.abs(x * 485.0) < 4.5) & (np.abs(y * 485.0) < 4.0)
    truth = np.where(inside, 485.0, 530.0)
    figures = judged(found, truth)
    has = np.isfinite(found.disparity)
    assert np.mean(np.abs(found.distance - truth)[has] > 22.5) <= 1e-3
    assert figures.beyond_5 <= 2e-3, figures
    assert figures.density >= 0.96, figures


@pytest.mark.parametrize("workmanship", [False, True])
def test_total_focus_is_the_texture_slightly_blurred(workmanship: bool) -> None:
    camera = osinski(1500, 1300)
    card = rays.plane(camera, 507.0, 7)
    found = map_of(camera, [card], 7, workmanship=workmanship, distances=RANGE)
    x, y = np.meshgrid(*found.directions())
    texels = np.array([y, x]) * 507.0 / card.texel
    departures = [
        np.nanstd(
            found.focus
            - map_coordinates(
                gaussian_filter(card.texture, blur, mode="wrap"), texels, order=1, mode="grid-wrap"
            )
        )
        for blur in np.arange(0.5, 3, 0.25)
    ]
    assert min(departures) <= 0.02
