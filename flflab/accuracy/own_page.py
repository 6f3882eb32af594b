"""The pages of ``flflab accuracy image`` for one's own scene, and of ``flflab accuracy bench``."""

import math
from collections.abc import Sequence

import numpy as np

from flflab.accuracy.drawing import BLUE, GREEN, GREY, ORANGE, as_svg, sheet
from flflab.accuracy.own_scene import AUTO, EVERY, RANDOM, RAYS, SceneRow
from flflab.accuracy.page import Page, Picture, Section, Table
from flflab.image.accuracy import TOLERANCE

COLOURS = {AUTO: ORANGE, EVERY: GREEN, RAYS: BLUE, RANDOM: GREY}


def scene_page(rows: Sequence[SceneRow], name: str, uncertainty: float, made: str) -> Page:
    """Lay out the page of a scene.

    Args:
        rows: of ``scene_rows``.
        name: of the scene.
        uncertainty: of the reference, of white.
        made: where and when they were measured.
    """
    return Page(
        f"What accuracy costs: {name}",
        scene_advice(rows, uncertainty),
        (
            Section(
                "Error against time",
                (
                    "Farther down is more exact, farther left is faster. The ring is what flflab"
                    " image does by default. Grey ground: what the reference cannot see.",
                ),
                (
                    Picture(
                        _error_time(rows, uncertainty),
                        "error against time",
                        "Root mean square of the error over lit pixels against seconds for the"
                        " whole frame, warm.",
                    ),
                    Picture(
                        _asked_reached(rows, uncertainty),
                        "requested and reached",
                        "On the diagonal a picture is exactly as wrong as was allowed; below it,"
                        " better.",
                    ),
                ),
            ),
            Section("All figures", tables=(scene_table(rows),)),
        ),
        made,
    )


def scene_advice(rows: Sequence[SceneRow], uncertainty: float) -> tuple[str, ...]:
    """What to do, in a few sentences, the first one the advice."""
    auto = [row for row in rows if row.method == AUTO]
    default = min(auto, key=lambda row: abs(math.log((row.requested or 1.0) / TOLERANCE)))
    finest = min(auto, key=lambda row: (max(row.rms_error, uncertainty), row.seconds))
    random = [row for row in rows if row.method == RANDOM]
    cost = float(np.median([row.seconds * row.rms_error**2 for row in random]))
    reached = max(default.rms_error, uncertainty)
    every = next(row for row in rows if row.method == EVERY and row.requested == default.requested)
    return (
        f"Ask for {default.requested:g}: {default.path} take {default.seconds:.2g} s for the frame"
        f" with an rms error of {reached:.1g} of white; from {finest.requested:g} on"
        f" ({finest.seconds:.2g} s, {max(finest.rms_error, uncertainty):.1g}) more time buys"
        " nothing that the reference can see.",
        f"With every effect the same tolerance takes {every.seconds:.2g} s; Monte Carlo would need"
        f" {cost / reached**2:.2g} s for the same error, by its own law.",
    )


def scene_table(rows: Sequence[SceneRow]) -> Table:
    """Every row, for people."""
    cells = tuple(
        (
            row.method,
            f"{row.requested:g}" if row.requested is not None else f"{row.rays} rays",
            row.path,
            f"{row.seconds:.3g}",
            f"{row.rms_error:.1e}",
            f"{row.percentile_99:.1e}",
            "" if row.estimate is None else f"{row.estimate:.1e}",
        )
        for row in rows
    )
    headings = ("method", "requested", "path", "s for the frame", "rms error", "99th percentile",
                "own estimate")  # fmt: skip
    return Table("Errors over lit pixels, of white", headings, cells)


def _error_time(rows: Sequence[SceneRow], uncertainty: float) -> str:
    with sheet(5.2, 3.9) as figure:
        axes = figure.add_subplot()
        for method, colour in COLOURS.items():
            mine = [row for row in rows if row.method == method]
            errors = [max(row.rms_error, uncertainty / 3) for row in mine]
            axes.loglog([row.seconds for row in mine], errors, "o-", color=colour, label=method)
            for row, error in zip(mine, errors, strict=True):
                if method == AUTO and row.requested == TOLERANCE:
                    axes.loglog(row.seconds, error, "o", markersize=11, fillstyle="none", color="k")
        axes.axhspan(uncertainty / 10, uncertainty, color="black", alpha=0.1, linewidth=0)
        axes.set(xlabel="time for the frame, s", ylabel="rms error, share of white")
        axes.legend(loc="upper right")
        return as_svg(figure)


def _asked_reached(rows: Sequence[SceneRow], uncertainty: float) -> str:
    with sheet(5.2, 3.9) as figure:
        axes = figure.add_subplot()
        for method in (AUTO, EVERY):
            mine = [row for row in rows if row.method == method]
            asked = [row.requested or 1.0 for row in mine]
            reached = [max(row.rms_error, uncertainty / 3) for row in mine]
            axes.loglog(asked, reached, "o-", color=COLOURS[method], label=method)
            axes.loglog(asked, asked, color="black", linewidth=0.8)
        axes.axhspan(uncertainty / 10, uncertainty, color="black", alpha=0.1, linewidth=0)
        axes.set(xlabel="requested error, share of white", ylabel="rms error, share of white")
        axes.legend(loc="upper left")
        return as_svg(figure)
