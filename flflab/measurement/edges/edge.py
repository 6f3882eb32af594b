"""A straight, slanted edge in a picture: its angle and place, the light of its sides and the width
of its blur, by a fit of a blurred edge to all pixels, no bins.

The blur is taken for a Gaussian, which places the edge well whatever its form;
``flflab.measurement.edges.spread`` then finds the form.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from flflab.errors import MeasurementError
from flflab.measurement.edges.profile import edge_profile

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

FEWEST_PIXELS = 50
FIRST_BLUR = 0.7  # px
LEAST_BLUR = 0.004  # px: a sharper edge cannot be told from this one
MOST_BLUR = 50.0
SIDE = 30.0  # px, so that slopes of a side are about as large as its light
LEAST_SIGNAL = 5.0  # standard uncertainties of the edge's height


@dataclass(frozen=True)
class EdgePixels:
    """Pixels with an edge in them.

    Attributes:
        x: along the columns' axis from ``middle``, px, shape (n,).
        y: along the rows' axis from ``middle``, px, shape (n,).
        values: in the picture's unit, shape (n,).
        weights: one over the standard deviation of each, shape (n,).
        middle: mean place (x, y), px.
    """

    x: Array
    y: Array
    values: Array
    weights: Array
    middle: tuple[float, float]

    def distance(self, angle: float, offset: float) -> Array:
        """From the edge towards its bright side, px."""
        return self.x * math.cos(angle) + self.y * math.sin(angle) - offset

    def light(self, value: Array) -> Array:
        """What the light of both sides may be: even or sloping, on both and on the bright one
        alone, shape (n, 6); ``value`` is the edge's profile.
        """
        even = np.stack([np.ones_like(value), self.x / SIDE, self.y / SIDE], axis=1)
        return np.concatenate([even, even * value[:, None]], axis=1)


@dataclass(frozen=True)
class Edge:
    """A straight edge in a picture.

    Attributes:
        angle: of the normal towards the bright side, from the columns' axis towards the rows', rad.
        offset_px: of the edge along that normal from the middle of the pixels used, px.
        dark: level on the dark side, in the picture's unit.
        height: bright minus dark.
        blur_px: standard deviation of the Gaussian blur, px.
        residual: standard deviation of one pixel of weight 1 from the model.
        pixels: the pixels used.
    """

    angle: float
    offset_px: float
    dark: float
    height: float
    blur_px: float
    residual: float
    pixels: EdgePixels

    @cached_property
    def distance(self) -> Array:
        """Of each pixel from the edge, towards its bright side, px."""
        return self.pixels.distance(self.angle, self.offset_px)

    @property
    def place_px(self) -> Array:
        """The edge's point nearest the middle of the pixels, (x, y)."""
        normal = np.array([math.cos(self.angle), math.sin(self.angle)])
        return np.array(self.pixels.middle) + self.offset_px * normal

    @property
    def misfit(self) -> float:
        """What is left of the pixels beyond noise, as a share of the edge's height, where their
        weights are those of their noise.
        """
        typical = float(np.median(self.pixels.weights))
        return math.sqrt(max(self.residual**2 - 1, 0.0)) / typical / self.height


def _edge_pixels(picture: Array, used: Mask, deviation: Array) -> tuple[EdgePixels, float]:
    """The pixels in which an edge lies, and the rough angle of its normal from their differences;
    arguments and errors as ``fit_edge``.
    """
    if np.count_nonzero(used) < FEWEST_PIXELS:
        raise MeasurementError(
            f"edge: {np.count_nonzero(used)} pixels were given; at least {FEWEST_PIXELS} are due"
        )
    row, column = np.nonzero(used)
    middle = (float(column.mean()), float(row.mean()))
    around = used[1:-1, 1:-1] & used[1:-1, 2:] & used[1:-1, :-2] & used[2:, 1:-1] & used[:-2, 1:-1]
    across = np.where(around, picture[1:-1, 2:] - picture[1:-1, :-2], 0.0)
    along = np.where(around, picture[2:, 1:-1] - picture[:-2, 1:-1], 0.0)
    if not (across**2 + along**2).sum() > 0:
        raise MeasurementError(
            "edge: all pixels are equally bright; an edge has a dark and a bright side"
        )
    angle = 0.5 * math.atan2(2 * float((across * along).sum()), float((across**2 - along**2).sum()))
    if float((across * math.cos(angle) + along * math.sin(angle)).sum()) < 0:
        angle += math.pi
    weights = 1 / np.broadcast_to(deviation, picture.shape)[used]
    x, y = (place.astype(np.float64) for place in (column, row))
    pixels = EdgePixels(x - middle[0], y - middle[1], picture[used], weights, middle)
    return pixels, math.remainder(angle, 2 * math.pi)


def fit_edge(
    picture: npt.NDArray[np.floating[Any]],
    mask: Mask | None = None,
    deviation: npt.ArrayLike = 1.0,
) -> Edge:
    """Fit one straight, blurred edge to the pixels of a picture; the light of either side may
    slope.

    Args:
        picture: [row, col], finite, linear in light.
        mask: which pixels count; None means all.
        deviation: standard deviation of the pixels' noise, one number or one a pixel; only ratios
            matter.

    Raises:
        MeasurementError: too few pixels, or no edge among them.
    """
    values = np.asarray(picture, dtype=np.float64)
    used = np.ones(values.shape, dtype=np.bool_) if mask is None else mask
    pixels, angle = _edge_pixels(values, used, np.asarray(deviation, dtype=np.float64))
    weights = pixels.weights[:, None]

    def seen(at: Array) -> tuple[Array, Array]:
        """Light of both sides, and slopes by angle, offset and variance for a height of 1."""
        value, slope, bend = edge_profile(
            pixels.distance(at[0], at[1]), math.sqrt(at[2]), float(at[0])
        )
        lever = pixels.y * math.cos(at[0]) - pixels.x * math.sin(at[0])
        return pixels.light(value), np.stack([slope * lever, -slope, 0.5 * bend], axis=1)

    def left(at: Array) -> Array:
        return (seen(at)[0] @ at[3:] - pixels.values) * pixels.weights

    def design(at: Array) -> Array:
        light, slopes = seen(at)
        height = light[:, :3] @ at[6:]
        return np.concatenate([slopes * height[:, None], light], axis=1) * weights

    offset, low, high = _first_look(pixels, angle)
    least, most = np.full(9, -np.inf), np.full(9, np.inf)
    least[2], most[2] = LEAST_BLUR**2, MOST_BLUR**2
    found = least_squares(
        left,
        np.array([angle, offset, FIRST_BLUR**2, low, 0.0, 0.0, high - low, 0.0, 0.0]),
        design,  # pyright: ignore[reportArgumentType]
        bounds=(least, most),
        x_scale="jac",
    )
    height = float(found.x[6])
    scatter = 2 * float(found.cost) / max(len(pixels.values) - 9, 1)
    doubt = math.sqrt(scatter * float(np.linalg.pinv(found.jac.T @ found.jac)[6, 6]))
    if not height > LEAST_SIGNAL * doubt:
        raise MeasurementError(
            f"edge: its height is {height:.3g} with an uncertainty of {doubt:.2g}; at least"
            f" {LEAST_SIGNAL:g} uncertainties are needed"
        )
    return Edge(
        angle=math.remainder(float(found.x[0]), 2 * math.pi),
        offset_px=float(found.x[1]),
        dark=float(found.x[3]),
        height=height,
        blur_px=math.sqrt(float(found.x[2])),
        residual=math.sqrt(scatter),
        pixels=pixels,
    )


def _first_look(pixels: EdgePixels, angle: float) -> tuple[float, float, float]:
    """Where the pixels' mean brightness says that the edge lies, as many pixels on its bright side
    as the mean demands, and the light of its dark and bright side.
    """
    low, high = (float(level) for level in np.quantile(pixels.values, [0.05, 0.95]))
    share = float(np.clip((pixels.values.mean() - low) / max(high - low, 1e-300), 0.02, 0.98))
    return float(np.quantile(pixels.distance(angle, 0.0), 1 - share)), low, high
