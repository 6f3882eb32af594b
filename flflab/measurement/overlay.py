"""A white picture with what was measured in it drawn over it."""

import cv2
import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.kernel import WIDER
from flflab.measurement.lattice.types import Types
from flflab.measurement.lattice.white_picture import WhitePicture

Array = npt.NDArray[np.float64]

LARGEST, SMALLEST = 4000, 1400  # pixels of the longer side of what is drawn
COLOURS = ((80, 220, 60), (255, 160, 40), (220, 80, 255))  # of the kinds, (blue, green, red)
FAINT = (90, 90, 220)  # of what is not whole or not seen
ARROW = (0, 230, 255)
LONG = 0.45  # of the pitch: how long the 95th percentile of the departures is drawn


def overlay(picture: npt.NDArray[np.float32], white: WhitePicture, types: Types) -> Array:
    """Centres, radii at half light, kinds in colours, and departures from the straight lattice as
    arrows enlarged.

    Args:
        picture: DN, [row, col].
        white: what was measured in it.
        types: kinds of its microlenses.

    Returns:
        8-bit picture, (blue, green, red), shape (rows, columns, 3).
    """
    longest = max(picture.shape)
    scale = min(max(SMALLEST / longest, 1.0), LARGEST / longest)
    low, high = np.quantile(picture[::4, ::4], [0.005, 0.995])
    grey = np.clip((picture - low) / max(float(high - low), 1e-9), 0, 1) ** 0.6 * 200
    size = round(picture.shape[1] * scale), round(picture.shape[0] * scale)
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    small = cv2.resize(grey.astype(np.float32), size, interpolation=way)
    canvas = cv2.cvtColor(small.astype(np.uint8), cv2.COLOR_GRAY2BGR)
    off = white.values[:, :2] - white.grid.straight(white.indices)
    usual = float(np.quantile(np.hypot(*off[white.whole].T), 0.95))
    enlarged = LONG * white.rough.pitch / max(usual, 1e-9)
    thick = max(1, round(0.012 * white.rough.pitch * scale))
    for n in np.flatnonzero(white.found):
        colour = COLOURS[types.of_each[n] % len(COLOURS)] if white.whole[n] else FAINT
        centre = white.values[n, :2]
        radius = (white.profile.radius + white.values[n, WIDER]) * scale
        _circle(canvas, centre, radius, scale, colour, thick)
        if white.whole[n]:
            _arrow(canvas, centre, off[n] * enlarged, scale, thick)
        _circle(canvas, centre, max(1.0, thick * 0.8), scale, colour, -1)
    _caption(canvas, f"arrows: departure from the straight lattice x {enlarged:.3g}")
    return canvas


def _fixed(place: Array, scale: float) -> tuple[int, int]:
    """In sixteenths of a pixel of what is drawn."""
    x, y = ((place + 0.5) * scale - 0.5) * 16
    return round(float(x)), round(float(y))


def _circle(
    canvas: Array,
    centre: Array,
    radius: float,
    scale: float,
    colour: tuple[int, int, int],
    thick: int,
) -> None:
    cv2.circle(
        canvas, _fixed(centre, scale), max(round(radius * 16), 1), colour, thick, cv2.LINE_AA, 4
    )


def _arrow(canvas: Array, start: Array, way: Array, scale: float, thick: int) -> None:
    begin, end = _fixed(start, scale), _fixed(start + way, scale)
    cv2.line(canvas, begin, end, ARROW, thick, cv2.LINE_AA, 4)


def _caption(canvas: Array, text: str) -> None:
    height = min(max(0.5, canvas.shape[1] / 1800), 1.5)
    thick = max(1, round(height * 1.5))
    (width, tall), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, height, thick)
    cv2.rectangle(canvas, (0, 0), (width + 20, tall + 20), (0, 0, 0), -1)
    cv2.putText(
        canvas, text, (10, tall + 8), cv2.FONT_HERSHEY_SIMPLEX, height, ARROW, thick, cv2.LINE_AA
    )
