"""A picture through a mosaic of colour filters as the four sub-lattices that it is: above black,
each with its gain, no demosaicing.

Every sub-lattice looks at the same scene, so the sums of their light stand as the filters'
transmissions do. Divided by these gains the four make one grey picture for fits that weigh all
pixels alike; the fit of bars, whose columns may lie on one filter more than on another, takes the
numbers as read and these gains to begin with.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]

LEAST_GAIN = 0.02  # of the strongest: a filter that passes less tells nothing
# standard deviations of a dark pixel: quads of four pixels dimmer than that do not count towards
# the gains
LIT = 10.0
FEWEST_QUADS = 200  # lit squares of four pixels, in which filters are looked for
LIT_SHARE = 0.1  # of the brightest light, in a square of four pixels
UNLIKE = 0.15  # by which a filter's light differs from that of the two on the diagonal
MOST_QUADS = 0.65  # of the lit ones; lattices of any pitch from 5 px stay below 0.6
# of four pixels row by row: the greens, the others, and what such a mosaic is called
DIAGONALS = (([1, 2], [0, 3], "rggb or bggr"), ([0, 3], [1, 2], "grbg or gbrg"))


@dataclass(frozen=True)
class Mosaic:
    """A raw picture, ready for the fits.

    Attributes:
        values: DN above black, saturated pixels at ``noise.full_scale_dn``, shape (rows, columns).
        noise: of one pixel of it.
        gains: of the sub-lattices [row % 2, column % 2], the strongest 1, shape (2, 2); None for a
            sensor without filters.
    """

    values: npt.NDArray[np.floating]
    noise: SensorNoise
    gains: Array | None

    def even(self) -> tuple[npt.NDArray[np.floating], SensorNoise]:
        """The picture with its filters' gains divided out, and the noise of its pixels on
        average.
        """
        if self.gains is None:
            return self.values, self.noise
        full = float(
            np.float32(self.noise.full_scale_dn / self.gains.min())
        )  # as the picture holds it
        tiled = self.values.copy()
        for row, column in np.ndindex(2, 2):
            tiled[row::2, column::2] /= self.gains[row, column]
        tiled[self.noise.saturated(self.values)] = full
        inverse = 1 / self.gains
        return tiled, replace(
            self.noise,
            dn_per_electron=self.noise.dn_per_electron * float(inverse.mean()),
            read_noise_dn=self.noise.read_noise_dn * float(np.sqrt((inverse**2).mean())),
            full_scale_dn=full,
        )


def measure_gains(values: npt.NDArray[np.floating], pattern: str, noise: SensorNoise) -> Array:
    """The filters' gains, from the light of a picture itself; shape (2, 2), the strongest 1.

    Args:
        values: DN above black, saturated pixels at ``noise.full_scale_dn``.
        pattern: the mosaic's letters, for messages.
        noise: of a pixel.

    Raises:
        MeasurementError: no light, or a filter that passes next to none.
    """
    quads = _quads(values)
    lit = (quads.sum(axis=0) > LIT * 2 * noise.dark_variance**0.5) & (
        quads.max(axis=0) < noise.full_scale_dn
    )
    if not lit.any():
        raise MeasurementError(
            "raw picture: nowhere are four neighbouring pixels lit and unsaturated; check the"
            " exposure"
        )
    light = quads[:, lit].sum(axis=1, dtype=np.float64)
    if not (light > LEAST_GAIN * light.max(initial=0.0)).all():
        share = ", ".join(
            f"{letter} {part:.3g}"
            for letter, part in zip(pattern, light / max(float(light.max()), 1e-300), strict=True)
        )
        raise MeasurementError(
            f"raw picture: its filters' light is {share} of the strongest's; {LEAST_GAIN:g} or more"
            " is due of each; check the exposure, and whether the light is white"
        )
    return (light / light.max()).reshape(2, 2)


def brightest_filter(values: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """The pixels of the filter with the most light, as a picture of half the size."""
    planes = [values[row::2, column::2] for row, column in np.ndindex(2, 2)]
    return max(planes, key=lambda plane: float(plane.mean()))


def require_no_filters(values: npt.NDArray[np.floating]) -> None:
    """Refuse a picture of which nothing says that it is a mosaic, and whose pixels do.

    Two filters of four lie on a diagonal and pass the same light. One of the others passes far less
    or more: in most squares of four pixels it is darker than both, or brighter.

    Args:
        values: numbers as read, finite.

    Raises:
        MeasurementError: neighbouring pixels differ as colour filters make them.
    """
    black, top = float(np.quantile(values[::3, ::5], 0.001)), float(values.max())
    quads = _quads(values)
    lit = (quads.mean(axis=0) > black + LIT_SHARE * (top - black)) & (quads.max(axis=0) < top)
    if np.count_nonzero(lit) < FEWEST_QUADS:
        return
    quads = quads[:, lit]
    light = quads.mean(axis=1, dtype=np.float64) - black
    for greens, others, patterns in DIAGONALS:
        least, most = quads[greens].min(axis=0), quads[greens].max(axis=0)
        green = float(light[greens].mean())
        unlike = [n for n in others if abs(light[n] - green) > UNLIKE * green]
        shares = [np.mean(beyond) for n in unlike for beyond in (quads[n] < least, quads[n] > most)]
        if max(shares, default=0.0) > MOST_QUADS:
            found = ", ".join(f"{share:.2g}" for share in light / light.max())
            raise MeasurementError(
                "picture: neighbouring pixels differ as the colour filters of a mosaic make them"
                f" (of four in a square, row by row: {found} of the brightest); name the mosaic"
                f" (--mosaic {patterns})"
            )


def _quads(values: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Squares of two by two pixels, row by row; shape (4, rows // 2, columns // 2)."""
    rows, columns = (size // 2 * 2 for size in values.shape)
    return np.stack([values[row:rows:2, column:columns:2] for row, column in np.ndindex(2, 2)])
