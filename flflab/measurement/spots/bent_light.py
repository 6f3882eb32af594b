"""The light of a dot that diffraction has bent, tabulated: behind the whole pupil, and where main
lens and microlens cut it.

At e from the micro-image's centre the part P of the pupil sends light, |v| <= microlens disc and |v
- e| <= main lens disc, and by rays each of its points sees the dot at (e - spot) + beta v. By waves
a frequency of the dot keeps what the autocorrelation of P leaves of it, ``pupil_transfer``, up to a
cutoff that all spots share. White stays as bright as by rays, and the farther stop clips as a
shadow does. Source: docs/decisions/0011.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy.fft import irfft2
from scipy.special import j0, j1

from flflab.optics.diffraction import pupil_transfer

Array = npt.NDArray[np.float64]

LIGHT, BY_BLUR, BY_BENT, BY_RADIUS = range(4)
# cutoff times softness: with so soft edges rays come nearest to a dot that waves of that cutoff
# make
CYCLES = 2.8
SAMPLES = (3, 8)  # a pixel, least and most; two a cycle are due up to the cutoff
# the dot repeats itself after so many samples times half^(2/3), and half widths: its light falls as
# 1/r^3
REPEATS, LEAST_REPEATS = (
    57.0,
    4.0,
)
PLACES = 17  # in a micro-image, from where nothing is cut outwards: 33 move depth by 0.0004 mm
DIM = 0.85  # of the microlens's disc beyond the main lens's: a twentieth of the light is left there
NUDGE_PX = 0.02  # for derivatives
ROWS = 10  # of a pupil: they leave 5e-6 of the transfer
LEAST_PX = 1e-3  # of softness, for a cutoff


@dataclass(frozen=True)
class BentLight:
    """The light of a dot over that of white, and how it changes.

    Attributes:
        blur: geometric diameter of the blur, signed, px.
        bent: softness that diffraction adds to it: ``CYCLES`` over the cutoff, px.
        radius: of a spot in focus, px.
        first: distance from the micro-image's centre of the first place, px; nothing is cut up to
            there.
        spacing: from one place to the next, px.
        samples: a pixel.
        fields: by place; by way from the spot along the direction from the micro-image's centre,
            counted from the middle; by way across it; light, and its derivatives by blur, by
            softness and by radius. Shape (places, n, n // 2 + 1, 4).
    """

    blur: float
    bent: float
    radius: float
    first: float
    spacing: float
    samples: int
    fields: npt.NDArray[np.float32]


def bent_light(
    main: float, small: float, blur: float, bent: float, radius: float, half: int
) -> BentLight:
    """Tabulate the light for one blur, one softness and one radius.

    Args:
        main: radius of the main lens's disc, px.
        small: of the microlens's, px, in which ``blur`` is as wide as it is.
        blur: diameter of the geometric blur, signed, px.
        bent: softness that diffraction adds, px.
        radius: of a spot in focus, px.
        half: half width of the windows that it is for, px.
    """
    bent = max(bent, LEAST_PX)
    samples = min(max(math.ceil(2 * CYCLES / bent), SAMPLES[0]), SAMPLES[1])
    count = 2 * math.ceil(max(REPEATS * half ** (2 / 3), LEAST_REPEATS * half * samples) / 2)
    along, across = (
        np.fft.fftfreq(count, 1 / samples)[:, None],
        np.fft.rfftfreq(count, 1 / samples)[None, :],
    )
    frequency = np.maximum(np.hypot(along, across), 1e-9)
    # reading between samples along straight lines takes as much away
    kept = samples**2 / (np.sinc(along / samples) * np.sinc(across / samples)) ** 2
    dot, wider = (
        kept * radius * j1(2 * math.pi * radius * frequency) / frequency,
        kept * 2 * math.pi * radius * j0(2 * math.pi * radius * frequency),
    )

    def passed(place: float, blur: float, bent: float) -> npt.NDArray[np.complex128]:
        cutoff = CYCLES / bent
        # backward it is the conjugate, since the pupil is alike on both sides of the way outwards
        forward = frequency[: count // 2 + 1]
        low = forward < min(cutoff, samples / 2)
        f = forward[low]
        x, y = (
            place
            / small
            * np.broadcast_to(np.abs(part), frequency.shape)[: count // 2 + 1][low]
            / f
            for part in (along, across)
        )
        transfer = np.zeros(frequency.shape, dtype=np.complex128)
        transfer[: count // 2 + 1][low] = pupil_transfer(
            2 * f / cutoff, blur / 2 * f, x, -y, main / small, rows=ROWS
        )
        transfer[count // 2 + 1 :] = transfer[count // 2 - 1 : 0 : -1].conj()
        return transfer

    first = max(0.0, main - small)
    places = np.linspace(first, main + DIM * small, PLACES)
    fields = np.empty((PLACES, count, count // 2 + 1, 4), dtype=np.float32)

    def fill(field: npt.NDArray[np.float32], place: float) -> None:
        here = passed(place, blur, bent)
        by_blur, by_bent = (
            passed(place, blur + NUDGE_PX, bent) - here,
            passed(place, blur, bent + NUDGE_PX) - here,
        )
        spectra = (dot * here, dot * by_blur / NUDGE_PX, dot * by_bent / NUDGE_PX, wider * here)
        for kind, spectrum in enumerate(spectra):
            field[..., kind] = np.asarray(irfft2(spectrum, s=(count, count)))[:, : count // 2 + 1]

    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        list(pool.map(fill, fields, places))
    return BentLight(
        blur, bent, radius, first, places[1] - places[0], samples, np.fft.fftshift(fields, axes=1)
    )
