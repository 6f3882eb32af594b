"""Whether configurations meet the requirements, and by how much they miss."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.design.figures import Figures
from flflab.design.requirements import Requirements

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Demand:
    """One requirement: the figure it speaks of, its limit, whether that is the least or the most
    allowed, and the unit people read.
    """

    name: str
    figure: str
    limit: float
    least: bool
    unit: str
    factor: float

    def margin(self, values: Array) -> Array:
        """How far a figure is on the right side of the limit, relative to the limit; negative where
        the requirement is missed.
        """
        away = (values - self.limit) / self.limit
        return away if self.least else -away

    def show(self, value: float) -> str:
        """A value of this figure as people read it."""
        return f"{value * self.factor:.4g} {self.unit}".strip()


def demands(wanted: Requirements) -> tuple[Demand, ...]:
    """What the requirements ask for, one by one; lengths are shown in mm or um, angles in deg."""
    require = wanted.require
    asked = [
        Demand("views", "views", float(require.views), True, "views", 1.0),
        Demand("blur", "blur_px", require.blur_px, False, "px", 1.0),
    ]
    if wanted.measure.width is not None:
        asked.append(Demand("width", "width", wanted.measure.width, True, "mm", 1.0))
    if require.resolution is not None:
        asked.append(Demand("resolution", "resolution", require.resolution, False, "um", 1e3))
    if require.contrast is not None:
        asked.append(Demand("contrast", "contrast", require.contrast.least, True, "", 1.0))
    if require.marginal_angle is not None:
        asked.append(
            Demand("marginal angle", "light", require.marginal_angle, True, "deg", 180 / np.pi)
        )
    return tuple(asked)


def margins(asked: tuple[Demand, ...], figures: Figures) -> Array:
    """Relative margins of every demand, shape (demands, n); what is met within rounding counts as
    met.
    """
    rows = np.stack([demand.margin(getattr(figures, demand.figure)) for demand in asked])
    return np.where(np.abs(rows) < 1e-9, 0.0, rows)


def met(asked: tuple[Demand, ...], figures: Figures) -> npt.NDArray[np.bool_]:
    """Which configurations meet every demand, shape (n,)."""
    return np.logical_and.reduce(margins(asked, figures) >= 0, axis=0)
