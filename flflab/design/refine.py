"""From the grid's points to better ones between them: parts and f-number stay, array distance and
gap move freely.

The best point of the front for one objective, or for all of them together, is taken further by
scipy's COBYQA (Ragonneau, 2022), which needs no derivatives and keeps to its bounds.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import NonlinearConstraint, minimize

from flflab.design.figures import objectives, solve_figures
from flflab.design.grid import Candidates, Grid
from flflab.design.judgement import demands, margins
from flflab.design.requirements import Requirements

Array = npt.NDArray[np.float64]

EVALUATIONS = 150
STEPS = 2.0  # of the grid: how far the search first looks
SMALLEST = 1e-12


@dataclass(frozen=True)
class Refined:
    """A configuration between the grid's points.

    Attributes:
        given: the configuration, one of them.
        values: its objectives, in the order of ``maximise``, shape (m,).
        gain: of the weighted geometric mean of the objectives over the grid's point; 0 where
            nothing better was found.
    """

    given: Candidates
    values: Array
    gain: float


def refine(start: Candidates, grid: Grid, wanted: Requirements, weights: Array) -> Refined:
    """Improve one configuration that meets the requirements; the result meets them too.

    Args:
        start: one configuration.
        grid: where it comes from.
        wanted: the requirements.
        weights: of the objectives' logarithms, in the order of ``maximise``, together 1.
    """
    asked = demands(wanted)
    middle = np.array([start.place[0], start.gap[0]])
    step = STEPS * np.array([_spacing(grid), 0.02 * start.gap[0]])
    low = np.maximum(middle - 4 * step, [grid.places[0], grid.gap[0]])
    high = np.minimum(middle + 4 * step, [grid.places[-1], grid.gap[1]])
    if np.any(high <= low):
        return Refined(start, _values(start, wanted), 0.0)
    first = np.log(np.maximum(_values(start, wanted), SMALLEST))

    def at(place: Array) -> Candidates:
        there = np.clip(middle + place * step, low, high)
        return replace(start, place=there[:1], gap=there[1:])

    def gain(place: Array) -> float:
        return float(weights @ (np.log(np.maximum(_values(at(place), wanted), SMALLEST)) - first))

    def room(place: Array) -> Array:
        return margins(asked, solve_figures(at(place), wanted, 1))[:, 0]

    found: Any = minimize(
        lambda place: -gain(place),
        np.zeros(2),
        method="COBYQA",
        bounds=list(zip((low - middle) / step, (high - middle) / step, strict=True)),
        constraints=[NonlinearConstraint(room, 0.0, np.inf)],
        options={"maxfev": EVALUATIONS},
    )
    gained = gain(found.x)
    if gained <= 0 or (room(found.x) < 0).any():
        return Refined(start, _values(start, wanted), 0.0)
    better = at(found.x)
    return Refined(better, _values(better, wanted), float(np.expm1(gained)))


def _spacing(grid: Grid) -> float:
    return (
        float(grid.places[1] - grid.places[0])
        if len(grid.places) > 1
        else 0.01 * float(grid.places[0])
    )


def _values(given: Candidates, wanted: Requirements) -> Array:
    return objectives(given, wanted, solve_figures(given, wanted, 1), 1)[0]
