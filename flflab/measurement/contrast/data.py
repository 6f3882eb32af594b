"""Pixels of bright fields gathered into runs along the bars, and the classic reading off the single
pixels.

Pixels of one column of a micro-image look at the same place of the bars where the target is
upright, so their mean says all that they say of the contrast. A run is as many rows long as the
bars' slant allows.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from flflab.measurement.lattice.falloff import shade
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import sensor_position
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Sensor

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

MARGIN_PX = 1.0  # within the bright field: keeps the averaging of the rim's pixels out
MOST_ROWS = 128
MOST_CLIPPED = 0.3  # of a run's pixels: what noise lifts above full scale is then known well
GAUSS_ROWS = 0.5 / math.sqrt(
    3
)  # of a run's length from its middle: two points have the mean of what is bent over it


@dataclass(frozen=True)
class Field:
    """Which pixels of which micro-images count.

    Attributes:
        lenses: positions in the lattice, shape (n,).
        radius_px: of what counts round each centre.
        keep_off_px: vectors (x, y) from a centre to those neighbours whose light may reach into it,
            shape (m, 2).
        keep_off_radius_px: how far their light reaches.
    """

    lenses: Whole
    radius_px: float
    keep_off_px: Array
    keep_off_radius_px: float


@dataclass(frozen=True)
class ChirpData:
    """What is fitted, one entry a run of pixels.

    Attributes:
        read: mean of the pixels above the offset, each divided by its sub-lattice's gain, DN, shape
            (n,).
        places: (1, s - c x, s - c y, c x, c y), mm, shape (n, 5); s - c by the scale of its
            micro-image.
        light: (1, u, v, u^2, u v, v^2) over the picture, as far as fall-off leaves it within the
            micro-image, shape (n, 6).
        dark: variance of ``read`` in the dark, DN^2, shape (n,).
        shot: growth of that variance with ``read``, DN, shape (n,).
        lens: position of its micro-image in the lattice, shape (n,).
        sublattice: 2 (row % 2) + column % 2, all 0 without filters, shape (n,).
        pixels: how many pixels, shape (n,).
        aside: how far beside the common geometry its view looks, mm on the target, shape (n,).
        wider: square of its view's disc of blur less that of the common one, mm^2, shape (n,).
    """

    read: Array
    places: Array
    light: Array
    dark: Array
    shot: Array
    lens: Whole
    sublattice: Whole
    pixels: Array
    aside: Array
    wider: Array

    def seen_at(self, geometry: Array) -> Array:
        """Where on the target each run looks, mm."""
        return self.places @ geometry + self.aside

    def part(self, index: npt.NDArray[np.bool_] | Whole | slice) -> "ChirpData":
        """Only the runs of ``index``."""
        return ChirpData(
            **{name: getattr(self, name)[index] for name in ChirpData.__dataclass_fields__}
        )


def field_of(lattice: Lattice, radius_px: float, chosen: npt.NDArray[np.bool_]) -> Field:
    """The bright fields of chosen micro-images, outside all neighbours' total fields."""
    keep_off = lattice.outside_radius_px + MARGIN_PX
    steps = (
        np.array(
            [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)], dtype=np.float64
        )
        @ lattice.vectors_px.T
    )
    near = np.hypot(*steps.T) < keep_off + radius_px
    return Field(np.flatnonzero(chosen), radius_px - MARGIN_PX, steps[near], keep_off)


@numba.njit(nogil=True, cache=True)
def _gather(
    picture: npt.NDArray[np.generic],
    centres: Array,
    lenses: Whole,
    radius: float,
    steps: Array,
    keep_off: float,
    ends: Array,
    rows_a_run: int,
    parities: int,
    offset: float,
    full: float,
    gains: Array,
    out: Array,
) -> tuple[int, int]:  # pragma: no cover - compiled
    height, width = picture.shape
    count, saturated = 0, 0
    total, middle, number = np.zeros(2), np.zeros(2), np.zeros(2, dtype=np.int64)
    clipped = np.zeros(2, dtype=np.int64)
    for n, lens in enumerate(lenses):
        cx, cy = centres[lens, 0], centres[lens, 1]
        top, bottom = max(0.0, cy + ends[n, 0]), min(height - 1.0, cy + ends[n, 1])
        for column in range(
            max(0, int(np.ceil(cx - radius))), min(width - 1, int(np.floor(cx + radius))) + 1
        ):
            x = column - cx
            half = np.sqrt(max(radius * radius - x * x, 0.0))
            start, last = int(np.ceil(max(top, cy - half))), int(np.floor(min(bottom, cy + half)))
            while start <= last:
                end = min(start + rows_a_run - 1, last)
                total[:], middle[:], number[:], clipped[:] = 0.0, 0.0, 0, 0
                for row in range(start, end + 1):
                    hidden = False
                    for k in range(len(steps)):
                        if (x - steps[k, 0]) ** 2 + (
                            row - cy - steps[k, 1]
                        ) ** 2 < keep_off * keep_off:
                            hidden = True
                    if hidden:
                        continue
                    value = float(picture[row, column])
                    p = row % parities
                    if value >= full:
                        clipped[p] += 1
                        saturated += 1
                    total[p] += min(value, full)
                    middle[p] += row
                    number[p] += 1
                for p in range(parities):
                    if number[p] > 0 and clipped[p] <= MOST_CLIPPED * number[p]:
                        # which sub-lattice: rows of one parity in one column are of one filter
                        gain = gains[p % 2, column % 2]
                        out[count, 0] = (total[p] / number[p] - offset) / gain
                        out[count, 1] = column
                        out[count, 2] = middle[p] / number[p]
                        out[count, 3] = lens
                        out[count, 4] = number[p]
                        out[count, 5] = gain
                        out[count, 6] = 2 * p + column % 2 if parities == 2 else 0
                        out[count, 7] = clipped[p]
                        count += 1
                start = end + 1
    return count, saturated


def gather(
    picture: npt.NDArray[np.generic],
    lattice: Lattice,
    field: Field,
    sensor: Sensor,
    noise: SensorNoise,
    ends: Array,
    rows_a_run: int,
    gains: Array | None,
    scales: Array,
    levels: Array,
) -> tuple[ChirpData, int]:
    """Mean readings of runs of at most ``rows_a_run`` pixels along the columns.

    Args:
        picture: DN, [row, col].
        lattice: of the micro-images.
        field: which pixels.
        sensor: nominal.
        noise: of a pixel.
        ends: first and last row of each of the field's micro-images that look at the target, px
            from its centre, shape (n, 2).
        rows_a_run: how many pixels of a column, whatever their filter.
        gains: of the colour filter's four sub-lattices, shape (2, 2); None for a sensor without
            filters.
        scales: of the target in each of the lattice's micro-images: by how much its pixels lie
            further apart on it than nominally.
        levels: full light of each over the nominal, which changes from one to the next and not
            within one as the other terms of light do.

    Returns:
        The runs, where noise lifts few pixels above full scale what it would be without that end,
        and how many pixels were saturated.
    """
    parities = 1 if gains is None else 2
    side = 2 * int(field.radius_px) + 3
    out = np.empty((len(field.lenses) * side * (side // rows_a_run + 2) * parities, 8))
    count, saturated = _gather(
        picture,
        lattice.centres_px,
        field.lenses,
        field.radius_px,
        field.keep_off_px,
        field.keep_off_radius_px,
        ends,
        rows_a_run,
        parities,
        noise.offset_dn,
        noise.full_scale_dn,
        np.ones((2, 2)) if gains is None else gains,
        out,
    )
    read, column, row, lens, number, gain, sublattice, clipped = out[:count].T
    full = (noise.full_scale_dn - noise.offset_dn) / gain
    single = noise.dark_variance / gain**2, noise.dn_per_electron / gain
    read = np.where(clipped > 0, _unclipped(read, full, *single), read)
    height, width = picture.shape
    lens = lens.astype(np.int64)
    centre = sensor_position(sensor, lattice.centres_px)[lens]
    inside = (sensor_position(sensor, np.stack([column, row], axis=1)) - centre) * scales[
        lens, None
    ]
    u, v = (
        (column - (width - 1) / 2) * 2 / max(width, height),
        (row - (height - 1) / 2) * 2 / max(width, height),
    )
    one = np.ones(count)
    two = (
        row + side * parities * number * GAUSS_ROWS for side in (-1, 1)
    )  # in place of a run's pixels
    left = np.mean(
        [
            shade(lattice, lens, np.stack([column, one_row], axis=1) - lattice.centres_px[lens])
            for one_row in two
        ],
        axis=0,
    )
    left *= levels[lens]
    return (
        ChirpData(
            read=np.ascontiguousarray(read),
            places=np.stack([one, inside[:, 0], inside[:, 1], centre[:, 0], centre[:, 1]], axis=1),
            light=np.stack([one, u, v, u * u, u * v, v * v], axis=1) * left[:, None],
            dark=noise.dark_variance / (number * gain * gain),
            shot=noise.dn_per_electron / (number * gain),
            lens=lens,
            sublattice=sublattice.astype(np.int64),
            pixels=np.ascontiguousarray(number),
            aside=np.zeros(count),
            wider=np.zeros(count),
        ),
        saturated,
    )


def _unclipped(read: Array, full: Array, dark: Array, shot: Array) -> Array:
    """Mean of readings before an end of the scale: what is above it reads as it.

    The mean of min(x, F), x normal round m with the deviation s, is F - s (z P(z) + p(z)), z = (F -
    m)/s.
    """
    spread = np.sqrt(dark + shot * np.maximum(read, 0.0))
    mean = read
    for _ in range(8):
        z = (full - mean) / spread
        below = ndtr(z)
        density = np.exp(-(z**2) / 2) / math.sqrt(2 * math.pi)
        mean = mean + (read - full + spread * (z * below + density)) / np.maximum(below, 0.1)
    return mean


@numba.njit(nogil=True, cache=True)
def _extremes(
    picture: npt.NDArray[np.generic],
    centres: Array,
    lenses: Whole,
    radius: float,
    steps: Array,
    keep_off: float,
    full: float,
    offset: float,
    gains: Array,
    first: float,
    along: tuple[float, float],
    rates: Array,
    ends: Array,
    knots: Array,
    half: float,
) -> tuple[Array, Array, Whole]:  # pragma: no cover - compiled
    height, width = picture.shape
    high, low = (
        np.full((len(lenses), len(knots)), -np.inf),
        np.full((len(lenses), len(knots)), np.inf),
    )
    number = np.zeros((len(lenses), len(knots)), dtype=np.int64)
    for n in range(len(lenses)):
        cx, cy = centres[lenses[n], 0], centres[lenses[n], 1]
        top, bottom = cy + max(-radius, ends[n, 0]), cy + min(radius, ends[n, 1])
        for row in range(max(0, int(np.ceil(top))), min(height - 1, int(np.floor(bottom))) + 1):
            y = row - cy
            wide = np.sqrt(max(radius * radius - y * y, 0.0))
            for column in range(
                max(0, int(np.ceil(cx - wide))), min(width - 1, int(np.floor(cx + wide))) + 1
            ):
                x = column - cx
                hidden = False
                for k in range(len(steps)):
                    if (x - steps[k, 0]) ** 2 + (y - steps[k, 1]) ** 2 < keep_off * keep_off:
                        hidden = True
                value = float(picture[row, column])
                if hidden or value >= full:
                    continue
                frequency = first + along[0] * x + along[1] * y + rates[n]
                k = (
                    int(np.rint((frequency - knots[0]) / (knots[1] - knots[0])))
                    if len(knots) > 1
                    else 0
                )
                if k < 0 or k >= len(knots) or abs(frequency - knots[k]) > half:
                    continue
                value = (value - offset) / gains[row % 2, column % 2]
                high[n, k] = max(high[n, k], value)
                low[n, k] = min(low[n, k], value)
                number[n, k] += 1
    return high, low, number


def classic_reading(
    picture: npt.NDArray[np.generic],
    lattice: Lattice,
    field: Field,
    noise: SensorNoise,
    gains: Array | None,
    frequency_of: tuple[float, tuple[float, float], Array],
    ends: Array,
    knots: Array,
) -> tuple[Array, Array]:
    """(max - min)/(max + min) of each view's pixels near each frequency: mean over the views, and
    its standard uncertainty.

    Args:
        picture: DN, [row, col].
        lattice: of the micro-images.
        field: which pixels.
        noise: of a pixel.
        gains: as in ``gather``.
        frequency_of: cycles/mm at the middle of a micro-image on the axis, its growth by a pixel
            along x and y, and how much more each micro-image of the field sees.
        ends: first and last row of each that look at the target, px from its centre, shape (n, 2).
        knots: evenly spaced, cycles/mm.
    """
    half = abs(knots[1] - knots[0]) / 2 if len(knots) > 1 else np.inf
    even = np.ones((2, 2)) if gains is None else gains
    high, low, number = _extremes(
        picture, lattice.centres_px, field.lenses, field.radius_px, field.keep_off_px,
        field.keep_off_radius_px,
        noise.full_scale_dn, noise.offset_dn, even, *frequency_of, ends, knots, half,
    )  # fmt: skip
    mean, doubt = np.full(len(knots), np.nan), np.full(len(knots), np.nan)
    for k in range(len(knots)):
        held = number[:, k] >= max(4, number[:, k].max(initial=0) / 2)
        total = high[held, k] + low[held, k]
        readings = (high[held, k] - low[held, k])[total > 0] / total[total > 0]
        if len(readings):
            mean[k] = readings.mean()
            doubt[k] = (
                readings.std(ddof=1) / np.sqrt(len(readings)) if len(readings) > 1 else np.nan
            )
    return mean, doubt
