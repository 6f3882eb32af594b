# longer than 450 lines because each chart of the report is one function here
"""Curves of the report, each a small SVG picture as a data URI. Black is measured, orange
predicted, grey the paper's reading.
"""

import base64
import io
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.curve import ContrastCurve
from flflab.measurement.sequential import Look, split_up
from flflab.record import Run
from flflab.report.quantities import PANELS
from flflab.verdict.comparison import Row
from flflab.verdict.evaluation import Evaluation
from flflab.verdict.properties.values import Values

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]
MEASURED, PREDICTED, PAPER = "black", "#d55e00", "#888888"
ABOVE = 29  # points from axes to title, over a second axis
TELLABLE = 12  # configurations in a legend or along an axis
PALETTE = (
    "#0072b2",
    "#e69f00",
    "#009e73",
    "#cc79a7",
    "#56b4e9",
    "#d55e00",
)  # colour-blind readers distinguish them
MARKERS = "os^Dv<>P*Xhp"  # so are these where colours come again
DOTS = (
    "#e69f00",
    "#56b4e9",
    "#009e73",
    "#cc79a7",
)  # colour-blind readers distinguish them, on white and on a dark frame
STYLE: dict[Any, Any] = {
    "font.size": 8, "axes.titlesize": 9, "legend.fontsize": 7, "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True, "grid.alpha": 0.25, "grid.linewidth": 0.5, "legend.frameon": False,
    "lines.linewidth": 1.2,
    "svg.hashsalt": "flflab", "svg.fonttype": "path", "font.sans-serif": ["DejaVu Sans"],
}  # fmt: skip


@contextmanager
def styled() -> Generator[None]:
    """Draw in the report's style."""
    from matplotlib import rc_context

    with rc_context(STYLE):
        yield


def new_figure(width: float, height: float) -> "Figure":
    """A figure of a size in inches."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=72, layout="constrained")
    FigureCanvasSVG(figure)  # text is laid out by what draws it
    return figure


def as_svg(figure: "Figure") -> str:
    """A figure as a data URI."""
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.execute(figure)  # here, for savefig draws all of a figure once more to lay it out
        figure.set_layout_engine(None)
    text = io.StringIO()
    figure.savefig(
        text, format="svg", metadata={"Creator": None, "Date": None, "Format": None, "Type": None}
    )
    return "data:image/svg+xml;base64," + base64.b64encode(text.getvalue().encode()).decode("ascii")


def _legend_below(figure: "Figure") -> None:
    """Under the axes, where it hides no curve."""
    figure.legend(loc="outside lower center", ncols=2, handlelength=1.6, columnspacing=1.2)


def look(place: int, count: int) -> dict[str, Any]:
    """Colour and marker of one of so many configurations: shades from blue to red where there are
    too many to tell apart.
    """
    if count > TELLABLE:
        shade = 0.8 * place / (count - 1)
        return {"color": (shade, 0.35, 1 - shade), "marker": "."}
    return {"color": PALETTE[place % len(PALETTE)], "marker": MARKERS[place]}


def _rows(rows: tuple[Row, ...], quantity: str, configuration: int | None = None) -> list[Row]:
    return [
        row
        for row in rows
        if row.quantity == quantity and configuration in (None, row.configuration)
    ]


def _columns(rows: list[Row], *names: str) -> Array:
    return np.array([[float(getattr(row, name)) for row in rows] for name in names])


def mtf_chart(
    index: int, curve: ContrastCurve, draws: Array, rows: tuple[Row, ...], title: str
) -> str:
    """Contrast measured with its own uncertainty, against mean and central 95 % of the predicted
    draws, over frequency; ``rows`` hold the paper's reading, where it is compared.
    """
    frequency = curve.cycles_per_mm
    with styled():
        figure = new_figure(3.9, 3.3)
        axes = figure.add_subplot()
        low, high = np.percentile(draws, [2.5, 97.5], axis=0)
        axes.axhline(0, color="grey", linewidth=0.6)
        axes.fill_between(
            frequency,
            low,
            high,
            color=PREDICTED,
            alpha=0.25,
            linewidth=0,
            label="predicted, 95 % of benches",
        )
        axes.plot(frequency, draws.mean(axis=0), color=PREDICTED, label="predicted, mean")
        sigma = np.sqrt(np.diag(curve.covariance))
        axes.errorbar(
            frequency,
            curve.contrast,
            2 * sigma,
            fmt="o",
            color=MEASURED,
            markersize=2.8,
            capsize=1.5,
            label="measured, ± 2σ",
        )
        paper = _rows(rows, "contrast_paper", index)
        if paper:
            nu, claimed, read = _columns(paper, "cycles_per_mm", "predicted", "measured")
            axes.plot(nu, claimed, ":", color=PAPER, label="eq. (2) of the paper")
            axes.plot(
                nu, read, "x", color=PAPER, markersize=3, label="(max - min)/(max + min) of pixels"
            )
        elif rows:
            axes.plot([], [], " ", label="out of the depth of field: no eq. (2)")
        axes.set(xlabel="frequency on the target, cycles/mm", ylabel="contrast", xlim=(0, None))
        axes.set_title(title, y=1, pad=ABOVE)
        _legend_below(figure)
        per_px = float(curve.cycles_per_px[-1] / frequency[-1])
        upper = axes.secondary_xaxis(
            "top", functions=(lambda nu: np.asarray(nu) * per_px, lambda u: np.asarray(u) / per_px)
        )
        upper.set_xlabel("cycles/pixel", fontsize=7)
        upper.tick_params(labelsize=7)
        return as_svg(figure)


def properties_chart(evaluation: Evaluation) -> str:
    """Measured less predicted of every property beside views and contrast, a panel each.

    Black dots with 2 uncertainties of the pictures, on the band of 95 % of the benches that the
    stated errors of stages and optics allow.
    """
    panels = {name: [one for one in evaluation.values if one.quantity == name] for name in PANELS}
    panels = {name: members for name, members in panels.items() if members}
    columns = 3
    with styled():
        figure = new_figure(7.8, 1.75 * max(1, -(-len(panels) // columns)))
        for place, (name, members) in enumerate(panels.items()):
            title, unit, many = PANELS[name]
            axes = figure.add_subplot(-(-len(panels) // columns), columns, place + 1)
            axes.axhline(0, color=PREDICTED, linewidth=0.8)
            at, width, low, high, difference, sigma = np.concatenate(
                [_placed(one, many) for one in members], axis=1
            )
            axes.bar(
                at, high - low, bottom=low, width=width, color=PREDICTED, alpha=0.3, linewidth=0
            )
            axes.errorbar(
                at, difference, sigma, fmt="o", color=MEASURED, markersize=2.8, capsize=1.5
            )
            axes.set_title(f"{title}, {unit}", fontsize=8, y=1)
            if place >= len(panels) - columns:
                axes.set_xlabel("configuration")
            places = {one.configuration for one in members}
            _count(axes, places)
            middle = sum(places) / len(places)
            half = max(1.5, 0.7 + max(abs(one - middle) for one in places))
            axes.set_xlim(middle - half, middle + half)
            axes.grid(visible=False, axis="x")
            axes.use_sticky_edges = False  # a band's end is not the panel's
            axes.autoscale_view(scalex=False)
        return as_svg(figure)


def _placed(one: Values, many: float) -> Array:
    """Place and width of every value's band in a panel, the band's ends, measured less predicted,
    and its 2 uncertainties.
    """
    low, high = np.percentile(one.draws - one.expected, [2.5, 97.5], axis=0) * many
    count = len(low)
    at = one.configuration + (np.linspace(-0.25, 0.25, count) if count > 1 else np.zeros(1))
    difference, sigma = (one.measured - one.expected) * many, 2 * np.sqrt(np.diag(one.noise)) * many
    return np.stack([at, np.full(count, 0.7 / count), low, high, difference, sigma])


def views_chart(evaluation: Evaluation) -> str | None:
    """Number of views of each dot in each configuration, measured and predicted; None where no dots
    were measured.
    """
    rows = _rows(evaluation.comparison.rows, "views")
    if not rows:
        return None
    with styled():
        figure = new_figure(7.8, 2.4)
        axes = figure.add_subplot()
        _by_dot(axes, rows)
        axes.set(xlabel="configuration", ylabel="views of a dot", ylim=(0, None))
        return as_svg(figure)


def difference_chart(evaluation: Evaluation) -> str | None:
    """Differences of the number of views to the reference configuration, measured and predicted;
    None where there are none.
    """
    rows = _rows(evaluation.comparison.rows, "difference_views")
    if not rows:
        return None
    with styled():
        figure = new_figure(7.8, 2.4)
        axes = figure.add_subplot()
        axes.axhline(0, color="grey", linewidth=0.6)
        _by_dot(axes, rows)
        axes.set(xlabel="configuration", ylabel="difference of views")
        return as_svg(figure)


def _count(axes: "Axes", configurations: set[int]) -> None:
    """Ticks at every configuration, or at some whole numbers where they would run into one
    another.
    """
    from matplotlib.ticker import MaxNLocator

    if len(configurations) <= TELLABLE:
        axes.set_xticks(sorted(configurations))
    else:
        axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))


def _shaded(configurations: list[int]) -> str:
    return f"configuration {configurations[0]} blue to {configurations[-1]} red"


def _by_dot(axes: "Axes", rows: list[Row]) -> None:
    """Squares predicted, filled marks measured with their uncertainty; a colour and shape a dot."""
    for dot in sorted({row.dot for row in rows if row.dot is not None}):
        mine = [row for row in rows if row.dot == dot]
        place, measured, sigma, predicted = _columns(
            mine, "configuration", "measured", "uncertainty", "predicted"
        )
        place = place + 0.17 * (dot - 1.5)
        colour, mark = DOTS[dot % len(DOTS)], "o^Dv"[dot % 4]
        axes.plot(
            place,
            predicted,
            "s",
            markersize=7.5,
            markerfacecolor="none",
            markeredgecolor="black",
            markeredgewidth=0.8,
        )
        axes.errorbar(
            place,
            measured,
            sigma,
            fmt=mark,
            color=colour,
            markersize=4,
            capsize=2,
            label=f"dot {dot}",
        )
    axes.plot(
        [],
        [],
        "s",
        markersize=7.5,
        markerfacecolor="none",
        markeredgecolor="black",
        label="predicted",
    )
    _count(axes, {row.configuration for row in rows})
    axes.grid(visible=False, axis="x")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def ratio_chart(rows: tuple[Row, ...], configuration: int, title: str) -> str:
    """Ratio of the MTF to the reference configuration's, measured against predicted."""
    nu, measured, sigma, predicted = _columns(
        _rows(rows, "ratio_mtf", configuration),
        "cycles_per_mm",
        "measured",
        "uncertainty",
        "predicted",
    )
    with styled():
        figure = new_figure(3.9, 2.6)
        axes = figure.add_subplot()
        axes.axhline(1, color="grey", linewidth=0.6)
        axes.plot(nu, predicted, color=PREDICTED, label="predicted, mean")
        axes.errorbar(
            nu,
            measured,
            2 * sigma,
            fmt="o",
            color=MEASURED,
            markersize=2.8,
            capsize=1.5,
            label="measured, ± 2σ of both",
        )
        axes.set(xlabel="frequency on the target, cycles/mm", ylabel="ratio", xlim=(0, None))
        axes.set_title(title, y=1)
        axes.ticklabel_format(axis="y", useOffset=False)
        _legend_below(figure)
        return as_svg(figure)


def residual_chart(evaluation: Evaluation) -> str | None:
    """Standardised differences of the MTF over frequency, and their histogram beside the normal
    law; None where there are none.
    """
    rows = [row for row in _rows(evaluation.comparison.rows, "mtf") if np.isfinite(row.z)]
    if not rows:
        return None
    with styled():
        figure = new_figure(7.8, 2.9)
        by_frequency, histogram = figure.subplots(1, 2, width_ratios=[2, 1], sharey=True)
        by_frequency.axhspan(-2, 2, color="black", alpha=0.07, linewidth=0)
        configurations = sorted({row.configuration for row in rows})
        for place, configuration in enumerate(configurations):
            nu, z = _columns(
                [row for row in rows if row.configuration == configuration], "cycles_per_mm", "z"
            )
            by_frequency.plot(
                nu,
                z,
                **look(place, len(configurations)),
                linewidth=0.5,
                markersize=4,
                label=str(configuration),
            )
        by_frequency.set(
            xlabel="frequency on the target, cycles/mm",
            ylabel="z",
            title="MTF: (measured - predicted)/uncertainty",
        )
        if len(configurations) <= TELLABLE:
            by_frequency.legend(title="configuration", ncols=4, loc="best", columnspacing=1)
        else:
            by_frequency.set_title(
                f"MTF: (measured - predicted)/uncertainty, {_shaded(configurations)}"
            )
        z = np.array([row.z for row in rows])
        edge = max(4.0, float(np.abs(z).max(initial=0.0)) * 1.05)
        grid = np.linspace(-edge, edge, 201)
        histogram.hist(
            z,
            bins=np.linspace(-edge, edge, 25).tolist(),
            density=True,
            orientation="horizontal",
            color="#999999",
        )
        histogram.plot(
            np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), grid, color=PREDICTED, label="normal law"
        )
        histogram.set(xlabel="density", title="all configurations")
        histogram.legend(loc="upper right")
        return as_svg(figure)


def accuracy_chart(run: Run, wanted: float) -> str:
    """What accuracy costs: the MTF's standard uncertainty against the time its frames took on the
    bench, each configuration a line.

    Args:
        run: with its looks at the accuracy.
        wanted: the standard uncertainty the study asks for.
    """
    with styled():
        figure = new_figure(7.8, 2.9)
        axes = figure.add_subplot()
        configurations = sorted({one.configuration for one in run.accuracy})
        for place, configuration in enumerate(configurations):
            looks = [one for one in run.accuracy if one.configuration == configuration]
            taken, sure = np.array([[one.frames, one.mtf_standard_uncertainty] for one in looks]).T
            seconds = _bench_seconds(run, configuration)
            style = look(place, len(configurations))
            per_frame, lasting = split_up(
                tuple(Look(int(n), float(u)) for n, u in zip(taken, sure, strict=True))
            )
            count = np.geomspace(1, 2 * taken[-1], 60)
            axes.plot(
                count * seconds,
                np.sqrt(per_frame / count + lasting),
                color=style["color"],
                linewidth=0.7,
            )
            axes.plot(
                taken * seconds,
                sure,
                **style,
                linestyle="none",
                markersize=4,
                label=f"{configuration}: {int(taken[-1])} frames",
            )
        asked = f"requested: {wanted:g}"
        axes.axhline(wanted, color=PREDICTED, linewidth=0.8, label=asked)
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="time of the frames on the bench, s",
            ylabel="standard uncertainty of the MTF",
        )
        if len(configurations) <= TELLABLE:
            axes.legend(title="configuration", loc="center left", bbox_to_anchor=(1.0, 0.5))
        else:
            axes.set_title(f"{asked}; {_shaded(configurations)}")
        return as_svg(figure)


def _bench_seconds(run: Run, configuration: int) -> float:
    """Seconds a frame of a configuration's bars took: the median from one to the next, so that an
    interruption does not count.
    """
    times = [
        frame.time
        for frame in run.frames
        if frame.configuration == configuration and frame.target == "bars"
    ]
    return (
        float(np.median(np.diff(times)))
        if len(times) > 1
        else max(frame.exposure_s for frame in run.frames)
    )
