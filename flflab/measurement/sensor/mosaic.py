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
from flflab.measurement.sensor.noise import SensorNoise, estimate_noise
from flflab.raw_file import RawPicture

Array = npt.NDArray[np.float64]

LEAST_GAIN = 0.02  # of the strongest: a filter that passes less tells nothing
# standard deviations of a dark pixel: quads of four pixels dimmer than that do not count towards
# the gains
LIT = 10.0


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


def from_raw(raw: RawPicture, noise: SensorNoise | None = None) -> Mosaic:
    """Subtract black, mark saturated pixels, and measure the filters' gains from the picture
    itself.

    Args:
        raw: the sensor's own numbers.
        noise: of the sensor; None estimates it from the sub-lattice with the most light.

    Raises:
        MeasurementError: no light, or a filter that passes next to none.
    """
    values = raw.values.astype(np.float32)
    black = np.array(raw.black_level, dtype=np.float32).reshape(2, 2)
    for row, column in np.ndindex(2, 2):
        values[row::2, column::2] -= black[row, column]
    full = float(raw.white_level - black.max())
    values[raw.values >= raw.white_level] = full
    if raw.pattern is None:
        return Mosaic(
            values,
            (
                _noise(values, full)
                if noise is None
                else replace(noise, offset_dn=0.0, full_scale_dn=full)
            ),
            None,
        )
    planes = {place: values[place[0] :: 2, place[1] :: 2] for place in np.ndindex(2, 2)}
    brightest = max(planes.values(), key=lambda plane: float(plane.mean()))
    found = (
        _noise(brightest, full)
        if noise is None
        else replace(noise, offset_dn=0.0, full_scale_dn=full)
    )
    rows, columns = values.shape[0] // 2, values.shape[1] // 2
    quads = np.stack(
        [plane[:rows, :columns] - np.float32(found.offset_dn) for plane in planes.values()]
    )
    lit = (quads.sum(axis=0) > LIT * 2 * found.dark_variance**0.5) & (
        quads.max(axis=0) < full - found.offset_dn
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
            for letter, part in zip(
                raw.pattern, light / max(float(light.max()), 1e-300), strict=True
            )
        )
        raise MeasurementError(
            f"raw picture: its filters' light is {share} of the strongest's; {LEAST_GAIN:g} or more"
            " is due of each; check the exposure, and whether the light is white"
        )
    return Mosaic(values, found, (light / light.max()).reshape(2, 2))


def _noise(plane: npt.NDArray[np.float32], full: float) -> SensorNoise:
    return replace(estimate_noise(plane), full_scale_dn=full)
