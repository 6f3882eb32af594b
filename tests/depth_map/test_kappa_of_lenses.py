"""How strongly each microlens refracts, by the width of its edge in the white picture."""

import numpy as np
import numpy.typing as npt
import pytest
from judged import osinski

from flflab.depth_map.lenses import Lenses, WhiteLenses, lenses_on_array

EDGES = 1 + 0.05 * np.linspace(-1.5, 1.5, 35)


def stand(edges: npt.NDArray[np.float64]) -> Lenses:
    """Microlenses in a row whose edges are so wide, over what the camera file makes them."""
    count = len(edges)
    place = np.stack([200.0 + 246 * np.arange(count), np.full(count, 500.0)], axis=1)
    index = np.stack([np.arange(count), np.zeros(count, dtype=np.int64)], axis=1)
    white = WhiteLenses(
        index, place, np.full(count, 0.01), edges, np.ones(count), np.zeros(count, dtype=np.int64)
    )
    return lenses_on_array(white, osinski())


def test_few_lenses_that_are_stronger_by_chance_are_seen_to_be() -> None:
    found = stand(0.98 * EDGES)
    assert found.kappa_factor == pytest.approx(0.98 * EDGES, rel=0.005)
    assert 0.003 < found.kappa_doubt <= 0.005


def test_edges_that_something_else_softens_count_by_their_ratios() -> None:
    found = stand(1.3 * EDGES)
    assert found.kappa_factor == pytest.approx(EDGES, rel=1e-9)
    assert found.kappa_doubt == pytest.approx(1.25 * 0.05 * 0.88 / 35**0.5, rel=0.4)


def test_lenses_all_alike_are_those_of_the_camera_file() -> None:
    found = stand(np.full(35, 1.004))
    assert found.kappa_factor == pytest.approx(np.ones(35), abs=1e-4)
    assert found.kappa_doubt < 1e-4
