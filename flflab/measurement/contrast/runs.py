"""Pixels of bright fields gathered into runs along the bars.

Pixels of one column of a micro-image look at the same place of the bars where the target is
upright, so their mean says all that they say of the contrast. A run is as many rows long as the
bars' slant allows.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.contrast.frame import Frame
from flflab.measurement.lattice.registration import PixelSet, sensor_position

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

# of a run's pixels saturated: what they lack of the light is then 2e-4 where noise is 1 % of it
MOST_CLIPPED = 0.05
FEWEST_PIXELS = 300
MOST_SATURATED = 0.2


@dataclass(frozen=True)
class Runs:
    """What is fitted, one entry a run of pixels, those of a view side by side.

    Attributes:
        read: mean of the pixels above the offset, each divided by its sub-lattice's gain, DN, shape
            (n,).
        places: (1, s - c x, s - c y, c x, c y), mm, s the pixels' mean place and c the centre of
            their micro-image, shape (n, 5).
        dark: variance of ``read`` in the dark, DN^2, shape (n,).
        shot: growth of that variance with ``read``, DN, shape (n,).
        sublattice: 2 (row % 2) + column % 2, all 0 without filters, shape (n,).
        pixels: how many pixels, shape (n,).
        view: which of ``lenses`` each belongs to, shape (n,), rising.
        lenses: position in the lattice of each view's micro-image, shape (V,).
    """

    read: Array
    places: Array
    dark: Array
    shot: Array
    sublattice: Whole
    pixels: Array
    view: Whole
    lenses: Whole

    def part(self, index: npt.NDArray[np.bool_]) -> "Runs":
        """Only the runs of ``index``, and only the views that have any."""
        seen, view = np.unique(self.view[index], return_inverse=True)
        names = "read", "places", "dark", "shot", "sublattice", "pixels"
        kept = {name: getattr(self, name)[index] for name in names}
        return Runs(**kept, view=view.astype(np.int64), lenses=self.lenses[seen])

    @property
    def ends(self) -> Whole:
        """Where the runs of each view begin, and the last ones end, shape (V + 1,)."""
        return np.searchsorted(self.view, np.arange(len(self.lenses) + 1))


def runs_of(frame: Frame, pixels: PixelSet, rows: int) -> Runs:
    """Mean readings of runs of at most so many rows of a column, few of whose pixels are saturated.

    Args:
        frame: the picture.
        pixels: of bright fields, ordered by micro-image.
        rows: in a run, whatever their filter.
    """
    lattice, sensor, noise, gains = frame.lattice, frame.sensor, frame.noise, frame.gains
    parities = 1 if gains is None else 2
    lenses, view = np.unique(pixels.lens, return_inverse=True)
    corner = np.floor(lattice.centres_px[lenses] - lattice.outside_radius_px).astype(np.int64)
    column, row = pixels.columns - corner[view, 0], pixels.rows - corner[view, 1]
    across, bands = int(column.max(initial=0)) + 1, int(row.max(initial=0)) // rows + 1
    key = ((view * across + column) * bands + row // rows) * parities + pixels.rows % parities
    size = len(lenses) * across * bands * parities
    value = np.asarray(frame.values[pixels.rows, pixels.columns], dtype=np.float64)
    clipped = value >= noise.full_scale_dn

    def total(values: npt.NDArray[Any] | None = None) -> Array:
        return np.bincount(key, values, minlength=size)[run].astype(np.float64)

    run: Whole = np.flatnonzero(np.bincount(key, minlength=size))
    run = run[total(clipped) <= MOST_CLIPPED * total()]
    number = total()
    place = np.stack([total(pixels.columns), total(pixels.rows)], axis=1) / number[:, None]
    of = run // (across * bands * parities)
    parity = (total(pixels.rows % 2) / number).astype(np.int64), place[:, 0].astype(np.int64) % 2
    gain = np.ones(len(run)) if gains is None else gains[parity]
    centre = sensor_position(sensor, lattice.centres_px[lenses])[of]
    inside = sensor_position(sensor, place) - centre
    found = Runs(
        (total(np.minimum(value, noise.full_scale_dn)) / number - noise.offset_dn) / gain,
        np.concatenate([np.ones((len(run), 1)), inside, centre], axis=1),
        noise.dark_variance / (number * gain**2),
        noise.dn_per_electron / (number * gain),
        (2 * parity[0] + parity[1]) * (parities - 1),
        number,
        of,
        lenses,
    )
    found = found.part(np.ones(len(run), dtype=np.bool_))
    _require_enough(frame.target.kind, found, clipped)
    return found


def _require_enough(kind: str, runs: Runs, clipped: npt.NDArray[np.bool_]) -> None:
    """Refuse too few pixels, or too many saturated ones.

    Raises:
        MeasurementError: see there.
    """
    number, saturated = int(runs.pixels.sum()), int(np.count_nonzero(clipped))
    if number < FEWEST_PIXELS:
        raise MeasurementError(
            f"{kind} picture: only {number} unsaturated pixels of bright fields look at the"
            f" target, {FEWEST_PIXELS} are due; check exposure, f-number and the target's distance"
        )
    if saturated > MOST_SATURATED * len(clipped):
        raise MeasurementError(
            f"{kind} picture: {saturated} pixels of bright fields are saturated; expose it shorter"
        )
