"""The page of ``flflab accuracy model``: where in the space of configurations first order holds,
maps, lines and a table.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from matplotlib.colors import LinearSegmentedColormap

from flflab.accuracy.drawing import BLUE, GREEN, GREY, ORANGE, PINK, as_svg, sheet
from flflab.accuracy.lenses import MAIN_LENSES
from flflab.accuracy.model import (
    F_NUMBERS,
    FIELDS,
    FOCAL_LENGTH,
    QUANTITIES,
    TYPICAL,
    Quantity,
    Sweep,
)
from flflab.accuracy.page import Page, Picture, Section, Table
from flflab.accuracy.thick import first_order, scaled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[np.float64]

LEVELS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
HOLDS_OR_NOT = LinearSegmentedColormap.from_list("holds or not", [BLUE, "#ffffff", ORANGE])
LINE_COLOURS = (GREY, BLUE, "#56b4e9", GREEN, PINK, "#e69f00", ORANGE)
AT_STOPS = (2.0, 4.0, 8.0, 16.0)
PLACES, WIDTHS = (
    ("micro-image centre", "view position"),
    ("outside radius", "inside radius", "marginal angle", "blur"),
)
AXES = {
    "distance": "target to front principal plane, mm",
    "gap": "microlenses to sensor, mm, the target in focus",
    "aperture": "aperture of the microlenses, mm",
}


def model_page(sweeps: Sequence[Sweep], made: str) -> Page:
    """Lay out the page.

    Args:
        sweeps: of ``sweep_model``.
        made: where and when they were computed.
    """
    maps = [sweep for sweep in sweeps if len(sweep.varied) == 2]
    return Page(
        "Where the first-order model holds",
        _answers(maps, sweeps),
        (
            Section(
                "Over f-number and field height, in focus",
                (
                    (
                        "Blue: the model holds to 1 % of what the scale names (the blur: to one"
                        " pixel); orange: it does not; the black line lies between. Each panel is"
                        " one real main lens of 50 mm before the paper's array, whose microlenses"
                        " are plano-convex, 336 µm wide, on a plate of 1 mm."
                    ),
                ),
                tuple(
                    Picture(_map(maps, quantity), quantity.name, _reads(maps, quantity))
                    for quantity in QUANTITIES
                ),
                wide=True,
            ),
            Section(
                "Along one setting at a time",
                (
                    (
                        f"At F/{float(np.asarray(TYPICAL.f_number)):g},"
                        f" {float(np.asarray(TYPICAL.field)):g} mm off the axis. Below the black"
                        " line the model holds; differences in % of what the maps name, the blur's"
                        " in pixels."
                    ),
                ),
                tuple(
                    Picture(_lines(sweeps, varied), varied, _line_reads(sweeps, varied))
                    for varied in AXES
                ),
                wide=True,
            ),
            Section("How far it holds", tables=(model_table(sweeps), _lens_table())),
            Section(
                "How it was computed",
                (
                    (
                        "Every ray is refracted by Snell's law at every spherical surface of both"
                        " lenses, from target to sensor, and aimed at the stops' edges by Newton's"
                        " method. The real camera is set up as the model describes it: focal length"
                        " and f-number those of the model, the array counted from the rear"
                        " principal plane, the target from the front one, the plate of the"
                        " microlenses as thickness over index. Rims of the main lenses do not clip;"
                        " one wavelength; rays in the meridional plane."
                    ),
                    (
                        "Views are looked at half way out in the stop, the virtual depth by the"
                        " parallax of two such views on both sides."
                    ),
                ),
            ),
        ),
        made,
    )


def model_table(sweeps: Sequence[Sweep]) -> Table:
    """Up to which field height each quantity holds, by lens and f-number."""
    maps = [sweep for sweep in sweeps if len(sweep.varied) == 2]
    rows = [
        (
            sweep.lens,
            quantity.name,
            *(_height(_at_stop(sweep, quantity, stop)) for stop in AT_STOPS),
            f"{100 * _share(sweep, quantity):.0f} %",
        )
        for sweep in maps
        for quantity in QUANTITIES
    ]
    headings = ("main lens", "quantity", *(f"F/{stop:g}" for stop in AT_STOPS), "of the map")
    return Table(
        "Field height in mm from the axis up to which first order holds", headings, tuple(rows)
    )


def _lens_table() -> Table:
    rows: list[tuple[str, ...]] = []
    for name, lens in MAIN_LENSES.items():
        known = first_order(scaled(lens, FOCAL_LENGTH))
        rows.append(
            (
                name, f"{len(lens.curvature)}", f"{known.rear - known.front:.2f}",
                f"{round(known.exit_pupil - known.rear, 2) + 0.0:.2f}",
                f"{known.pupil_share:.3f}",
            )
        )  # fmt: skip
    headings = (
        "main lens", "surfaces", "front to rear principal plane, mm",
        "exit pupil behind the rear principal plane, mm",
        "exit pupil over entrance pupil",
    )  # fmt: skip
    return Table(
        "The main lenses to first order; the model takes the last two as 0 and 1",
        headings,
        tuple(rows),
    )


def _share(sweep: Sweep, quantity: Quantity) -> float:
    return float(np.mean(sweep.comparisons[quantity.name].excess <= 1))


def _at_stop(sweep: Sweep, quantity: Quantity, f_number: float) -> Array:
    """Excess along the field at an f-number, between the map's own ones."""
    excess = sweep.comparisons[quantity.name].excess
    return np.array([np.interp(np.log(f_number), np.log(F_NUMBERS), column) for column in excess.T])


def _height(excess: Array) -> str:
    """The field height at which the excess first passes 1."""
    beyond = np.flatnonzero(~(excess <= 1))
    if not len(beyond):
        return f"≥ {FIELDS[-1]:g}"
    first = int(beyond[0])
    if first == 0:
        return "nowhere"
    low, high = excess[first - 1], excess[first]
    share = (1 - low) / (high - low) if np.isfinite(high) else 0.0
    return f"{FIELDS[first - 1] + share * (FIELDS[first] - FIELDS[first - 1]):.1f}"


def _answers(maps: Sequence[Sweep], sweeps: Sequence[Sweep]) -> tuple[str, ...]:
    places = " and ".join(
        f"{name.name}s on {_shares(maps, name)}" for name in QUANTITIES if name.name in PLACES
    )
    widths = ", ".join(
        f"{name.name} {_shares(maps, name)}" for name in QUANTITIES if name.name in WIDTHS
    )
    along = [sweep for sweep in sweeps if sweep.varied == ("aperture",)]
    stopped = ", ".join(
        f"{quantity.name}"
        f" {' / '.join(_micrometres(_widest(sweep, quantity)) for sweep in along)} um"
        for quantity in QUANTITIES
        if quantity.name in WIDTHS
    )
    depth = next(quantity for quantity in QUANTITIES if quantity.name == "virtual depth")
    lenses, last = ", ".join(sweep.lens for sweep in maps), f"{FIELDS[-1]:g} mm off the axis"
    return (
        (
            "Positions are right to 1 % of the micro-images' pitch over much of"
            f" the range: {places} of it ({lenses}; f-numbers {F_NUMBERS[0]:g} to"
            f" {F_NUMBERS[-1]:g}, up to {last})."
        ),
        (
            f"Widths are rarely right to 1 %: {widths}. Most of the error is the microlenses' own"
            " spherical aberration. Largest microlens whose widths are right to 1 % at F/4 and 3 mm"
            f" off the axis: {stopped}."
        ),
        f"Virtual depth to 1 % needs a main lens with a flat field: {_shares(maps, depth)}.",
    )


def _shares(maps: Sequence[Sweep], quantity: Quantity) -> str:
    return " / ".join(f"{100 * _share(sweep, quantity):.0f}" for sweep in maps) + " %"


def _micrometres(width: float) -> str:
    return f"{1e3 * width:.0f}" if width > 0 else "none"


def _widest(sweep: Sweep, quantity: Quantity) -> float:
    """The widest microlens up to which a quantity holds, mm; 0 where none does."""
    apertures = np.asarray(sweep.setting.aperture, dtype=float)
    holds = np.logical_and.accumulate(sweep.comparisons[quantity.name].excess <= 1)
    return float(apertures[holds].max(initial=0.0))


def _reads(maps: Sequence[Sweep], quantity: Quantity) -> str:
    heights = ", ".join(f"{sweep.lens} {_height(_at_stop(sweep, quantity, 4.0))}" for sweep in maps)
    largest = max(float(np.nanmax(sweep.comparisons[quantity.name].excess)) for sweep in maps)
    unit = "pixels" if quantity.name == "blur" else "%"
    return (
        f"{quantity.name.capitalize()}: at F/4 first order holds up to this field height in mm:"
        f" {heights}. The largest difference on the maps is {float(f'{largest:.2g}'):g} {unit}."
    )


def _line_reads(sweeps: Sequence[Sweep], varied: str) -> str:
    mine = [sweep for sweep in sweeps if sweep.varied == (varied,)]
    held = [
        quantity.name
        for quantity in QUANTITIES
        if all(bool(np.all(sweep.comparisons[quantity.name].excess <= 1)) for sweep in mine)
    ]
    never = [
        quantity.name
        for quantity in QUANTITIES
        if all(not np.any(sweep.comparisons[quantity.name].excess <= 1) for sweep in mine)
    ]
    return (
        "For every one of the main lenses first order holds over the whole range for"
        f" {', '.join(held) or 'nothing'}, and nowhere for {', '.join(never) or 'nothing'}."
    )


def _map(maps: Sequence[Sweep], quantity: Quantity) -> str:
    with sheet(9.0, 2.9) as figure:
        panels: Sequence[Axes] = figure.subplots(1, len(maps), sharey=True, squeeze=False)[0]
        filled = None
        for axes, sweep in zip(panels, maps, strict=True):
            excess = np.clip(sweep.comparisons[quantity.name].excess, LEVELS[0], LEVELS[-1])
            axes.set_facecolor("#bbbbbb")  # where no ray gets through
            levels = np.log10(LEVELS)
            filled = axes.contourf(
                F_NUMBERS, FIELDS, np.log10(excess).T, levels=levels, cmap=HOLDS_OR_NOT
            )
            axes.contour(
                F_NUMBERS, FIELDS, np.log10(excess).T, levels=[0.0], colors="black", linewidths=1.6
            )
            axes.set_xscale("log")
            axes.set_xticks(
                [2, 2.8, 4, 5.6, 8, 11, 16, 22], ["2", "2.8", "4", "5.6", "8", "11", "16", "22"]
            )
            axes.set_xticks([], minor=True)
            axes.grid(visible=False)
            axes.set(xlabel="f-number")
            axes.set_title(sweep.lens, fontweight="normal")
        panels[0].set_ylabel("field height at the array, mm")
        if filled is not None:
            bar = figure.colorbar(
                filled, ax=list(panels), ticks=np.log10(LEVELS), aspect=14, pad=0.01
            )
            bar.ax.set_yticklabels([f"{level:g}" for level in LEVELS])
            bar.set_label(
                "difference, pixels"
                if quantity.name == "blur"
                else f"difference, % of\n{quantity.against}"
            )
        figure.suptitle(
            quantity.name.capitalize(), x=0.005, ha="left", fontsize=11, fontweight="bold"
        )
        return as_svg(figure)


def _lines(sweeps: Sequence[Sweep], varied: str) -> str:
    mine = [sweep for sweep in sweeps if sweep.varied == (varied,)]
    with sheet(9.0, 3.3) as figure:
        panels: Sequence[Axes] = figure.subplots(1, len(mine), sharey=True, squeeze=False)[0]
        for axes, sweep in zip(panels, mine, strict=True):
            across = np.asarray(getattr(sweep.setting, varied), dtype=float)
            for quantity, colour, mark in zip(QUANTITIES, LINE_COLOURS, "os^Dv<>", strict=True):
                excess = np.maximum(sweep.comparisons[quantity.name].excess, 1e-3)
                axes.semilogy(
                    across,
                    excess,
                    color=colour,
                    marker=mark,
                    markersize=3.5,
                    markevery=max(1, len(across) // 5),
                    label=quantity.name,
                    linestyle="--" if quantity.name == "blur" else "-",
                )
            axes.axhline(1, color="black", linewidth=1.6)
            axes.set(ylim=(3e-3, 100))
            axes.set_title(sweep.lens, fontweight="normal")
            if varied == "aperture":
                axes.set_xscale("log")
                axes.set_xticks([0.03, 0.1, 0.2, 0.4], ["0.03", "0.1", "0.2", "0.4"])
                axes.set_xticks([], minor=True)
        panels[len(panels) // 2].set_xlabel(AXES[varied])
        panels[0].set_ylabel("difference, % (blur: pixels)")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center")
        return as_svg(figure)
