"""Transfer function from a slanted edge where blur and pixel are known in kind: a fit of the
blurred edge to all pixels, no bins.

ISO 12233 calls the measurement e-SFR. The model is exact for a Gaussian blur and square pixels, so
neither binning nor a finite difference leaves a bias; ``flflab.measurement.edges.free`` needs no
such knowledge of the blur.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.edges.profile import edge_profile, pixel_transfer

Array = npt.NDArray[np.float64]

FEWEST_PIXELS = 50
LEAST_BLUR = 0.004  # px: a sharper edge cannot be told from this one
MOST_BLUR = 50.0
STEPS = 60
# px: a wider gap between the pixels' distances from the edge leaves its profile to guesses
STARVED = 0.15
LEAST_SIGNAL = 5.0  # standard uncertainties of the edge's height


@dataclass(frozen=True)
class EdgeFit:
    """A straight edge in a picture.

    Attributes:
        angle: of the normal towards the bright side, from the columns' axis towards the rows', rad.
        offset_px: of the edge along that normal from the middle of the pixels used, px.
        middle_px: that middle (x, y).
        dark: level on the dark side, in the picture's unit.
        height: bright minus dark.
        blur_px: standard deviation of the Gaussian blur, px.
        covariance: of angle, offset and the blur's variance (rad, px, px^2), shape (3, 3).
        residual: standard deviation of one pixel of weight 1 from the model.
        widest_gap_px: widest gap between the distances of pixels from the edge where the profile
            changes.
        pixels: number of pixels used.
    """

    angle: float
    offset_px: float
    middle_px: tuple[float, float]
    dark: float
    height: float
    blur_px: float
    covariance: Array
    residual: float
    widest_gap_px: float
    pixels: int

    @property
    def starved(self) -> bool:
        """Whether the slope is so near a simple fraction that the pixels sample the profile at too
        few phases.
        """
        return self.widest_gap_px > STARVED

    def mtf(self, cycles_per_px: npt.ArrayLike) -> Array:
        """Transfer function of blur and pixel along the edge's normal."""
        f = np.asarray(cycles_per_px, dtype=np.float64)
        return np.exp(-2 * math.pi**2 * self.blur_px**2 * f * f) * np.abs(
            pixel_transfer(f, self.angle)
        )

    def mtf_uncertainty(self, cycles_per_px: npt.ArrayLike) -> Array:
        """Its standard uncertainty, from the scatter of the pixels about the model."""
        f = np.asarray(cycles_per_px, dtype=np.float64)
        return 2 * math.pi**2 * f * f * self.mtf(f) * math.sqrt(self.covariance[2, 2])


@dataclass(frozen=True)
class EdgePixels:
    """Pixels with an edge in them: places (x, y) from ``middle``, values, and weights (one over the
    standard deviation).
    """

    x: Array
    y: Array
    values: Array
    weights: Array
    middle: tuple[float, float]

    def distance(self, angle: float, offset: float) -> Array:
        """From the edge towards its bright side, px."""
        return self.x * math.cos(angle) + self.y * math.sin(angle) - offset


def edge_pixels(
    picture: npt.NDArray[np.generic],
    mask: npt.NDArray[np.bool_] | None = None,
    deviation: npt.ArrayLike = 1.0,
) -> tuple[EdgePixels, float]:
    """Take the pixels of a picture in which an edge lies, and the rough angle of its normal from
    their differences.

    Args:
        picture: [row, col].
        mask: which pixels count; None means all.
        deviation: standard deviation of the pixels' noise, one number or one a pixel.

    Raises:
        MeasurementError: too few pixels, pixels that are not finite, or no brightness changes.
    """
    values = np.asarray(picture, dtype=np.float64)
    if values.ndim != 2:
        raise MeasurementError(
            f"edge: a picture of rows and columns is due, not shape {values.shape}"
        )
    used = (
        np.ones(values.shape, dtype=np.bool_) if mask is None else np.asarray(mask, dtype=np.bool_)
    )
    if np.count_nonzero(used) < FEWEST_PIXELS:
        raise MeasurementError(
            f"edge: {np.count_nonzero(used)} pixels were given; at least {FEWEST_PIXELS} are due"
        )
    if not np.isfinite(values[used]).all():
        raise MeasurementError("edge: every pixel used must be a finite number")
    spread = np.broadcast_to(np.asarray(deviation, dtype=np.float64), values.shape)[used]
    if not (np.isfinite(spread).all() and (spread > 0).all()):
        raise MeasurementError("edge: standard deviations of pixels must be finite and above 0")
    row, column = np.nonzero(used)
    middle = (float(column.mean()), float(row.mean()))
    around = used[1:-1, 1:-1] & used[1:-1, 2:] & used[1:-1, :-2] & used[2:, 1:-1] & used[:-2, 1:-1]
    across = np.where(around, values[1:-1, 2:] - values[1:-1, :-2], 0.0)
    along = np.where(around, values[2:, 1:-1] - values[:-2, 1:-1], 0.0)
    if not (across**2 + along**2).sum() > 0:
        raise MeasurementError(
            "edge: all pixels are equally bright; an edge has a dark and a bright side"
        )
    angle = 0.5 * math.atan2(2 * float((across * along).sum()), float((across**2 - along**2).sum()))
    if float((across * math.cos(angle) + along * math.sin(angle)).sum()) < 0:
        angle += math.pi
    x, y = (
        np.asarray(at, dtype=np.float64) - part
        for at, part in zip((column, row), middle, strict=True)
    )
    return EdgePixels(x, y, values[used], 1 / spread, middle), math.remainder(angle, 2 * math.pi)


def fit_edge(
    picture: npt.NDArray[np.generic],
    mask: npt.NDArray[np.bool_] | None = None,
    deviation: npt.ArrayLike = 1.0,
) -> EdgeFit:
    """Fit one straight, Gaussian-blurred edge to the pixels of a picture; the light of either side
    may slope.

    Args:
        picture: [row, col], linear in light.
        mask: which pixels count; None means all.
        deviation: standard deviation of the pixels' noise, one number or one a pixel; only ratios
            matter.

    Raises:
        MeasurementError: no usable pixels, or no edge among them.
    """
    pixels, angle = edge_pixels(picture, mask, deviation)
    offset, variance = _offset(pixels, angle), 0.5
    design, solved = np.zeros((0, 9)), np.zeros(9)
    for _ in range(STEPS):
        t = pixels.distance(angle, offset)
        value, slope, bend = edge_profile(t, math.sqrt(variance), angle)
        lever = pixels.y * math.cos(angle) - pixels.x * math.sin(angle)
        design = (
            np.stack([np.ones_like(t), value, -slope, slope * lever, 0.5 * bend], axis=1)
            * pixels.weights[:, None]
        )
        design = np.concatenate([design, sides(pixels, value) * pixels.weights[:, None]], axis=1)
        solved = np.linalg.lstsq(design, pixels.values * pixels.weights, rcond=None)[0]
        if not solved[1] > 0:
            raise MeasurementError(
                "edge: the fit found no bright side where the pixels' differences showed one; check"
                " the region"
            )
        shift, turn, wider = (float(part) for part in solved[2:5] / solved[1])
        offset += float(np.clip(shift, -2.0, 2.0))
        angle += float(np.clip(turn, -0.05, 0.05))
        before, variance = (
            variance,
            float(
                np.clip(
                    variance + wider,
                    max(variance / 4, LEAST_BLUR**2),
                    min(4 * variance, MOST_BLUR**2),
                )
            ),
        )
        if (
            abs(shift) < 1e-10
            and abs(turn) < 1e-12
            and abs(variance - before) < 1e-10 * (1 + variance)
        ):
            break
    rest = pixels.values * pixels.weights - design @ solved
    freedom = max(len(rest) - design.shape[1], 1)
    scatter = float(rest @ rest) / freedom
    covariance = scatter * np.linalg.pinv(design.T @ design)
    if solved[1] < LEAST_SIGNAL * math.sqrt(covariance[1, 1]):
        raise MeasurementError(
            f"edge: its height is {solved[1]:.3g} with an uncertainty of"
            f" {math.sqrt(covariance[1, 1]):.2g}; at least {LEAST_SIGNAL:g} uncertainties are"
            " needed"
        )
    order = [3, 2, 4]
    return EdgeFit(
        angle=math.remainder(angle, 2 * math.pi),
        offset_px=offset,
        middle_px=pixels.middle,
        dark=float(solved[0]),
        height=float(solved[1]),
        blur_px=math.sqrt(variance),
        covariance=covariance[np.ix_(order, order)] / solved[1] ** 2,
        residual=math.sqrt(scatter),
        widest_gap_px=_widest_gap(pixels.distance(angle, offset), 1.0 + 2 * math.sqrt(variance)),
        pixels=len(rest),
    )


def sides(pixels: EdgePixels, value: Array) -> Array:
    """Slopes of the light along x and y, on both sides and on the bright one, shape (n, 4)."""
    slopes = np.stack([pixels.x, pixels.y], axis=1)
    return np.concatenate([slopes, slopes * value[:, None]], axis=1)


def _offset(pixels: EdgePixels, angle: float) -> float:
    """Where the pixels' mean brightness says that the edge lies: as many pixels on its bright side
    as the mean demands.
    """
    low, high = np.quantile(pixels.values, [0.05, 0.95])
    share = float(np.clip((pixels.values.mean() - low) / max(high - low, 1e-300), 0.02, 0.98))
    return float(np.quantile(pixels.distance(angle, 0.0), 1 - share))


def _widest_gap(t: Array, reach: float) -> float:
    near = np.sort(t[np.abs(t) < reach])
    return float(np.diff(near, prepend=-reach, append=reach).max()) if len(near) else 2 * reach
