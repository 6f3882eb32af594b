"""Pictures whose darkness is cut: pixels that noise would put below 0 all read 0.

Files without a black level hold such pictures. On average a dark pixel reads too much then, 0.4
standard deviations, one in dim light less, and the rim of every total field is drawn inwards, by a
quarter of a pixel where noise in the dark is a hundredth of the light. Where 0 reads instead what
the noise below it is on average, dark pixels are right on average and dim ones to a twentieth of a
standard deviation.

Noise in the dark is taken as Gaussian, of mean mu and standard deviation sigma. With c the highest
value that is rounded to 0, and a = (c - mu)/sigma, the share of zeros is Phi(a), and the mean above
c is (mu - c)(1 - Phi(a)) + sigma phi(a) (a censored Gaussian).
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from flflab.measurement.sensor.mosaic import Mosaic

SOME = 1e-3  # of all pixels: with fewer zeros nothing is cut
DARKEST = 0.02  # of all pixels, by the mean of their neighbours: those in the dark
FEWEST = 200  # of these
# share of zeros among them: with fewer next to nothing is cut, with more there is no noise to see
LEAST, MOST = 0.05, 0.98
LIKENESS = 0.35  # of the second moment above c: rims of light beside empty gaps are far from it


@dataclass(frozen=True)
class CutDarkness:
    """Where darkness is cut, DN.

    Attributes:
        lowest_dn: what pixels read that are cut: 0, or less where black was subtracted since.
        below_dn: what they would read on average.
        offset_dn: what a dark pixel would read on average.
        noise_dn: standard deviation of a dark pixel.
    """

    lowest_dn: float
    below_dn: float
    offset_dn: float
    noise_dn: float


def find_cut(values: npt.NDArray[np.floating]) -> CutDarkness | None:
    """Where the darkness of a picture is cut whose lowest number stands for 0; None where it is
    not, or too few dark pixels say.
    """
    lowest = float(values.min())
    if np.mean(values == lowest) < SOME:
        return None
    dark = _dark_pixels(values)
    share = float(np.mean(dark == lowest)) if len(dark) >= FEWEST else 0.0
    if not LEAST < share < MOST:
        return None
    step = 1.0 if (dark - lowest == np.rint(dark - lowest)).all() else 0.0
    above = dark[dark > lowest] - (lowest + step / 2)
    a = float(ndtri(share))
    density = math.exp(-a * a / 2) / math.sqrt(2 * math.pi)
    sigma = float(above.sum()) / len(dark) / (density - a * (1 - share))
    second = sigma**2 * ((1 + a * a) * float(ndtr(-a)) - a * density) + step / 12
    if not abs(float((above**2).sum()) / len(dark) - second) < LIKENESS * second:
        return None
    mu = lowest + step / 2 - a * sigma
    return CutDarkness(lowest, mu - sigma * density / share, mu, sigma)


def _dark_pixels(values: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Pixels that are dark as far as the eight around each tell, which know nothing of its noise;
    shape (n,).
    """
    picture = np.asarray(values, dtype=np.float32)
    ring = np.full((3, 3), 1 / 8, dtype=np.float32)
    ring[1, 1] = 0.0
    around = cv2.filter2D(picture, -1, ring)
    return values[around <= np.quantile(around[::3, ::3], DARKEST)].astype(np.float64)


def mend(mosaic: Mosaic, cut: CutDarkness) -> Mosaic:
    """The picture with its lowest number where those pixels are on average, and its noise."""
    values = mosaic.values
    mended = np.where(values == cut.lowest_dn, values.dtype.type(cut.below_dn), values)
    read_noise = math.sqrt(max(cut.noise_dn**2 - 1 / 12, 0.0))
    noise = replace(mosaic.noise, offset_dn=cut.offset_dn, read_noise_dn=read_noise)
    return Mosaic(mended, noise, mosaic.gains)
