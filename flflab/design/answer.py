"""What a search leaves for people and programs: the front as rows, the named configurations, and
what building them demands.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.design.chunk_log import Found
from flflab.design.figures import Figures, objectives, solve_figures
from flflab.design.grid import Candidates, Grid, LensPart, make_grid
from flflab.design.judgement import demands
from flflab.design.refine import refine
from flflab.design.requirements import Objective, Requirements
from flflab.design.search import chosen
from flflab.design.tolerances import Sensitivity, Yield, built_yield, sensitivities

Array = npt.NDArray[np.float64]

UNITS: dict[Objective, tuple[str, float]] = {
    "area": ("mm^2", 1.0),
    "elr": ("px", 1.0),
    "contrast": ("", 1.0),
    "light": ("deg", 180 / np.pi),
}


@dataclass(frozen=True)
class Option:
    """A configuration to choose.

    Attributes:
        name: ``most area`` and so on, ``balanced``, or the number on the front.
        given: the configuration.
        lens: its main lens.
        figures: what requirements speak of.
        values: its objectives in the order of ``maximise``, shape (m,).
        sensitivities: of its properties; empty unless it is a named one.
        built: yield within the tolerances; None unless it is a named one.
    """

    name: str
    given: Candidates
    lens: LensPart
    figures: Figures
    values: Array
    sensitivities: tuple[Sensitivity, ...] = ()
    built: Yield | None = None


def answer(wanted: Requirements, found: Found) -> tuple[tuple[Option, ...], tuple[Option, ...]]:
    """The named options, refined between the grid's points, and every point of the front.

    Args:
        wanted: the requirements.
        found: what the search found; at least one configuration.
    """
    grid = make_grid(wanted)
    front = tuple(
        _option(wanted, grid, str(index), given)
        for index, given in enumerate(chosen(grid, found.front.numbers), start=1)
    )
    count = len(wanted.maximise)
    weights = [*np.eye(count), np.full(count, 1 / count)] if count > 1 else [np.ones(1)]
    names = [f"most {name}" for name in wanted.maximise] + (["balanced"] if count > 1 else [])
    named: list[Option] = []
    for name, weight in zip(names, weights, strict=True):
        best = int(np.argmax(np.log(np.maximum(found.front.values, 1e-12)) @ weight))
        given = refine(front[best].given, grid, wanted, weight).given
        named.append(
            _option(
                wanted, grid, name, given, sensitivities(given, wanted), built_yield(given, wanted)
            )
        )
    return tuple(named), front


def _option(
    wanted: Requirements,
    grid: Grid,
    name: str,
    given: Candidates,
    by: tuple[Sensitivity, ...] = (),
    built: Yield | None = None,
) -> Option:
    figures = solve_figures(given, wanted, 1)
    values = objectives(given, wanted, figures, 1)[0]
    return Option(name, given, grid.lenses[int(given.lens[0])][0], figures, values, by, built)


def row(wanted: Requirements, option: Option) -> dict[str, Any]:
    """One option as a flat row; keys end in their units."""
    given, figures = option.given, option.figures
    cells: dict[str, Any] = {
        "name": option.name,
        "main_lens": option.lens.name,
        "array": given.array.name,
        "sensor": given.sensor.name,
        "f_number": float(given.f_number[0]),
        "array_mm": float(given.place[0]),
        "gap_mm": float(given.gap[0]),
        "sensor_mm": float(given.place[0] + given.gap[0]),
    }
    for name, value in zip(wanted.maximise, option.values, strict=True):
        unit, factor = UNITS[name]
        key = {"mm^2": "area_mm2", "px": "elr_px", "deg": "marginal_angle_deg", "": "contrast"}[
            unit
        ]
        cells[key] = float(value) * factor
    for demand in demands(wanted):
        key = {
            "views": "views",
            "blur": "blur_px",
            "width": "width_mm",
            "resolution": "resolution_um",
        }.get(demand.name)
        if key is not None:
            cells[key] = float(getattr(figures, demand.figure)[0]) * demand.factor
    return cells
