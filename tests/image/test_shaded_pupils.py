"""Fall-off over the pupil in waves: against sums over its points."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.diffraction.kinds import Kind
from flflab.image.diffraction.modes import find_modes
from flflab.image.diffraction.shading import FIT, ODD, Shading
from flflab.image.diffraction.smear import Smear
from flflab.image.diffraction.table import transfer_table
from flflab.image.diffraction.weighted import weighted_values

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Weight = Callable[[Array, Array], Array]

WEIGHTS: tuple[Weight, ...] = (
    lambda t, u: t,
    lambda t, u: 2 * (t * t + u * u) - 1,
    lambda t, u: t * t - u * u,
    lambda t, u: u,
    lambda t, u: t * u,
)
SLOPE, REACH, BLUR, CUTOFF = 6.0, 20.0, 4.0, 1.5


@pytest.fixture
def kind() -> Kind:
    rims = np.array([[REACH - SLOPE, SLOPE, REACH, REACH + SLOPE]])
    still = Smear(np.zeros(2), np.zeros(2))
    return Kind(np.zeros(1, dtype=np.int64), np.ones(1), SLOPE, REACH, BLUR, CUTOFF, np.eye(2), rims, still)


def summed(distance: float, angle: float, frequency: float, count: int) -> ComplexArray:
    """Weighted share times transfer of the clipped pupil as sums over a grid of its points, ``count`` to a radius."""
    along = (np.arange(2 * count) + 0.5) / count - 1
    x, y = np.meshgrid(along, along)
    shift, toward, across = 2 * frequency / CUTOFF, np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    points = [np.stack([x + half, y], axis=-1) for half in (-shift / 2, shift / 2)]
    inside = [
        (np.hypot(*p.transpose(2, 0, 1)) <= 1) & (np.hypot(*(p - distance / SLOPE * toward).transpose(2, 0, 1)) <= REACH / SLOPE)
        for p in points
    ]
    waves = np.exp(2j * np.pi * BLUR * frequency * x) * (inside[0] & inside[1]) / (count**2 * np.pi)
    return np.array([np.sum(waves * sum(weight(p @ toward, p @ across) for p in points) / 2) for weight in WEIGHTS])


@pytest.mark.parametrize(("node", "angle", "frequency"), [(0, 3, 11), (11, 20, 17), (11, 50, 25), (17, 33, 0), (20, 10, 7)])
def test_transfers_of_weighted_pupils_are_sums_over_their_points(kind: Kind, node: int, angle: int, frequency: int) -> None:
    table = transfer_table(kind, 16.0, 24, 65)
    values, _ = weighted_values(table)
    nodes = table.band * (1 - np.cos(np.linspace(0, np.pi, values.shape[-1]))) / 2
    due = summed(float(table.radii[node]), float(table.angles[angle]), float(nodes[frequency]), 1500)
    assert np.abs(values[:, node, angle, frequency] - due).max() < 2e-5


@pytest.mark.parametrize("angle", [0.3, 1.9, -1.0])
def test_terms_of_weighted_pupils_add_up_to_their_transfers_in_any_direction(kind: Kind, angle: float) -> None:
    """A point to the left of the frequency's direction sees what one to the right does, mirrored."""
    table, node, frequency = transfer_table(kind, 16.0, 24, 65), 11, np.array([0.05, 0.2, 0.4])
    modes = find_modes(table, 1.0, 1e-5, shading=Shading(FIT, (1.0,) * 6))
    base, beyond = modes.places(frequency)
    spectra = modes.fine[:, base] + beyond * (modes.fine[:, base + 1] - modes.fine[:, base])
    turned = np.where(modes.weights < ODD, np.cos(modes.orders * angle), np.sin(modes.orders * angle)) * np.where(modes.orders % 2, 1j, 1.0)
    amounts = turned * (modes.radial[:, 2 * node - 1 : 2 * node + 2] @ np.array([1.0, 4.0, 1.0]) / 6)
    due = np.array([summed(float(table.radii[node]), angle, one, 500) for one in frequency]).T
    for index in range(len(WEIGHTS)):
        of_it = modes.weights == index + 1
        assert np.abs(amounts[of_it] @ spectra[of_it] - due[index]).max() < 2e-4
