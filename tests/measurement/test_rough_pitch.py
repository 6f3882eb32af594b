"""A picture of anything that repeats says how far apart it does, and a ratio of lengths what may
have been mixed up.
"""

import numpy as np
import pytest

from flflab.measurement.lattice.rough_pitch import mixed_up_units, rough_pitch


def discs(
    pitch: float,
    radius: float,
    shape: tuple[int, int],
    *,
    hexagonal: bool = False,
    angle: float = 0.0,
) -> np.ndarray:
    """Bright discs on a lattice, drawn by asking every pixel for the nearest centre."""
    rows, columns = np.indices(shape, dtype=float)
    x, y = (
        columns * np.cos(angle) + rows * np.sin(angle) + 3.3,
        rows * np.cos(angle) - columns * np.sin(angle) + 7.1,
    )
    a, b = (
        np.array([pitch, 0.0]),
        pitch * (np.array([0.5, 3**0.5 / 2]) if hexagonal else np.array([0.0, 1.0])),
    )
    j = np.rint(y / b[1])
    nearest = np.full(shape, np.inf)
    for row in (j - 1, j, j + 1):
        i = np.rint((x - row * b[0]) / a[0])
        nearest = np.minimum(nearest, np.hypot(x - i * a[0] - row * b[0], y - row * b[1]))
    return (nearest < radius).astype(float)


@pytest.mark.parametrize("hexagonal", [False, True])
@pytest.mark.parametrize(
    ("pitch", "shape"), [(12.0, (200, 260)), (41.3, (300, 400)), (245.0, (2748, 3664))]
)
def test_the_distance_of_neighbours_is_found_without_being_told(
    pitch: float, shape: tuple[int, int], hexagonal: bool
) -> None:
    picture = discs(pitch, 0.35 * pitch, shape, hexagonal=hexagonal, angle=0.04)
    noisy = 1000 * picture + 20 * np.random.default_rng(0).normal(size=shape)
    assert rough_pitch(noisy) == pytest.approx(pitch, rel=0.05, abs=1.0)


@pytest.mark.parametrize(
    "picture",
    [np.zeros((64, 64)), np.ones((4, 4)), np.random.default_rng(1).normal(size=(256, 256))],
)
def test_where_nothing_repeats_there_is_no_distance(picture: np.ndarray) -> None:
    assert rough_pitch(picture) is None


def test_a_ratio_of_units_is_named_and_no_other() -> None:
    assert mixed_up_units(25.1) == mixed_up_units(1 / 25.4) == "inches and millimetres"
    assert mixed_up_units(0.1) == "centimetres and millimetres"
    assert mixed_up_units(1.3) is None
