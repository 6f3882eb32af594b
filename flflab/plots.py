"""Figures of measured against predicted."""

import io
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flflab.observations.agreement import FrameAgreement
from flflab.observations.points import PredictedPoints, SeenPoints
from flflab.whole_file import write_whole

Array = npt.NDArray[np.float64]
MEASURED, DESCRIBED, REFITTED = (
    "black",
    "#d55e00",
    "#0072b2",
)  # told apart by colour-blind readers too


def plot_compare(
    file: Path,
    frames: tuple[FrameAgreement, ...],
    seen: SeenPoints,
    predicted: PredictedPoints,
    refit: PredictedPoints | None,
) -> None:
    """Views of every frame, virtual depth against distance, and its relative deviation; written to
    ``file``.
    """
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=[2, 1])
    views, depth = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
    deviation = figure.add_subplot(grid[1, 1])
    models = [(predicted, DESCRIBED, "camera as described", "s")]
    if refit is not None:
        models.append((refit, REFITTED, "L and b refitted", "D"))
    _draw_views(views, frames, seen, models)
    known = seen.with_parallax
    order = np.flatnonzero(known)[np.argsort(seen.position[known, 2])]
    distance = seen.position[order, 2]
    depth.plot(
        distance,
        seen.virtual_depth[order],
        ".",
        color=MEASURED,
        markersize=4,
        label="measured by parallax",
    )
    for model, colour, label, _ in models:
        depth.plot(
            distance, model.virtual_depth[order], ".", color=colour, markersize=2.5, label=label
        )
        share = 100 * (model.virtual_depth[order] / seen.virtual_depth[order] - 1)
        deviation.plot(distance, share, ".", color=colour, markersize=3)
    depth.set(ylabel="virtual depth v", title="Virtual depth of every point")
    _logarithmic(depth)
    depth.legend(frameon=False)
    deviation.axhline(0, color="grey", linewidth=0.8)
    deviation.set(
        xlabel="distance D from the main lens, mm",
        ylabel="deviation of v, %",
        ylim=_limits(deviation),
    )
    depth.sharex(deviation)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=150)
    write_whole(file, picture.getbuffer())


def _draw_views(
    axes: Axes,
    frames: tuple[FrameAgreement, ...],
    seen: SeenPoints,
    models: list[tuple[PredictedPoints, str, str, str]],
) -> None:
    """Median and range from the 10th to the 90th percentile of the number of views, frame by
    frame.
    """
    numbers = [frame.frame for frame in frames]
    places = np.arange(len(frames), dtype=np.float64)
    series = [
        (seen.views, MEASURED, "measured", "o"),
        *((model.views, colour, label, mark) for model, colour, label, mark in models),
    ]
    for step, (counts, colour, label, mark) in enumerate(series):
        low, middle, high = np.array(
            [np.percentile(counts[seen.frame == frame], [10, 50, 90]) for frame in numbers]
        ).T
        shift = 0.2 * (step - (len(series) - 1) / 2)
        axes.errorbar(
            places + shift,
            middle,
            [middle - low, high - middle],
            fmt=mark,
            color=colour,
            label=label,
            capsize=2,
            markersize=5,
        )
    _logarithmic(axes)
    axes.grid(axis="y", alpha=0.3)
    axes.set_xticks(places, [f"{frame.frame}\n{frame.tilt_deg:.0f}°" for frame in frames])
    axes.set(
        xlabel="frame, and tilt of the board",
        ylabel="views of a point",
        title="Number of views: median, 10th to 90th percentile",
    )
    axes.legend(frameon=False)


def _logarithmic(axes: Axes) -> None:
    """A logarithmic scale upwards with plain numbers at 1, 2, 5 and so on."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    ticks = [
        count
        for decade in (1, 10, 100, 1000)
        for count in (decade, 2 * decade, 5 * decade)
        if low <= count <= high
    ]
    axes.set_yticks(ticks, [str(count) for count in ticks])
    axes.set_yticks([], minor=True)


def _limits(axes: Axes) -> tuple[float, float]:
    """The axis's limits, so far that 0 lies inside."""
    low, high = axes.get_ylim()
    return min(low, -1.0), max(high, 1.0)
