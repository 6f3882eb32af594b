"""From a specification to a picture and its truth."""

import math

import numpy as np
import numpy.typing as npt
from white_pictures.kernel import add_micro_images
from white_pictures.lenses import place_lenses
from white_pictures.profiles import tabulate
from white_pictures.read_out import read_out, shading
from white_pictures.spec import Array, Truth, WhiteSpec


def draw_white(spec: WhiteSpec, rng: np.random.Generator) -> tuple[npt.NDArray[np.uint16], Truth]:
    """A white picture as the sensor reads it, with its truth."""
    light, truth = draw_light(spec, rng)
    return read_out(spec.readout, light, rng), truth


def draw_light(spec: WhiteSpec, rng: np.random.Generator) -> tuple[Array, Truth]:
    """The mean light of every pixel, 1 at the middle of a nominal micro-image, with the truth."""
    table = tabulate(spec.profile)
    margin = math.ceil(4 * spec.halo_length * (spec.halo > 0) + 5 * spec.blur)
    lenses, truth = place_lenses(spec, table, margin, rng)
    lenses["x"] += margin
    lenses["y"] += margin
    light = np.zeros((spec.shape[0] + 2 * margin, spec.shape[1] + 2 * margin))
    add_micro_images(light, lenses, table)
    if margin:
        light = _spread(light, spec)[margin:-margin, margin:-margin]
    if spec.readout.shading != 1:
        y, x = np.ogrid[: spec.shape[0], : spec.shape[1]]
        light = light * shading(spec.shape, spec.readout.shading, x, y)
    return light, truth


def _spread(picture: Array, spec: WhiteSpec) -> Array:
    """Convolve with the blur, and a share of the light with the halo.

    An exponential ``exp(-r/L)/(2 pi L^2)`` has the transfer function ``(1 + (2 pi L f)^2)^-1.5``.
    """
    rows, columns = (60 * math.ceil(n / 60) for n in picture.shape)  # sizes that are fast
    y, x = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)[None, :]
    square: Array = (2 * math.pi) ** 2 * (x * x + y * y)
    near = (1 + spec.halo_length**2 * square) ** -1.5
    far = (1 + 9 * spec.halo_length**2 * square) ** -1.5
    transfer = 1 - spec.halo + spec.halo * (near + far) / 2
    transfer *= np.exp(-(spec.blur**2) * square / 2)
    found = np.fft.irfft2(np.fft.rfft2(picture, (rows, columns)) * transfer, (rows, columns))
    return found[: picture.shape[0], : picture.shape[1]]
