"""How far apart the micro-images of a white picture lie, roughly and without being told: to say
what is wrong where no lattice fits.
"""

import cv2
import numpy as np
import numpy.typing as npt

MOST = 512  # pixels of a side; larger pictures are averaged down
CLEAR = 0.1  # of the variance: how far the correlation must rise again
UNITS = {
    25.4: "inches and millimetres",
    10.0: "centimetres and millimetres",
    1000.0: "millimetres and micrometres",
    2.54: "inches and centimetres",
}
NEAR = 0.08  # of a ratio of units


def rough_pitch(picture: npt.NDArray[np.generic]) -> float | None:
    """Distance in px from a micro-image to its nearest neighbours, to some per cent: the nearest
    peak of the autocorrelation.

    Args:
        picture: any brightness, [row, col].

    Returns:
        None where nothing repeats.
    """
    factor = max(1, -(-max(picture.shape) // MOST))
    size = (picture.shape[1] // factor, picture.shape[0] // factor)
    if min(size) < 8:
        return None
    small = cv2.resize(picture.astype(np.float32), size, interpolation=cv2.INTER_AREA).astype(
        np.float64
    )
    small -= small.mean()
    padded = (2 * small.shape[0], 2 * small.shape[1])

    spectrum = np.fft.rfft2(small, padded)
    overlap = np.outer(np.arange(small.shape[0], 0, -1), np.arange(small.shape[1], 0, -1))
    correlation = (
        np.fft.irfft2(spectrum.real**2 + spectrum.imag**2, padded)[
            : small.shape[0], : small.shape[1]
        ]
        / overlap
    )
    if not correlation[0, 0] > 0:
        return None
    rows, columns = np.indices(small.shape)
    ring = np.rint(np.hypot(rows, columns)).astype(np.int64)
    reach = min(small.shape) // 2
    highest = np.full(reach, -np.inf)
    within = ring < reach
    np.maximum.at(highest, ring[within], correlation[within] / correlation[0, 0])
    falls = np.flatnonzero(np.diff(highest) > 0)
    if len(falls) == 0:
        return None
    valley = int(falls[0])
    peak = valley + int(np.argmax(highest[valley:] >= 0.7 * highest[valley:].max()))
    while peak + 1 < reach and highest[peak + 1] > highest[peak]:
        peak += 1
    return float(peak * factor) if highest[peak] > highest[valley] + CLEAR else None


def mixed_up_units(ratio: float) -> str | None:
    """The units whose sizes have this ratio or its inverse, to 8 %: one may have been written for
    the other.
    """
    return next(
        (
            names
            for size, names in UNITS.items()
            if min(abs(ratio / size - 1), abs(ratio * size - 1)) < NEAR
        ),
        None,
    )
