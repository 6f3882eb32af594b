"""The phase of a lattice's light shows where it bends, with no micro-image to be seen by itself."""

import math

import numpy as np
import pytest

from flflab.measurement.lattice.phase import displaced

PITCH = 17.0
SQUARE = PITCH * np.eye(2)
HEXAGONAL = PITCH * np.array([[1.0, 0.5], [0.0, math.sqrt(3) / 2]])


def bent(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A displacement of 12 px at the picture's far corner, none round its middle."""
    return np.stack([12 * ((x - 200) / 200) ** 3, 8 * ((y - 150) / 150) ** 3 * (x / 400)], axis=-1)


def lit(vectors: np.ndarray, sizes: list[float]) -> np.ndarray:
    """Waves of a bent lattice, of some sizes along its three directions, on bright ground."""
    y, x = np.indices((300, 400)).astype(float)
    away = np.stack([x - 200, y - 150], axis=-1) - bent(x, y)
    a, b = np.linalg.inv(vectors)
    light = np.full(x.shape, 50.0)
    for wave, size in zip((a, b, a + b), sizes, strict=True):
        light += size * np.cos(2 * math.pi * (away @ wave))
    return light


@pytest.mark.parametrize("vectors", [SQUARE, HEXAGONAL], ids=["square", "hexagonal"])
@pytest.mark.parametrize("sizes", [[3, 3, 3], [0.01, 3, 3], [3, 0.01, 3]], ids=["all", "b", "a"])
def test_displacements_are_found_though_one_direction_is_even(
    vectors: np.ndarray, sizes: list[float]
) -> None:
    span = np.arange(-12, 13)
    indices = np.stack(np.meshgrid(span, span, indexing="ij"), axis=-1).reshape(-1, 2)
    places = np.array([200.0, 150.0]) + indices @ vectors.T
    inside = np.all((places > 2 * PITCH) & (places < [400 - 2 * PITCH, 300 - 2 * PITCH]), axis=1)
    found, strong = displaced(lit(vectors, sizes), vectors, np.array([200.0, 150.0]), indices)
    # the phase is that at the straight lattice's place, where the light is the bent one's
    off = found[inside] - bent(*places[inside].T)
    assert strong[inside].all()
    assert np.sqrt(np.mean(off**2)) < 0.02 * PITCH
    assert np.abs(off).max() < 0.12 * PITCH


def test_what_is_dark_shows_no_phase() -> None:
    light = lit(SQUARE, [3, 3, 0])
    light[:, :120] = 50.0
    indices = np.stack(np.meshgrid(np.arange(-10, 9), np.arange(-7, 8)), axis=-1).reshape(-1, 2)
    _, strong = displaced(light, SQUARE, np.array([200.0, 150.0]), indices)
    x = 200 + PITCH * indices[:, 0]
    assert not strong[x < 120 - 2 * PITCH].any()
    assert strong[(x > 120 + 2 * PITCH) & (np.abs(indices[:, 1]) < 7)].all()
