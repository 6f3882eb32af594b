"""The three contrast curves of a view: the paper's, the pixel's, and what a picture should show.

Frequencies are cycles/mm on the target; u = nu pixel / M is the same in cycles per pixel. Diffraction is left out: these are
the curves of first-order geometric optics.
"""

import numpy as np
import numpy.typing as npt
from scipy.special import j1

from flflab.optics.focus import blur, magnification
from flflab.optics.smms import Smms

Array = npt.NDArray[np.float64]


def contrast_paper(cycles_per_px: Array) -> Array:
    """Eq. (2) over all phases of resized square bars: 1 up to 1/2 cycle/pixel, then min(g, 1 - g)/u with g = u mod 1."""
    u = np.abs(cycles_per_px)
    part = np.mod(u, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(u <= 0.5, 1.0, np.minimum(part, 1 - part) / u)


def mtf_pixel(cycles_per_px: Array) -> Array:
    """Transfer of a square pixel without gaps: |sinc u|."""
    return np.abs(np.sinc(cycles_per_px))


def disc_transfer(diameter: Array | float, cycles_per_mm: Array) -> Array:
    """Transfer of a uniform disc of blur: 2 J1(z)/z with z = pi * diameter * frequency; negative where bars look reversed."""
    z = np.pi * np.asarray(diameter) * cycles_per_mm
    small = np.abs(z) < 1e-4
    safe = np.where(small, 1.0, z)
    return np.where(small, 1 - z * z / 8, 2 * j1(safe) / safe)


def transfer(smms: Smms, vergence: Array | float, pixel: float, cycles_per_mm: Array) -> Array:
    """What a picture shows of a sine on the target in the bright field: pixel times blur, signed.

    Args:
        smms: systems whose fields broadcast against ``cycles_per_mm``.
        vergence: 1/D of the target, 1/mm.
        pixel: pixel size, mm.
        cycles_per_mm: frequencies on the target.

    Returns:
        Contrast of the image's fundamental over the target's; the MTF is its absolute value.
    """
    on_sensor = cycles_per_mm / magnification(smms, vergence)
    return np.sinc(on_sensor * pixel) * disc_transfer(blur(smms, vergence), on_sensor)
