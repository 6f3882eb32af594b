"""How finely diffracted light is formed: parts of a pixel, nodes over a rim, and where pixels look
and light falls.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln

from flflab.image.diffraction.kinds import Kind
from flflab.image.diffraction.table import samples_needed
from flflab.image.geometry.setup import Setup
from flflab.image.light.orders import MOST_PARTS, STEEP_PARTS
from flflab.optics.camera import pixel_positions
from flflab.targets import Bars, Picture, Target

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int64]

MOMENTS = 33  # nodes over a rim for the fall-off
# of the tolerance, for points in a pixel: what squares leave is mostly a fifth of what is said of
# them
POINTS = 0.2
BRIGHT = 0.75  # pixels within the bright field, from which on nothing clips a pixel
WITHIN_SHARE = 0.25  # of the tolerance, for the fall-off within parts of a pixel
# of white, that terms left out of the sum over a rim may amount to; finer ones are too many
LEAST_TERMS = 1e-4


@dataclass(frozen=True)
class PixelParts:
    """How a pixel on the rim is divided.

    Attributes:
        offsets: of the parts' middles from the pixel's along either axis, of its side, shape (n,).
        amounts: how much of the pixel each stands for, shape (n,).
        side: over how much of the pixel's side each gathers light; 0 for a point.
        steep: whether the rim is too steep for curves of its own.
        bright: how far within the bright field pixels are whole, pixels; infinite where none is.
        ring: for pixels how far within the bright field they are parts, pixels, from and below; all
            where infinite.
    """

    offsets: Array
    amounts: Array
    side: float
    steep: bool
    bright: float
    ring: tuple[float, float] = (-math.inf, math.inf)

    @property
    def count(self) -> int:
        """Parts in all."""
        return len(self.offsets) ** 2


def pixel_parts(
    kind: Kind, tolerance: float, finest: float = 0.0, within: float = 0.0
) -> PixelParts:
    """Into what parts a pixel on the rim is divided: squares of equal size, or fewer points of
    Gauss's rule.

    Across a pixel share and radiance vary together: on a rim w pixels wide n squares a side leave
    up to 0.2 / (w n^2) of a sharp edge, found on bars, and less of one whose light rises over
    several pixels; the share's own bend leaves up to 0.45 / (w n)^2, 0.45 / (w n^2) where w is
    below 1. A rim too steep for curves leaves up to 0.1 w whatever n is. Texels of a pixel leave
    four times what an edge does.

    Args:
        kind: the kind.
        tolerance: largest error asked for, of white.
        finest: see ``finest_lines``, of a picture; 0 for what has edges along one direction or few.
        within: what the fall-off in its middle leaves of white, n^2 times less n squares a side.
    """
    width = max(2 * kind.slope, 1e-9)
    sharp = min(1.0, 2 * kind.cutoff, 1 / math.sqrt(max(abs(kind.blur), 1e-9))) * (
        1 + 3 * min(1.0, 2 * finest)
    )
    left = max((0.22 * sharp + 0.45 / max(width, 1.0)) / width, within / WITHIN_SHARE)
    parts = math.ceil(math.sqrt(left / tolerance))
    parts = min(max(parts, 1), MOST_PARTS)
    if width * parts < 1:
        return _squares(STEEP_PARTS, True, BRIGHT)
    bright = BRIGHT if within <= WITHIN_SHARE * tolerance else math.inf
    points = np.arange(2, parts)
    enough = (
        points[_points_leave(points, width, kind.cutoff) <= POINTS * tolerance]
        if width >= 1
        else points[:0]
    )
    if not len(enough):
        return _squares(parts, False, bright)
    places, amounts = np.polynomial.legendre.leggauss(int(enough[0]))
    return PixelParts(places / 2, amounts / 2, 0.0, False, bright)


def divisions(
    kind: Kind, tolerance: float, divided: PixelParts, within: float, shaded: bool
) -> list[PixelParts]:
    """Parts for all pixels, or apart for those in the bright field, if fall-off divides these too
    and they need less than half as many.

    Args:
        kind: the kind.
        tolerance: largest error asked for, of white.
        divided: the parts of pixels on the rim.
        within: see ``pixel_parts``.
        shaded: whether pupils are weighted by polynomials, which the terms tell and they alone.
    """
    if not shaded and divided.bright < math.inf:
        return [divided]
    inside = replace(
        _squares(max(1, math.ceil(math.sqrt(within / WITHIN_SHARE / tolerance))), False, math.inf),
        ring=(BRIGHT, math.inf),
    )
    outside = replace(divided, bright=math.inf)
    if kind.inner <= BRIGHT or len(divided.offsets) <= 2 * len(inside.offsets):
        return [outside]
    return [inside, replace(outside, ring=(-math.inf, BRIGHT))]


def _squares(count: int, steep: bool, bright: float) -> PixelParts:
    return PixelParts(
        (np.arange(count) + 0.5) / count - 0.5, np.full(count, 1 / count), 1 / count, steep, bright
    )


def _points_leave(count: Whole, width: float, cutoff: float) -> Array:
    """What so many points of Gauss's rule a side leave of white on a rim of this width, pixels, in
    light of this cutoff, cycles/pixel.

    Where the rim begins and ends light bends as a power 3/2, which leaves 0.035 / (n^2.5 w^0.6),
    found on edges and bars; of waves of k rad/pixel the rule leaves k^2n n!^4 / ((2n + 1) (2n)!^3).
    Beyond 0.7 of the cutoff little is left, a third of the rest is measured.
    """
    bend = 0.035 / (count**2.5 * width**0.6)
    power = (
        2 * count * np.log(0.7 * math.pi * cutoff)
        + 2 * count * math.log(2)
        + 4 * gammaln(count + 1)
        - 3 * gammaln(2 * count + 1)
    )
    return np.asarray(bend + 0.3 * np.exp(np.minimum(power, 50.0)) / (2 * count + 1))


def finest_lines(kind: Kind, target: Target) -> float:
    """Frequency on the sensor of the finest lines that a target may repeat, cycles/pixel; 0 for an
    edge and for dots.
    """
    if isinstance(target, Bars):
        return max(target.cycles_per_mm) * float(np.hypot(*kind.by_sensor[0]))
    if isinstance(target, Picture):
        return 0.5 / target.texel * float(np.hypot(*kind.by_sensor.T).max())
    return 0.0


def node_counts(kind: Kind, setup: Setup, finest: float) -> tuple[int, int]:
    """How many radii and angles of a micro-image's rim a tolerance needs; more where no pixel
    averages out the pupil's finest waves.

    Over the rim the middle of the clipped pupil moves by its radius, and what is seen through it by
    the blur: past lines of f cycles/pixel the light goes up and down f times the blur, and 2 pi
    times as many radii keep a spline within the tolerance. That counts for lines that repeat, up to
    the frequency where pixel and blur leave less of them than a quarter of the tolerance.

    Args:
        kind: the kind.
        setup: what is formed, for its pixels and tolerance.
        finest: see ``finest_lines``.
    """
    tolerance, blur, pixel = setup.tolerance, abs(kind.blur), setup.pixel_width / setup.sensor.pixel
    finer, fine = (0.002 / tolerance) ** 0.25, min(1.0, 0.3 / max(kind.cutoff, 1e-9))
    radii, angles = (
        finer * (9 + 6 * fine) * (1.5 + 0.1 * blur),
        finer * (20 + 8 * fine) * (1 + 0.1 * blur),
    )
    frequency = np.linspace(0.0, min(kind.cutoff, samples_needed(kind, tolerance) / 2), 201)[1:]
    blurred = (
        np.maximum(1.0, math.pi * pixel * frequency)
        * np.maximum(1.0, 2 * math.pi * blur * frequency) ** 1.5
    )
    told = frequency[
        2 / math.pi * np.minimum(1.0, finest / frequency) / blurred > tolerance / 4
    ].max(initial=0.0)  # bars have overtones
    return math.ceil(max(radii, 15 + 2 * math.pi * blur * float(told))), math.ceil(angles) + 1


def lit_counts(windows: Whole, chosen: Chosen) -> Array:
    """How many chosen pixels there are in each window."""
    sums = np.pad(chosen.cumsum(axis=0, dtype=np.float64).cumsum(axis=1), ((1, 0), (1, 0)))
    left, right, low, high = windows.T
    return np.asarray(sums[high, right] - sums[low, right] - sums[high, left] + sums[low, left])


def lit_windows(setup: Setup) -> Whole:
    """The part of the sensor under each micro-image: first column, column after the last, first
    row, row after the last.
    """
    pixel, pupils = setup.sensor.pixel, setup.pupils
    outside = pupils.outside / pixel + 1
    limits: list[Array] = []
    for centre, positions in zip(
        (pupils.centre_x, pupils.centre_y), pixel_positions(setup.sensor), strict=True
    ):
        middle = (centre - positions[0]) / pixel
        limits += [np.ceil(middle - outside), np.floor(middle + outside) + 1]
    windows = np.clip(np.stack(limits, axis=1), -1e9, 1e9).astype(np.int64)
    for side, narrower in ((0, np.maximum), (1, np.minimum), (2, np.maximum), (3, np.minimum)):
        windows[:, side] = narrower(windows[:, side], setup.window[:, side])
    return windows


def looked_at(
    windows: Whole, centres: Array, origins: Array, looks: Array, setup: Setup
) -> tuple[Array, Array]:
    """The least and largest place on the target, pixels along x' and y', that the pixels of some
    windows look at.
    """
    pixel, positions = setup.sensor.pixel, pixel_positions(setup.sensor)
    first = np.array([along[0] for along in positions])
    low, high = (
        (first + (windows[:, side::2] + at) * pixel - centres) / pixel
        for side, at in ((0, -1.0), (1, 0.0))
    )
    corners = np.stack(
        [np.column_stack([x[:, 0], y[:, 1]]) for x in (low, high) for y in (low, high)], axis=1
    )
    places = origins[:, None] + corners @ looks.swapaxes(1, 2)
    return places.min(axis=(0, 1)) - 1, places.max(axis=(0, 1)) + 1
