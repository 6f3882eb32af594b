"""Tables of transfer functions, between their nodes, against the pupil itself."""

import numpy as np
import pytest

from flflab.image.diffraction.kinds import Kind
from flflab.image.diffraction.modes import ALL, Sieve, find_modes
from flflab.image.diffraction.smear import Smear
from flflab.image.diffraction.table import transfer_table
from flflab.optics.diffraction import pupil_transfer


@pytest.mark.parametrize(("blur", "cutoff"), [(0.0, 1.0), (3.0, 4.0), (15.0, 1.0), (60.0, 0.2)])
def test_an_unclipped_pupils_table_is_right_between_its_nodes(blur: float, cutoff: float) -> None:
    still = Smear(np.zeros(2), np.zeros(2))
    kind = Kind(
        np.zeros(1, dtype=np.int64),
        np.ones(1),
        5.0,
        20.0,
        blur,
        cutoff,
        np.eye(2),
        np.array([[15.0, 5.0, 20.0, 25.0]]),
        still,
    )
    modes = find_modes(transfer_table(kind, 16.0, 1, 1), 1.0, 1e-4)
    frequency = np.linspace(0, modes.band, 2001)[:-1]
    exact = pupil_transfer(2 * frequency / cutoff, blur * frequency, rows=40).real
    assert np.abs(modes.unclipped(frequency) - exact).max() < 5e-6


@pytest.mark.parametrize(
    ("sieve", "terms"),
    [(ALL, 2000), (Sieve(2.0, slow=False), 2000), (Sieve(2.0, slow=True), 200)],
    ids=["all waves", "fast ones", "slow ones"],
)
def test_a_clipped_pupils_terms_add_up_to_its_transfer_in_any_direction(
    sieve: Sieve, terms: int
) -> None:
    """To those of its waves that a Gaussian keeps, or does not; few terms make the slow ones."""
    slope, reach, blur, cutoff = 6.0, 20.0, 4.0, 1.5
    still = Smear(np.zeros(2), np.zeros(2))
    rims = np.array([[reach - slope, slope, reach, reach + slope]])
    kind = Kind(
        np.zeros(1, dtype=np.int64), np.ones(1), slope, reach, blur, cutoff, np.eye(2), rims, still
    )
    table = transfer_table(kind, min(16.0, 2 * sieve.band), 24, 129)
    modes = find_modes(table, 1.0, 1e-5, sieve)
    node, frequency = 11, np.linspace(0.01, min(1.4, 0.99 * sieve.band), 200)
    base, beyond = modes.places(frequency)
    spectra = modes.fine[:, base] + beyond * (modes.fine[:, base + 1] - modes.fine[:, base])
    clip = table.radii[node] / slope
    full = table.shares[node]
    for angle in (0.3, 1.9):
        turned = np.cos(modes.orders * angle) * np.where(modes.orders % 2, 1j, 1.0)
        amounts = (
            modes.radial[:, 2 * node - 1 : 2 * node + 2] @ np.array([1.0, 4.0, 1.0]) / 6
        )  # a cubic spline at its node
        exact = full * pupil_transfer(
            2 * frequency / cutoff,
            blur * frequency,
            clip * np.cos(angle),
            clip * np.sin(angle),
            reach / slope,
            rows=60,
        )
        behind_a_pixel = (
            sieve.keeps(frequency) * np.sinc(frequency) / 2
        )  # of half the full contrast
        assert np.abs(((turned * amounts) @ spectra - exact) * behind_a_pixel).max() < 1e-4
    assert len(modes.orders) < terms
