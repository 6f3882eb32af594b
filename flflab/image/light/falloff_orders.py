"""How finely the fall-off is told: over the pupil, along strips and chords of it, and within a
pixel.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.image.geometry.falloff_means import NARROW
from flflab.image.geometry.setup import Setup
from flflab.image.light.orders import MOST_PARTS, MOST_POINTS, MOST_STRIPS, is_sharp

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

FALLOFF_SHARE = 0.2  # of the tolerance, for the fall-off of dots
STRIP_SHARE = 0.4  # of it, along the strips across bars
PART_SHARE = 0.5  # of it, for the fall-off within a pixel that is lit in part


def falloff_pieces(setup: Setup) -> int:
    """Into how many pieces of two of Gauss's nodes each a strip across bars or an edge is cut for
    the fall-off; 0 for none.

    Where the weight changes by c over the pupil, n pieces leave at most 0.037 c / n^2 of white, and
    in blurs of b pixels no more than (0.008 + 0.0075 b) c / n^3. Measured on edges and on bars of
    all widths, b from 0.4 to 55 and n from 1 to 8.
    """
    if not setup.falloff:
        return 0
    demand = _weight_change(setup) / (STRIP_SHARE * setup.tolerance)
    anyhow, softened = (
        math.sqrt(0.037 * demand),
        math.cbrt((0.008 + 0.0075 * min(float(setup.blur.max()), 1e4)) * demand),
    )
    return max(1, math.ceil(min(anyhow, softened)))


def falloff_chunks(setup: Setup) -> int:
    """Into how many pieces of one weight a strip across a picture is cut for the fall-off; 0 for
    none.

    Where the weight changes by c from a strip's middle to its end, n pieces leave at most 0.088 c /
    n^2 of white.
    """
    return (
        max(1, math.ceil(math.sqrt(0.22 * _weight_change(setup) / setup.tolerance)))
        if setup.falloff
        else 0
    )


def weighing_chords(setup: Setup) -> int:
    """How many chords tell the mean of the fall-off over what three discs have in common; 0 for
    none.

    Where the weight changes by c from the pupil's middle to its rim, n chords leave at most 0.1 c /
    n^1.5 of white, measured on random discs.
    """
    if not setup.falloff:
        return 0
    allowed = FALLOFF_SHARE * setup.tolerance / setup.overlap
    return int(
        np.clip(math.ceil((0.1 * _weight_change(setup) / allowed) ** (2 / 3)), 1, MOST_STRIPS)
    )


def _weight_change(setup: Setup) -> float:
    """The most that the weight of a ray changes from the pupil's middle to its rim."""
    pupils = setup.pupils
    steepest = (
        np.hypot(pupils.slant_x, pupils.slant_y)
        + np.abs(pupils.slant_scale) * pupils.outside
        + np.abs(pupils.slant_spread)
    )
    return 4 * float(np.max(steepest * np.abs(pupils.slant_spread)))


def falloff_counts(setup: Setup) -> Whole:
    """How many points a side across the pupil the fall-off of sharp dots needs, for each kind of
    rim.

    Where slopes at the sensor change by s over the pupil's radius, n of them leave at most s^(2 n)
    / 5^(n - 1) of white, measured on whole pupils with s up to 0.8.
    """
    squared = np.zeros(len(setup.rims.slope))
    if setup.falloff:
        np.maximum.at(squared, setup.rims.kind, np.minimum(setup.pupils.slant_spread**2, 4.0))
    allowed = FALLOFF_SHARE * setup.tolerance / setup.overlap
    counts = np.ceil(math.log(allowed / 5) / np.log(np.maximum(squared, 1e-12) / 5))
    return np.clip(counts, 1, MOST_POINTS).astype(np.int64)


def falloff_parts(setup: Setup, edges: bool = True) -> tuple[Whole, Whole]:
    """Into how many parts a side a pixel lit in part is divided for its fall-off, for each kind of
    rim; 1 where its middle tells it.

    Light that an edge cuts lies up to an eighth of a pixel's side from the middle, times its share
    of white, and where rays are weighed one by one and a blur of b pixels softens the edge, up to
    0.106 / b of it. Where the weight changes by c over the pupil, a rim of w pixels lets through
    1.3 / w less from side to side of a pixel, and of rays that count c / w less: a twelfth of the
    product is left. All are n^2 times less by n parts. Held against rays at F/2 to F/4, pixels of
    1.66 to 20 um: at most 1.0 of that.

    Returns:
        Of pixels that no rim crosses, and of those on rims.
    """
    pupils, pixel, kinds = setup.pupils, setup.pixel_width, setup.rims.kind
    steepest = np.hypot(pupils.slant_x, pupils.slant_y) + np.abs(pupils.slant_scale) * pupils.reach
    bend = 4 * steepest / (1 + steepest**2) ** 3
    width = setup.rims.width[kinds]
    across = bend * np.abs(pupils.slant_scale) * pixel
    seen = bend * np.abs(pupils.slant_spread) / np.maximum(width, NARROW)
    cut = 0.125 * (across + 0.5 * seen) if edges else np.zeros(len(across))
    softened = across * np.minimum(0.125, 0.106 / np.maximum(setup.blur, 0.1)) if edges else cut
    on_rims = np.maximum(cut, 0.11 / np.maximum(width, 1.0) * (across + seen))
    by_kind = np.zeros((2, len(setup.rims.width)))
    if setup.falloff and pixel > 0:
        np.maximum.at(
            by_kind[0], kinds, pupils.level * np.where(is_sharp(setup), on_rims, softened)
        )
        np.maximum.at(by_kind[1], kinds, pupils.level * on_rims)
    parts = np.clip(
        np.ceil(np.sqrt(by_kind * setup.overlap / (PART_SHARE * setup.tolerance))), 1, MOST_PARTS
    ).astype(np.int64)
    return parts[0], parts[1]
