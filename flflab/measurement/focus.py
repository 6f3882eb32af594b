"""How sharp a picture is, as one figure to watch while something is adjusted by hand."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

APART = 2  # pixels: the next one behind the same colour filter


def focus_figure(
    picture: npt.NDArray[Any],
    offset_dn: float = 0.0,
    dn_per_electron: float = 0.0,
    read_noise_dn: float = 0.0,
) -> float:
    """How much neighbouring pixels differ, as a share of the mean brightness.

    F = sqrt(max(0, <dx^2> + <dy^2> - 4 <v>)) / <s>, with the signal s above the offset, its
    differences dx and dy over two columns and two rows, and the variance v = r^2 + g s that read
    noise r and the g DN of an electron's shot noise give it. It is the gradient energy of focus
    measures, normalised: twice the light leaves it as it is, and noise adds nothing on average. It
    compares pictures of the same thing only.

    Args:
        picture: shape (rows, columns), DN, three rows and columns at least.
        offset_dn: mean of a pixel in the dark.
        dn_per_electron: at the gain of the picture.
        read_noise_dn: standard deviation of a pixel in the dark.

    Returns:
        0 for a picture without structure or light.
    """
    signal = np.asarray(picture, dtype=np.float32) - np.float32(offset_dn)
    mean = float(signal.mean(dtype=np.float64))
    if mean <= 0:
        return 0.0
    energy = sum(
        float(np.mean(np.square(difference), dtype=np.float64))
        for difference in (signal[APART:] - signal[:-APART], signal[:, APART:] - signal[:, :-APART])
    )
    noise = 4 * (read_noise_dn**2 + dn_per_electron * mean)
    return math.sqrt(max(0.0, energy - noise)) / mean


def parabola_top(
    positions: npt.NDArray[np.float64], figures: npt.NDArray[np.float64]
) -> float | None:
    """Where figures are largest, by a parabola through the best and its neighbours; None where the
    best is the first or the last.

    Args:
        positions: shape (n,), rising or falling.
        figures: shape (n,), one at each position.
    """
    best = int(np.argmax(figures))
    if not 0 < best < len(figures) - 1:
        return None
    curvature, slope, _ = np.polyfit(
        positions[best - 1 : best + 2] - positions[best], figures[best - 1 : best + 2], 2
    )
    return (
        float(positions[best] - slope / (2 * curvature))
        if curvature < 0
        else float(positions[best])
    )
