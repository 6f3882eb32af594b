"""Pictures whose darkness is cut at 0: half of the noise of dark pixels is lost, and with it the
zero from which light counts.

Files without a black level hold such pictures. On average a dark pixel reads too much then, 0.4
standard deviations, one in dim light less, and the rim of every total field is drawn inwards. Where
zeros read instead what the noise below them is on average, dark pixels are right on average and dim
ones to a twentieth of a standard deviation.
"""

import math
from dataclasses import replace

import numpy as np

from flflab.measurement.sensor.mosaic import Mosaic

BLOCK = 8  # pixels to a side
LEAST, MOST = (
    0.2,
    0.98,
)  # share of zeros in dark blocks: with fewer little is cut, with more there is no noise


def mend_darkness(mosaic: Mosaic) -> Mosaic | None:
    """The picture with its zeros where they are on average, and its noise with the offset 0; None
    where its darkness is not cut.

    Args:
        mosaic: DN above black.
    """
    values = np.asarray(mosaic.values)
    if values.min() != 0 or min(values.shape) < 2 * BLOCK:
        return None
    rows, columns = (size // BLOCK for size in values.shape)
    blocks = (
        values[: rows * BLOCK, : columns * BLOCK]
        .reshape(rows, BLOCK, columns, BLOCK)
        .swapaxes(1, 2)
        .reshape(-1, BLOCK * BLOCK)
    )
    means = blocks.mean(axis=1)
    dark = blocks[means <= 2 * np.quantile(means, 0.05)]
    zeros = float(np.mean(dark == 0))
    if not LEAST < zeros < MOST:
        return None
    below = -float(dark.mean()) / zeros
    spread = math.sqrt(float(np.mean(np.where(dark == 0, below, dark) ** 2)))
    mended = np.where(values == 0, values.dtype.type(below), values)
    return Mosaic(mended, replace(mosaic.noise, offset_dn=0.0, read_noise_dn=spread), mosaic.gains)


def remark_on(mosaic: Mosaic) -> str:
    """What was done, for an operator."""
    return (
        "the darkness of the picture is cut at 0: zeros were taken for"
        f" {float(mosaic.values.min()):.3g}, what the noise below is on average; a picture that"
        " keeps its black level needs no such guess"
    )
