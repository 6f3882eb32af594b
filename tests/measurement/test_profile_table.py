"""The tabulated profile of a micro-image against the textbook's overlap of two discs, averaged over
pixels at many places.
"""

import numpy as np
import numpy.typing as npt
import pytest

from flflab.measurement.lattice.disc_light import VALUE, light_across

Array = npt.NDArray[np.float64]


def overlap(d: Array, a: float, b: float) -> Array:
    """Area common to discs of radii a > b over that of the smaller one."""
    d = np.clip(d, a - b, a + b)
    one, other = ((d * d + p * p - q * q) / (2 * d * p) for p, q in ((a, b), (b, a)))
    alpha, beta = np.arccos(np.clip(one, -1, 1)), np.arccos(np.clip(other, -1, 1))
    return (a * a * (alpha - np.sin(2 * alpha) / 2) + b * b * (beta - np.sin(2 * beta) / 2)) / (
        np.pi * b * b
    )


@pytest.mark.parametrize(("a", "b"), [(26.4, 6.8), (18.5, 4.7)])
def test_the_table_is_off_to_no_side_at_the_rim(a: float, b: float) -> None:
    """The rim is dark and known to 1e-5 of the light: off by as much to one side, outside radii
    were off by twice what is stated.
    """
    step, table = light_across(a, b)
    places, turns = (
        a + b + np.linspace(-0.5, 0.5, 41),
        np.linspace(0, np.pi / 4, 17)[:-1] + np.pi / 128,
    )
    r, theta = (grid[..., None, None] for grid in np.meshgrid(places, turns))
    fine = (np.arange(80) + 0.5) / 80 - 0.5
    seen = overlap(
        np.hypot(r * np.cos(theta) + fine[:, None], r * np.sin(theta) + fine), a, b
    ).mean(axis=(2, 3))
    entries = np.arange(len(table)) * step
    off = np.interp(places, entries, table[:, VALUE]) - seen.mean(axis=0)
    assert abs(off.mean()) < 2e-6
    assert np.abs(off).max() < 6e-5
