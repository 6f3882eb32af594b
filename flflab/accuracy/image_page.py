"""The page of ``flflab accuracy image``: error against time on every scene, requested against
achieved error, and the table.
"""

from collections.abc import Sequence

import numpy as np

from flflab.accuracy.drawing import BLUE, GREEN, GREY, ORANGE, PINK, RED, as_svg, sheet
from flflab.accuracy.image import GRID, PIXELS, RANDOM, RENDER
from flflab.accuracy.page import Page, Picture, Section, Table
from flflab.accuracy.work_precision import Row, order, random_cost

COLOURS = {RENDER: ORANGE, RANDOM: BLUE, GRID: GREY}
MARKS = (("o", BLUE), ("s", ORANGE), ("^", GREEN), ("D", PINK))
PROMISES = {"requested": "requested", "estimate": "estimated"}
QUOTED = 0.003  # the tolerance at which the sentences compare


def image_page(rows: Sequence[Row], made: str) -> Page:
    """Lay out the page.

    Args:
        rows: of ``image_rows``.
        made: where and when they were measured.
    """
    scenes = tuple(dict.fromkeys(row.scene for row in rows))
    limits = _limits(rows)
    times = tuple(
        Picture(
            _error_time([row for row in rows if row.scene == one], one, limits),
            one,
            _reads(rows, one),
        )
        for one in scenes
    )
    kept = [row for row in rows if row.requested is not None]
    missed = [row for row in kept if _exceeds(row, "requested")]
    promise = f"Render kept {len(kept) - len(missed)} of the {len(kept)} tolerances requested"
    above = {
        scene: ", ".join(f"{row.requested:g}" for row in missed if row.scene == scene)
        for scene in scenes
    }
    promise += (
        "".join(f"; {scene} exceeds {values}" for scene, values in above.items() if values) + "."
    )
    largest = max(row.reference_uncertainty for row in rows)
    return Page(
        "What accuracy costs: pictures",
        (promise, *(_gain(rows, one) for one in scenes)),
        (
            Section(
                "Error against time",
                (
                    (
                        "Each point is one method at one setting. Farther down is more exact,"
                        " farther left is faster; both axes are logarithmic. Filled marks are the"
                        " root mean square of the errors, hollow ones the largest. Time is that of"
                        " all processor cores for a million lit pixels, warm."
                    ),
                ),
                times,
            ),
            Section(
                "Requested, estimated and actual error",
                (
                    (
                        "On the diagonal a picture is exactly as wrong as was allowed, or as was"
                        " estimated; below it, better; red points lie above it by more than three"
                        " of the reference's uncertainties."
                    ),
                ),
                (
                    Picture(
                        _calibration(kept, "requested"),
                        "requested against reached error",
                        _calibrated(kept, "requested"),
                    ),
                    Picture(
                        _calibration(kept, "estimate"),
                        "estimated against reached error",
                        _calibrated(kept, "estimate"),
                    ),
                ),
            ),
            Section(
                "How it was measured",
                (
                    (
                        "Reference: the light common to both apertures as chords in closed form, a"
                        " dense sum over the other two coordinates (flflab.accuracy.chords). It"
                        " shares no code with render, and tests compare it with rays traced one by"
                        " one. Its uncertainty, the difference to half as many nodes, is"
                        f" {largest:.1g} of white or less (root mean square of a scene's pixels)."
                        f" The pixels, {PIXELS} a scene, are drawn at random where light falls or"
                        " nearly falls."
                    ),
                    (
                        "random rays: independent rays from pixel to chart, the plain way. rays on"
                        " a grid: the same rays, their four coordinates in equal steps. Both run"
                        " compiled on one core. render: closed forms along rows, quadrature across"
                        " them."
                    ),
                    (
                        "Scenes: a chart of sines, 20 to 620 cycles across, before a 50 mm lens"
                        " with an array of 0.9 mm lenses; the middle of the sensor. Paraxial light,"
                        " no noise, no diffraction."
                    ),
                ),
            ),
            Section("All figures", tables=(image_table(rows),)),
        ),
        made,
    )


def image_table(rows: Sequence[Row]) -> Table:
    """Every row, for people."""
    headings = (
        "scene", "method", "tolerance, or rays", "largest error", "rms error", "own estimate",
        "reference uncertainty",
        "processor s", "wall s", "first run, s", "processor s for a million lit px",
        "million lit px/s",
    )  # fmt: skip
    cells = tuple(
        (
            row.scene, row.method, _asked(row),
            f"{row.largest_error:.1e}", f"{row.rms_error:.1e}",
            "" if row.estimate is None else f"{row.estimate:.1e}",
            f"{row.reference_uncertainty:.0e}", f"{row.processor_s:.4f}",
            f"{row.wall_s:.4f}", f"{row.first_s:.3f}", f"{row.processor_s_per_megapixel:.3g}",
            f"{row.lit_megapixels_per_s:.3g}",
        )
        for row in rows
    )  # fmt: skip
    return Table(
        "Errors in units of the white level; times are medians, warm, except the first run's",
        headings,
        cells,
    )


def image_summary(rows: Sequence[Row]) -> Table:
    """What a terminal has room for."""
    headings = ("scene", "method", "asked", "largest", "rms", "s/Mpx")
    cells = tuple(
        (
            row.scene,
            row.method,
            _asked(row),
            f"{row.largest_error:.1e}",
            f"{row.rms_error:.1e}",
            f"{row.processor_s_per_megapixel:.3g}",
        )
        for row in rows
    )
    return Table(
        "Errors in units of the white level; processor seconds for a million lit pixels",
        headings,
        cells,
    )


def _asked(row: Row) -> str:
    return f"{row.requested:g}" if row.requested is not None else f"{row.work:.0f}"


def _of(rows: Sequence[Row], scene: str, method: str) -> list[Row]:
    return [row for row in rows if row.scene == scene and row.method == method]


def _quoted(rows: Sequence[Row], scene: str) -> Row:
    return min(
        _of(rows, scene, RENDER), key=lambda row: abs(np.log((row.requested or 1.0) / QUOTED))
    )


def _gain(rows: Sequence[Row], scene: str) -> str:
    ours = _quoted(rows, scene)
    times = random_cost(_of(rows, scene, RANDOM), ours.rms_error) / ours.processor_s_per_megapixel
    return (
        f"{scene}: at a tolerance of {ours.requested:g}, a million lit pixels take"
        f" {ours.processor_s_per_megapixel:.2g} s and have an rms error of"
        f" {ours.rms_error:.1g}. Monte Carlo rays, extrapolated from their N^-1/2 law, would take"
        f" {_round(times)} times as long."
    )


def _round(value: float) -> str:
    """One significant digit."""
    return f"{float(f'{value:.1g}'):,.0f}"


def _reads(rows: Sequence[Row], scene: str) -> str:
    random = _of(rows, scene, RANDOM)
    slope = order([row.work or 1.0 for row in random], [row.rms_error for row in random])
    ours = _of(rows, scene, RENDER)
    cheap, dear = ours[0], ours[-1]
    slower = _round(dear.processor_s / cheap.processor_s)
    takes = "takes as long" if slower == "1" else f"takes {slower} times as long"
    return (
        f"{scene}: at a tolerance of {dear.requested:g} render {takes} as at"
        f" {cheap.requested:g}; the error of random rays falls as their number to the power"
        f" {slope:.2f}, so one more digit costs them a hundred times the time."
    )


def _limits(rows: Sequence[Row]) -> tuple[tuple[float, float], tuple[float, float]]:
    """One range of times and one of errors for all scenes, so that they can be compared by eye."""
    times = [row.processor_s_per_megapixel for row in rows]
    errors = [error for row in rows for error in (row.rms_error, row.largest_error)]
    return (min(times) / 2, max(times) * 2), (
        min(*errors, *(row.reference_uncertainty for row in rows)) / 2,
        max(errors) * 2,
    )


def _error_time(
    rows: Sequence[Row], scene: str, limits: tuple[tuple[float, float], tuple[float, float]]
) -> str:
    with sheet(5.2, 3.9) as figure:
        axes = figure.add_subplot()
        for method, colour in COLOURS.items():
            mine = _of(rows, scene, method)
            times = [row.processor_s_per_megapixel for row in mine]
            axes.loglog(times, [row.rms_error for row in mine], "o-", color=colour, label=method)
            axes.loglog(
                times,
                [row.largest_error for row in mine],
                "o:",
                color=colour,
                markerfacecolor="white",
                linewidth=0.8,
            )
        axes.axhspan(
            limits[1][0], rows[0].reference_uncertainty, color="black", alpha=0.1, linewidth=0
        )
        random = _of(rows, scene, RANDOM)
        span = np.array([min(row.processor_s_per_megapixel for row in random), limits[0][1]])
        law = np.sqrt(random_cost(random, 1.0) / span)
        axes.loglog(span, law, "--", color=BLUE, linewidth=0.8, zorder=0)
        axes.annotate(
            "slope -1/2",
            (span[1], law[1]),
            (-2, -12),
            textcoords="offset points",
            ha="right",
            fontsize=7.5,
            color=BLUE,
        )
        axes.set(
            xlabel="processor time for a million lit pixels, s",
            ylabel="error, share of white",
            title=scene,
            xlim=limits[0],
            ylim=limits[1],
        )
        axes.legend(
            loc="upper right",
            bbox_to_anchor=(1.0, 1.08),
            ncols=3,
            columnspacing=1.2,
            handlelength=1.6,
        )
        return as_svg(figure)


def _calibration(kept: Sequence[Row], promise: str) -> str:
    with sheet(5.2, 4.4) as figure:
        axes = figure.add_subplot()
        known = [row for row in kept if _promised(row, promise) > 0]
        floor = max(row.reference_uncertainty for row in kept)
        values = [
            floor,
            *(row.rms_error for row in kept),
            *(_promised(row, promise) for row in known),
        ]
        span = np.array([min(values) / 2, max(values) * 2])
        axes.loglog(span, span, color="black", linewidth=0.8)
        axes.axhspan(span[0], floor, color="black", alpha=0.1, linewidth=0)
        for scene, (mark, colour) in zip(
            dict.fromkeys(row.scene for row in kept), MARKS, strict=False
        ):
            mine = [row for row in known if row.scene == scene]
            axes.loglog(
                [_promised(row, promise) for row in mine],
                [row.rms_error for row in mine],
                mark,
                color=colour,
                label=scene,
            )
            late = [row for row in mine if _exceeds(row, promise)]
            places = [_promised(row, promise) for row in late]
            axes.loglog(
                places, [row.rms_error for row in late], mark, color=RED, markersize=8, zorder=3
            )
        axes.set(
            xlabel=f"error {PROMISES[promise]}, share of white",
            ylabel="rms error reached",
            xlim=span,
            ylim=span,
        )
        axes.legend(loc="upper left")
        return as_svg(figure)


def _calibrated(kept: Sequence[Row], promise: str) -> str:
    shares = np.array(
        [row.rms_error / _promised(row, promise) for row in kept if _promised(row, promise) > 0]
    )
    exceeding = [row for row in kept if _exceeds(row, promise)]
    what = PROMISES[promise]
    if not len(shares):
        return f"Nothing was {what}."
    start = f"The rms error is in the median {np.median(shares):.2g} of what was {what}"
    if not exceeding:
        return f"{start}, and nowhere more than it."
    points = "one picture is" if len(exceeding) == 1 else f"{len(exceeding)} pictures are"
    return (
        f"{start}; {points} further off than {what}, at most {float(f'{shares.max():.2g}'):g} times"
        " as far."
    )


def _promised(row: Row, promise: str) -> float:
    return float(getattr(row, promise) or 0.0)


def _exceeds(row: Row, promise: str) -> bool:
    return 0 < _promised(row, promise) < row.rms_error - 3 * row.reference_uncertainty
