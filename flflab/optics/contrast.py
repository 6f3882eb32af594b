"""The three contrast curves of a view: the paper's, the pixel's, and what a picture should show.

Frequencies are cycles/mm on the target; u = nu pixel / M is the same in cycles per pixel. The
curves are those of first-order geometric optics; ``transfer`` adds diffraction where it is given a
wavelength.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.optics.focus import blur, magnification, microlens_limits
from flflab.optics.smms import Smms

Array = npt.NDArray[np.float64]
_HANKEL_FROM, _NODES = 25.0, 41


def contrast_paper(cycles_per_px: Array) -> Array:
    """Eq. (2) over all phases of resized square bars: 1 up to 1/2 cycle/pixel, then min(g, 1 - g)/u
    with g = u mod 1.
    """
    u = np.abs(cycles_per_px)
    part = np.mod(u, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(u <= 0.5, 1.0, np.minimum(part, 1 - part) / u)


def mtf_pixel(cycles_per_px: Array) -> Array:
    """Transfer of a square pixel without gaps: |sinc u|."""
    return np.abs(np.sinc(cycles_per_px))


def disc_transfer(diameter: Array | float, cycles_per_mm: Array) -> Array:
    """Transfer of a uniform disc of blur: 2 J1(z)/z with z = pi * diameter * frequency; negative
    where bars look reversed.

    Absolute error below 1e-15.
    """
    return _transfer_of_order(1, np.pi * np.abs(diameter * cycles_per_mm))


def dimming_disc_transfer(
    diameter: Array | float, cycles_per_mm: Array, loss: Array | float
) -> Array:
    """Transfer of a disc of blur whose light falls from 1 in the middle by 1 - loss (r / R)^2 to 1
    - loss at the rim.

    It is a uniform disc of light 1 - loss and one of light loss that falls to 0: the mean, by their
    shares of the light, of 2 J1(z)/z and 8 J2(z)/z^2 (Sonine's first integral, Abramowitz and
    Stegun 11.4.10 with mu = 0), z as in ``disc_transfer``. Absolute error below 2e-15.
    """
    z = np.pi * np.abs(diameter * cycles_per_mm)
    uniform, share = _transfer_of_order(1, z), loss / (2 - loss)
    return uniform + share * (_transfer_of_order(2, z) - uniform) if np.any(share) else uniform


def _transfer_of_order(order: int, z: Array) -> Array:
    """2^n n! Jn(z)/z^n, n the ``order``: the transfer of a disc of light (1 - (r / R)^2)^(n - 1).

    Up to z = 25 Poisson's integral of (1 - t^2)^(n - 1/2) cos(z t) over (-1, 1) by
    Gauss-Chebyshev's 41 nodes, exact to roundoff there; beyond, Hankel's asymptotic series
    (Abramowitz and Stegun 9.1.20, 25.4.40 and 9.2.5).
    """
    near = np.minimum(z, _HANKEL_FROM)
    angle = np.arange(1, _NODES // 2 + 1) * np.pi / (_NODES + 1)
    total = np.ones_like(near)  # the node at t = 0; the others come in equal pairs
    for weight, node in zip(2 * np.sin(angle) ** (2 * order), np.cos(angle), strict=True):
        total = total + weight * np.cos(near * node)
    norm = (
        math.gamma(order + 1) * math.sqrt(math.pi) / math.gamma(order + 0.5)
    )  # 2 of order 1, 8/3 of order 2
    total = total * (norm / (_NODES + 1))
    if np.all(z <= _HANKEL_FROM):
        return total
    far = np.maximum(z, _HANKEL_FROM)
    even, odd, term = np.ones_like(far), np.zeros_like(far), np.ones_like(far)
    for k in range(1, 17):
        term = term * ((4.0 * order**2 - (2 * k - 1) ** 2) / (8 * k)) / far
        if k % 2:
            odd = odd + (term if k % 4 == 1 else -term)
        else:
            even = even + (term if k % 4 == 0 else -term)
    phase = far - (0.5 * order + 0.25) * np.pi
    bessel = np.sqrt(2 / (np.pi * far)) * (even * np.cos(phase) - odd * np.sin(phase))
    return np.where(
        z <= _HANKEL_FROM, total, 2**order * math.factorial(order) * bessel / far**order
    )


def cone_half_angle(smms: Smms, vergence: Array | float) -> Array:
    """Half angle of the cone that the limiting stop leaves on the sensor, rad: d/(2 b) or A/(2 L
    |kappa|).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        by_lens = smms.lens_aperture / (2 * smms.distance * np.abs(smms.kappa))
        return np.where(microlens_limits(smms, vergence), smms.aperture / (2 * smms.gap), by_lens)


def far_light(half_angle: float, wavelength: float) -> float:
    """Light beyond a straight edge times the distance to its image, mm: wavelength/(pi^3
    half_angle), many pixels off.

    A round pupil's transfer function falls from 1 by (2/pi) wavelength/half_angle a cycle, focused
    or not, and a corner of height c at no frequency is light of c/(4 pi^2 r^3) far off: c/(2 pi^2
    a) beyond an edge at a.
    """
    return wavelength / (np.pi**3 * half_angle)


def lost_over_edges(away: Array, half_angle: float, wavelength: float) -> Array:
    """Share of the mean light that diffraction takes from a place on a target over its edges,
    beyond which it is dark.

    What ``far_light`` puts beyond each edge, less what lies beyond two of them, half as much times
    (a + b - hypot(a, b))/b.

    Args:
        away: distances on the sensor to the images of both edges across x, then of both across y,
            mm, many pixels each; shape (..., 4).
        half_angle: of the cone, see ``cone_half_angle``, rad.
        wavelength: of the light, mm.
    """
    a, b = away[..., :2, None], away[..., None, 2:]
    corners = (a + b - np.hypot(a, b)) / (2 * a * b)
    return far_light(half_angle, wavelength) * (
        (1 / away).sum(axis=-1) - corners.sum(axis=(-2, -1))
    )


def falloff_over_cone(smms: Smms, vergence: Array | float) -> Array:
    """By how much less than its middle the rim of a cone brings, whose axis meets the sensor
    upright: 1 - cos^4, 0 to 1.
    """
    return 1 - (1 + np.square(cone_half_angle(smms, vergence))) ** -2


def transfer(
    smms: Smms,
    vergence: Array | float,
    pixel: Array | float,
    cycles_per_mm: Array,
    *,
    wavelength: float | None = None,
    falloff: float = 0.0,
) -> Array:
    """What a picture shows of a sine on the target in the bright field: pixel times blur, signed.

    Args:
        smms: systems whose fields broadcast against ``cycles_per_mm``.
        vergence: 1/D of the target, 1/mm.
        pixel: pixel size, mm.
        cycles_per_mm: frequencies on the target.
        wavelength: of the light, mm: blur with diffraction at the limiting stop, see
            ``cone_half_angle``. None for rays alone.
        falloff: how much of natural fall-off there is, 1 in a real camera: the rim of the cone
            brings less light than its middle, so the disc of blur is the smaller. With waves it is
            left out, as simulated pictures leave it.

    Returns:
        Contrast of the image's fundamental over the target's; the MTF is its absolute value.
    """
    on_sensor = cycles_per_mm / magnification(smms, vergence)
    if wavelength is None:
        loss = falloff * falloff_over_cone(smms, vergence)
        return np.sinc(on_sensor * pixel) * dimming_disc_transfer(
            blur(smms, vergence), on_sensor, loss
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.abs(on_sensor) * wavelength / cone_half_angle(smms, vergence)
        waves = np.abs(on_sensor) * blur(smms, vergence) / 2
    passes = np.isfinite(shift) & np.isfinite(waves)  # an image without size holds no frequency
    from flflab.optics.diffraction import (
        pupil_transfer,
    )  # numba is loaded by those who ask for waves

    left = pupil_transfer(np.where(passes, shift, 2.0), np.where(passes, waves, 0.0)).real
    return np.sinc(np.where(passes, on_sensor, 0.0) * pixel) * left
