"""Figures of measured against predicted."""

import io
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flflab.observations.agreement import Findings, FrameAgreement
from flflab.observations.detector import PossibleViews
from flflab.whole_file import write_whole

Array = npt.NDArray[np.float64]
# Colours that colour-blind readers tell apart too.
MEASURED, DESCRIBED, REFITTED = "black", "#d55e00", "#0072b2"


def plot_compare(
    file: Path,
    frames: tuple[FrameAgreement, ...],
    found: Findings,
    possible: PossibleViews,
) -> None:
    """Residual positions, share of views found, totals of every frame, and deviation of virtual
    depth; written to ``file``.
    """
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes: list[Axes] = list(np.ravel(figure.subplots(2, 2)))
    _draw_positions(axes[0], frames)
    _draw_detector(axes[1], found, possible)
    _draw_totals(axes[2], frames, found.detector.scatter)
    _draw_depths(axes[3], found)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=120)
    write_whole(file, picture.getbuffer())


def _name_frames(axes: Axes, frames: tuple[FrameAgreement, ...]) -> Array:
    axes.set_xticks(
        range(len(frames)), [f"{frame.frame}\n{frame.tilt_deg:.0f}°" for frame in frames]
    )
    axes.set_xlabel("frame, and tilt of the board")
    return np.arange(len(frames), dtype=np.float64)


def _draw_positions(axes: Axes, frames: tuple[FrameAgreement, ...]) -> None:
    places = _name_frames(axes, frames)
    axes.bar(places, [frame.residual_px for frame in frames], 0.6, color=DESCRIBED)
    axes.set(
        ylabel="measured less predicted, rms, px",
        title="Where the views land, one rotation for all frames",
    )


def _draw_detector(axes: Axes, found: Findings, possible: PossibleViews) -> None:
    """Share of the views that light can reach which were found, against their distance from the
    centre of the micro-image.
    """
    distance = possible.from_centre / found.pixel
    edges = np.linspace(0, distance.max(), 25)
    number, _ = np.histogram(distance, edges)
    hit, _ = np.histogram(distance[possible.found], edges)
    some = number > 0
    middle = (edges[1:] + edges[:-1]) / 2
    axes.plot(middle[some], hit[some] / number[some], "o", color=MEASURED, label="found")
    fine = np.linspace(0, edges[-1], 200)
    axes.plot(
        fine,
        found.detector.share(fine * found.pixel),
        color=DESCRIBED,
        label=f"fitted: half at {found.detector.reach / found.pixel:.1f} px",
    )
    axes.axvline(edges[-1], color="grey", linestyle="--", label="edge of the model's total field")
    axes.set(
        xlabel="distance from the centre of the micro-image, px",
        ylabel="share of views found",
        title="Which views the detector finds",
    )
    axes.legend(frameon=False, loc="lower left")


def _draw_totals(axes: Axes, frames: tuple[FrameAgreement, ...], scatter: float) -> None:
    """Views of every frame over those expected, with two standard deviations of their scatter."""
    places = _name_frames(axes, frames)
    expected = np.array([frame.expected_total for frame in frames])
    measured = np.array([frame.measured_total for frame in frames])
    axes.axhline(1, color="grey", linewidth=0.8)
    axes.errorbar(
        places,
        measured / expected,
        2 * np.nan_to_num(scatter) / np.sqrt(expected),
        fmt="o",
        color=MEASURED,
        capsize=3,
    )
    for place, frame, high in zip(places, frames, measured / expected, strict=True):
        if frame.z is not None:
            axes.annotate(
                f"z = {frame.z:+.1f}", (place, high), (6, 4), textcoords="offset points", fontsize=8
            )
    axes.set_xlim(-0.5, len(frames))
    axes.set(
        ylabel="views found over views expected",
        title="Views of a frame (bars: two standard deviations)",
    )


def _draw_depths(axes: Axes, found: Findings) -> None:
    known, parallax = found.parallax.known, found.parallax.virtual_depth
    models = [(found.predicted.virtual_depth, DESCRIBED, "camera as described")]
    if found.refit_depth is not None:
        models.append((found.refit_depth, REFITTED, "L and b refitted"))
    for model, colour, label in models:
        share = 100 * (model[known] / parallax[known] - 1)
        axes.plot(parallax[known], share, ".", color=colour, markersize=4, label=label)
    axes.axhline(0, color="grey", linewidth=0.8)
    axes.set(
        xlabel="virtual depth by parallax",
        ylabel="model less parallax, %",
        title="Virtual depth of every point",
    )
    axes.legend(frameon=False)
