"""What the accuracy pages' pictures share: style, colours told apart by colour-blind readers, and
SVG as a data URI.
"""

import base64
import io
import math
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

ORANGE, BLUE, GREEN, PINK, GREY, RED = (
    "#d55e00",
    "#0072b2",
    "#009e73",
    "#cc79a7",
    "#777777",
    "#c1121f",
)
STYLE: dict[Any, Any] = {
    "font.size": 8.5, "axes.titlesize": 10, "axes.titleweight": "bold",
    "axes.titlelocation": "left", "legend.fontsize": 7.5,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.25,
    "grid.linewidth": 0.5,
    "legend.frameon": False, "lines.linewidth": 1.3, "lines.markersize": 4.5,
    "svg.hashsalt": "flflab", "svg.fonttype": "path",
}  # fmt: skip


FEW_DECADES = 2.4  # in so few, powers of ten alone would number an axis once or not at all


@contextmanager
def sheet(width: float, height: float) -> Generator[Figure]:
    """A figure of this size in inches, drawn in the pages' style while it is open."""
    with rc_context(STYLE):
        yield Figure(figsize=(width, height), layout="constrained")


def as_svg(figure: Figure) -> str:
    """The figure as a data URI; inside ``sheet``."""
    _number_short_axes(figure)
    text = io.StringIO()
    figure.savefig(
        text, format="svg", metadata={"Creator": None, "Date": None, "Format": None, "Type": None}
    )
    return "data:image/svg+xml;base64," + base64.b64encode(text.getvalue().encode()).decode("ascii")


def _number_short_axes(figure: Figure) -> None:
    """1, 2 and 5 of each decade, written out, where a logarithmic axis is short."""
    for axis in (one for axes in figure.axes for one in (axes.xaxis, axes.yaxis)):
        if axis.get_scale() != "log" or not isinstance(axis.get_major_locator(), LogLocator):
            continue
        low, high = sorted(axis.get_view_interval())
        axis.set_minor_formatter(NullFormatter())
        if math.log10(high / low) < FEW_DECADES:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
            axis.set_major_formatter(lambda value, _: f"{value:g}".replace("e-0", "e-"))
