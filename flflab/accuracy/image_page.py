"""The page of ``flflab accuracy image``: error against time on every scene, requested against achieved error, and the table."""

from collections.abc import Sequence

import numpy as np

from flflab.accuracy.drawing import BLUE, GREEN, GREY, ORANGE, PINK, RED, as_svg, sheet
from flflab.accuracy.image import GRID, PIXELS, RANDOM, RENDER
from flflab.accuracy.page import Page, Picture, Section, Table
from flflab.accuracy.work_precision import Row, order, random_cost

COLOURS = {RENDER: ORANGE, RANDOM: BLUE, GRID: GREY}
MARKS = (("o", BLUE), ("s", ORANGE), ("^", GREEN), ("D", PINK))
QUOTED = 0.003  # the tolerance at which the sentences compare


def image_page(rows: Sequence[Row], made: str) -> Page:
    """Lay out the page.

    Args:
        rows: of ``image_rows``.
        made: where and when they were measured.
    """
    scenes = tuple(dict.fromkeys(row.scene for row in rows))
    limits = _limits(rows)
    times = tuple(Picture(_error_time([row for row in rows if row.scene == one], one, limits), one, _reads(rows, one)) for one in scenes)
    kept = [row for row in rows if row.requested is not None]
    missed = [row for row in kept if not _keeps(row)]
    promise = f"render kept {len(kept) - len(missed)} of the {len(kept)} tolerances asked of it"
    above = {scene: ", ".join(f"{row.requested:g}" for row in missed if row.scene == scene) for scene in scenes}
    promise += "".join(f"; {scene} exceeds {values}" for scene, values in above.items() if values) + "."
    largest = max(row.reference_uncertainty for row in rows)
    return Page(
        "What accuracy costs: pictures",
        (promise, *(_gain(rows, one) for one in scenes)),
        (
            Section(
                "Error against time",
                (
                    "Each point is one method at one setting. Farther down is more exact, farther left is faster; both axes are "
                    "logarithmic. Filled marks are the root mean square of the errors, hollow ones the largest. Time is that of all "
                    "processor cores for a million lit pixels, warm.",
                ),
                times,
            ),
            Section(
                "Error asked for, error reached",
                ("On the diagonal a picture is exactly as wrong as was allowed; below it, better.",),
                (Picture(_calibration(kept, scenes), "requested against achieved error", _calibrated(kept, missed)),),
                wide=True,
            ),
            Section(
                "How it was measured",
                (
                    f"Reference: the light common to both apertures as chords in closed form, a dense sum over the other two coordinates "
                    f"(flflab.accuracy.chords). It shares no code with render, and tests hold it against rays traced one by one. Its "
                    f"uncertainty, the difference to half as many nodes, is {largest:.1g} of white or less (root mean square of a scene's "
                    f"pixels). The pixels, {PIXELS} a scene, are drawn at random where light falls or nearly falls.",
                    "random rays: independent rays from pixel to chart, the plain way. rays on a grid: the same rays, their four "
                    "coordinates in equal steps. Both run compiled on one core. render: closed forms along rows, quadrature across them.",
                    "Scenes: a chart of sines, 20 to 620 cycles across, before a 50 mm lens with an array of 0.9 mm lenses; the middle of "
                    "the sensor. Paraxial light, no noise, no diffraction.",
                ),
            ),
            Section("All figures", tables=(image_table(rows),)),
        ),
        made,
    )


def image_table(rows: Sequence[Row]) -> Table:
    """Every row, for people."""
    headings = (
        "scene", "method", "tolerance, or rays", "largest error", "rms error", "reference uncertainty",
        "processor s", "wall s", "first run, s", "processor s for a million lit px", "million lit px/s",
    )  # fmt: skip
    cells = tuple(
        (
            row.scene, row.method, _asked(row),
            f"{row.largest_error:.1e}", f"{row.rms_error:.1e}", f"{row.reference_uncertainty:.0e}", f"{row.processor_s:.4f}",
            f"{row.wall_s:.4f}", f"{row.first_s:.3f}", f"{row.processor_s_per_megapixel:.3g}", f"{row.lit_megapixels_per_s:.3g}",
        )
        for row in rows
    )  # fmt: skip
    return Table("Errors in units of the white level; times are medians, warm, except the first run's", headings, cells)


def image_summary(rows: Sequence[Row]) -> Table:
    """What a terminal has room for."""
    headings = ("scene", "method", "asked", "largest", "rms", "s/Mpx")
    cells = tuple(
        (row.scene, row.method, _asked(row), f"{row.largest_error:.1e}", f"{row.rms_error:.1e}", f"{row.processor_s_per_megapixel:.3g}")
        for row in rows
    )
    return Table("Errors in units of the white level; processor seconds for a million lit pixels", headings, cells)


def _asked(row: Row) -> str:
    return f"{row.requested:g}" if row.requested is not None else f"{row.work:.0f}"


def _keeps(row: Row) -> bool:
    return row.requested is not None and row.largest_error <= row.requested + 3 * row.reference_uncertainty


def _of(rows: Sequence[Row], scene: str, method: str) -> list[Row]:
    return [row for row in rows if row.scene == scene and row.method == method]


def _quoted(rows: Sequence[Row], scene: str) -> Row:
    return min(_of(rows, scene, RENDER), key=lambda row: abs(np.log((row.requested or 1.0) / QUOTED)))


def _gain(rows: Sequence[Row], scene: str) -> str:
    ours = _quoted(rows, scene)
    times = random_cost(_of(rows, scene, RANDOM), ours.rms_error) / ours.processor_s_per_megapixel
    return (
        f"{scene}: asked for {ours.requested:g}, a million lit pixels take {ours.processor_s_per_megapixel:.2g} s and are wrong by "
        f"{ours.rms_error:.1g} (rms); by their own law random rays would need {_round(times)} times as long for that."
    )


def _round(value: float) -> str:
    """One significant digit."""
    return f"{float(f'{value:.1g}'):,.0f}"


def _reads(rows: Sequence[Row], scene: str) -> str:
    random = _of(rows, scene, RANDOM)
    slope = order([row.work or 1.0 for row in random], [row.rms_error for row in random])
    ours = _of(rows, scene, RENDER)
    cheap, dear = ours[0], ours[-1]
    return (
        f"{scene}: from a tolerance of {cheap.requested:g} to {dear.requested:g} render's time rises "
        f"{_round(dear.processor_s / cheap.processor_s)}-fold; the error of random rays falls as their number to the power {slope:.2f}, so "
        f"one more digit costs them a hundred times the time."
    )


def _limits(rows: Sequence[Row]) -> tuple[tuple[float, float], tuple[float, float]]:
    """One range of times and one of errors for all scenes, so that they can be compared by eye."""
    times = [row.processor_s_per_megapixel for row in rows]
    errors = [error for row in rows for error in (row.rms_error, row.largest_error)]
    return (min(times) / 2, max(times) * 2), (min(*errors, *(row.reference_uncertainty for row in rows)) / 2, max(errors) * 2)


def _error_time(rows: Sequence[Row], scene: str, limits: tuple[tuple[float, float], tuple[float, float]]) -> str:
    with sheet(5.2, 3.9) as figure:
        axes = figure.add_subplot()
        for method, colour in COLOURS.items():
            mine = _of(rows, scene, method)
            times = [row.processor_s_per_megapixel for row in mine]
            axes.loglog(times, [row.rms_error for row in mine], "o-", color=colour, label=method)
            axes.loglog(times, [row.largest_error for row in mine], "o:", color=colour, markerfacecolor="white", linewidth=0.8)
        axes.axhspan(limits[1][0], rows[0].reference_uncertainty, color="black", alpha=0.1, linewidth=0)
        random = _of(rows, scene, RANDOM)
        span = np.array([min(row.processor_s_per_megapixel for row in random), limits[0][1]])
        law = np.sqrt(random_cost(random, 1.0) / span)
        axes.loglog(span, law, "--", color=BLUE, linewidth=0.8, zorder=0)
        axes.annotate("slope -1/2", (span[1], law[1]), (-2, -12), textcoords="offset points", ha="right", fontsize=7.5, color=BLUE)
        axes.set(
            xlabel="processor time for a million lit pixels, s", ylabel="error, share of white", title=scene, xlim=limits[0], ylim=limits[1]
        )
        axes.legend(loc="upper right", bbox_to_anchor=(1.0, 1.08), ncols=3, columnspacing=1.2, handlelength=1.6)
        return as_svg(figure)


def _calibration(kept: Sequence[Row], scenes: Sequence[str]) -> str:
    with sheet(7.6, 4.4) as figure:
        axes = figure.add_subplot()
        asked = np.array([row.requested or 1.0 for row in kept])
        span = np.array([asked.min() / 2, asked.max() * 2])
        axes.loglog(span, span, color="black", linewidth=0.8)
        axes.annotate("as asked", (span[1], span[1]), (-6, -16), textcoords="offset points", ha="right", fontsize=8)
        floor = max(row.reference_uncertainty for row in kept)
        lowest = min([*(row.largest_error for row in kept), floor]) / 2
        axes.axhspan(lowest, floor, color="black", alpha=0.1, linewidth=0)
        for shift, (scene, (mark, colour)) in enumerate(zip(scenes, MARKS, strict=False)):
            mine = [row for row in kept if row.scene == scene]
            places = np.array([row.requested or 1.0 for row in mine]) * 1.06 ** (shift - 1.5)
            axes.loglog(places, [row.largest_error for row in mine], mark, color=colour, label=scene)
            late = [(place, row.largest_error) for place, row in zip(places, mine, strict=True) if not _keeps(row)]
            if late:
                axes.loglog(*zip(*late, strict=True), mark, color=RED, markersize=8, zorder=3)
        axes.set(xlabel="error asked for, share of white", ylabel="largest error reached", xlim=span, ylim=(lowest, span[1]))
        axes.legend(loc="upper left")
        return as_svg(figure)


def _calibrated(kept: Sequence[Row], missed: Sequence[Row]) -> str:
    shares = np.array([row.largest_error / (row.requested or 1.0) for row in kept])
    start = f"The largest error is in the median {np.median(shares):.2g} of what was asked for"
    if not missed:
        return f"{start}, and nowhere more than it within three of the reference's uncertainties."
    points = "the red point lies" if len(missed) == 1 else f"the {len(missed)} red points lie"
    return f"{start}; {points} above it by more than three of the reference's uncertainties, at most {shares.max():.1f} times as far."
