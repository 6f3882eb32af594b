"""Pictures whose darkness is cut: pixels that noise would put below a number all read that number.

Files without a black level hold such pictures, cut at 0. On average a dark pixel reads too much
then, 0.4 standard deviations, one in dim light less, and the rim of every total field is drawn
inwards. Where the lowest number reads instead what the noise below it is on average, dark pixels
are right on average and dim ones to a twentieth of a standard deviation.

Which pixels are dark is for a fit to say. Their noise is taken as Gaussian, of mean mu and standard
deviation sigma. With c the highest value that is rounded to the lowest number, and a = (c -
mu)/sigma, the share of the lowest number is Phi(a), and the mean above c is (mu - c)(1 - Phi(a)) +
sigma phi(a) (a censored Gaussian).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from flflab.measurement.sensor.mosaic import Mosaic
from flflab.remark import Remark

FEWEST = 200  # dark pixels
# share of the lowest number: with fewer next to nothing is cut, with more there is no noise to see
LEAST, MOST = 0.05, 0.98
PILED = 1.3  # times as many pixels at the lowest number as at the next
STEPS = 2.0  # of sigma: with less noise a lowest number above 0 is rounding
LIKENESS = 0.35  # of the second moment above c: rims of light beside empty gaps are far from it


@dataclass(frozen=True)
class CutDarkness:
    """Where darkness is cut, DN.

    Attributes:
        lowest_dn: the number that pixels below it read.
        below_dn: what they would read on average.
        offset_dn: what a dark pixel would read on average.
        noise_dn: standard deviation of a dark pixel.
    """

    lowest_dn: float
    below_dn: float
    offset_dn: float
    noise_dn: float


def find_cut(dark: npt.NDArray[np.floating]) -> CutDarkness | None:
    """Where the darkness of a picture is cut; None where it is not, or too few pixels say.

    Args:
        dark: pixels without light, DN, chosen by where they lie and not by what they read,
            shape (n,).
    """
    values = np.asarray(dark, dtype=np.float64)
    if len(values) < FEWEST:
        return None
    lowest = float(values.min())
    share = float(np.mean(values == lowest))
    if not LEAST < share < MOST:
        return None
    step = 1.0 if (values - lowest == np.rint(values - lowest)).all() else 0.0
    above = values[values > lowest] - (lowest + step / 2)
    if step and share < PILED * float(np.mean(values == lowest + 1)):
        return None
    a = float(ndtri(share))
    density = math.exp(-a * a / 2) / math.sqrt(2 * math.pi)
    sigma = float(above.sum()) / len(values) / (density - a * (1 - share))
    mu = lowest + step / 2 - a * sigma
    second = sigma**2 * ((1 + a * a) * float(ndtr(-a)) - a * density)
    found = float((above**2).sum()) / len(values)
    if not abs(found - second - step / 12) < LIKENESS * (second + step / 12):
        return None
    if lowest > 0 and sigma < STEPS * step:
        return None
    return CutDarkness(lowest, mu - sigma * density / share, mu, sigma)


def quiet_pixels(values: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Pixels that are dark as far as their neighbours tell, for a picture of which no fit says it:
    the darkest fiftieth by the mean of the eight around each, which knows nothing of its own noise.
    """
    picture = np.asarray(values, dtype=np.float64)
    if min(picture.shape) < 3:
        return np.zeros(picture.shape, dtype=np.bool_)
    across = picture[:, :-2] + picture[:, 1:-1] + picture[:, 2:]
    around = (across[:-2] + across[1:-1] + across[2:] - picture[1:-1, 1:-1]) / 8
    quiet = np.zeros(picture.shape, dtype=np.bool_)
    quiet[1:-1, 1:-1] = around <= np.quantile(around, 0.02)
    return quiet


def mend(mosaic: Mosaic, cut: CutDarkness) -> Mosaic:
    """The picture with its lowest number where those pixels are on average, and its noise."""
    values = mosaic.values
    mended = np.where(values == cut.lowest_dn, values.dtype.type(cut.below_dn), values)
    noise = replace(
        mosaic.noise,
        offset_dn=cut.offset_dn,
        read_noise_dn=math.sqrt(max(cut.noise_dn**2 - 1 / 12, 0.0)),
    )
    return Mosaic(mended, noise, mosaic.gains)


def remark_on(cut: CutDarkness) -> Remark:
    """What was done, for an operator."""
    return Remark(
        "darkness-cut",
        f"noise below {cut.lowest_dn:g} DN was clipped in this picture; its mean"
        f" ({cut.below_dn:.3g} DN) was estimated. Save pictures with a black level above 0",
    )
