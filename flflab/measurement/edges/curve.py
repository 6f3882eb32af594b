"""Transfer function of straight edges together and of each by itself, with e-SFR beside."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.edges.edge import Edge
from flflab.measurement.edges.esfr import esfr
from flflab.measurement.edges.spread import line_spread
from flflab.remark import Remark

Array = npt.NDArray[np.float64]

FREQUENCIES = np.linspace(0.0, 0.5, 26)  # cycles/px
# of an edge's own uncertainty: what its prior takes from every edge alike stays in their mean
ALIKE = 0.5
WITHIN = 0.4  # cycles/px up to which e-SFR is compared
APART = 0.02  # by which it may differ besides


@dataclass(frozen=True)
class EdgeCurve:
    """Transfer function along the edges' normal, blur and pixel together.

    Attributes:
        cycles_per_px: frequencies on the sensor, shape (K,).
        mtf: mean of all edges, shape (K,).
        own: standard uncertainty, as each edge states it or, where they scatter more, as their
            scatter shows, shape (K,).
        form: standard uncertainty for the unknown form of a skirt of flare, shape (K,).
        esfr: mean of the edges' e-SFR (ISO 12233), nan where none has one, shape (K,).
        views_mtf: of each edge by itself, shape (E, K).
        views_uncertainty: theirs, shape (E, K).
        skirt: share of the light in a skirt of flare, mean of all edges.
        misfit: rms of what is left of the edges beyond noise, as a share of their height.
    """

    cycles_per_px: Array
    mtf: Array
    own: Array
    form: Array
    esfr: Array
    views_mtf: Array
    views_uncertainty: Array
    skirt: float
    misfit: float

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainty, shape (K,)."""
        return np.hypot(self.own, self.form)

    @property
    def remarks(self) -> list[Remark]:
        """What a reader of the curve should know."""
        apart = np.abs(self.mtf - self.esfr) - 2 * self.uncertainty
        most = float(apart[self.cycles_per_px <= WITHIN].max())
        if not most > APART:
            return []
        return [
            Remark(
                "edges-unlike-esfr",
                f"fit and e-SFR (ISO 12233) part by {most:.2g} more than stated; sides that"
                " slope and skirts of flare mislead e-SFR, a blur of strange form the fit",
            )
        ]


def curve_of(edges: list[Edge]) -> EdgeCurve:
    """The transfer function that edges of one blur share."""
    views = [line_spread(edge) for edge in edges]
    each, own, form = np.array([view.mtf(FREQUENCIES) for view in views]).swapaxes(0, 1)
    weights, others = 1 / np.maximum(own, 1e-9) ** 2, max(len(views) - 1, 1)
    variance = 1 / weights.sum(axis=0)
    mean = (weights * each).sum(axis=0) * variance
    scatter = (weights * (each - mean) ** 2).sum(axis=0) / others
    alike = ALIKE**2 * len(views) if len(views) > 1 else 0.0
    checks = [one for edge in edges if np.isfinite(one := esfr(edge, FREQUENCIES)).all()]
    return EdgeCurve(
        FREQUENCIES,
        mean,
        np.sqrt((np.maximum(scatter, 1.0) + alike) * variance),
        form.mean(axis=0),
        np.mean(checks, axis=0) if checks else np.full(len(FREQUENCIES), np.nan),
        each,
        np.hypot(own, form),
        float(np.mean([view.skirt for view in views])),
        math.sqrt(float(np.mean([edge.misfit**2 for edge in edges]))),
    )
