"""Transfer function of straight edges together and of each by itself, with e-SFR beside."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.edges.edge import Edge
from flflab.measurement.edges.esfr import esfr
from flflab.measurement.edges.spread import LineSpread, line_spread
from flflab.remark import Remark

Array = npt.NDArray[np.float64]

FREQUENCIES = np.linspace(0.0, 0.5, 26)  # cycles/px
WITHIN = 0.4  # cycles/px up to which e-SFR is compared
APART = 0.02  # by which it may differ besides


@dataclass(frozen=True)
class EdgeCurve:
    """Transfer function along the edges' normal, blur and pixel together.

    Attributes:
        cycles_per_px: frequencies on the sensor, shape (K,).
        mtf: of all edges together, shape (K,).
        own: standard uncertainty, what the fit states or, where the edges scatter more, what their
            scatter shows, shape (K,).
        form: standard uncertainty for the unknown form of a skirt of flare, shape (K,).
        esfr: mean of the edges' e-SFR (ISO 12233), nan where none has one, shape (K,).
        edges: the single edges.
        views: the line spread that each shows.
    """

    cycles_per_px: Array
    mtf: Array
    own: Array
    form: Array
    esfr: Array
    edges: tuple[Edge, ...]
    views: tuple[LineSpread, ...]

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainty, shape (K,)."""
        return np.hypot(self.own, self.form)

    @property
    def misfit(self) -> float:
        """Rms of what is left of the edges beyond noise, as a share of their height."""
        return math.sqrt(float(np.mean([edge.misfit**2 for edge in self.edges])))

    @property
    def remarks(self) -> list[Remark]:
        """What a reader of the curve should know."""
        found = list[Remark]()
        apart = np.abs(self.mtf - self.esfr) - 2 * self.uncertainty
        most = float(apart[self.cycles_per_px <= WITHIN].max())
        if most > APART:
            found.append(
                Remark(
                    "edges-unlike-esfr",
                    f"fit and e-SFR (ISO 12233) part by {most:.2g} more than stated; sides that"
                    " slope and skirts of flare mislead e-SFR, a blur of strange form the fit",
                )
            )
        starved = sum(edge.starved for edge in self.edges)
        if starved:
            slope = math.degrees(self.edges[0].angle)
            found.append(
                Remark(
                    "edges-starved",
                    f"{starved} of {len(self.edges)} edges, at {slope:.2f} deg, sample their"
                    " profile at too few places in a pixel; turn the target by a degree",
                )
            )
        return found


def curve_of(edges: list[Edge]) -> EdgeCurve:
    """The transfer function that edges of one blur share."""
    views = [line_spread([edge]) for edge in edges]
    together = line_spread(edges) if len(edges) > 1 else views[0]
    mtf, own = together.mtf(FREQUENCIES)
    alone, doubts = np.array([view.mtf(FREQUENCIES) for view in views]).swapaxes(0, 1)
    weights = 1 / np.maximum(doubts, 1e-9) ** 2
    mean = (weights * alone).sum(axis=0) / weights.sum(axis=0)
    chi2 = (weights * (alone - mean) ** 2).sum(axis=0) / max(len(views) - 1, 1)
    checks = [one for edge in edges if np.isfinite(one := esfr(edge, FREQUENCIES)).all()]
    return EdgeCurve(
        FREQUENCIES,
        mtf,
        own * np.sqrt(np.maximum(chi2, 1.0)),
        together.form(FREQUENCIES),
        np.mean(checks, axis=0) if checks else np.full(len(FREQUENCIES), np.nan),
        tuple(edges),
        tuple(views),
    )
