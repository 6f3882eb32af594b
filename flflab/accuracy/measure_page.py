"""The page of ``flflab accuracy measure``: error against time for every quantity, stated
uncertainty against error, and the table.
"""

from collections.abc import Sequence

import numpy as np

from flflab.accuracy.drawing import BLUE, GREY, ORANGE, PINK, as_svg, sheet
from flflab.accuracy.measure import (
    CLASSIC,
    EDGE,
    FIT,
    FRAMES,
    FREE,
    LATTICE,
    PITCH,
    REPEATS,
    Row,
)
from flflab.accuracy.page import Page, Picture, Section, Table
from flflab.accuracy.work_precision import order
from flflab.digits import two_digits

COLOURS = {FIT: ORANGE, CLASSIC: GREY, LATTICE: BLUE, FREE: PINK}
MARKS = ("o", "s", "^")


def measure_page(rows: Sequence[Row], made: str) -> Page:
    """Lay out the page.

    Args:
        rows: of ``measure_rows``.
        made: where and when they were measured.
    """
    quantities = tuple(dict.fromkeys(row.quantity for row in rows))
    times = tuple(Picture(_error_time(rows, one), one, _reads(rows, one)) for one in quantities)
    return Page(
        "What accuracy costs: measuring",
        tuple(_answer(rows, one) for one in quantities),
        (
            Section(
                "Error against time",
                (
                    (
                        "Each point is one method on so many frames, averaged; the time is the"
                        " camera's, 0.1 s a frame, and the processor's. Filled marks are the root"
                        " mean square of the errors, hollow ones the uncertainty that the method"
                        " states. A line that turns level is biased: more frames do not help it."
                        " Larger marks are larger pictures."
                    ),
                ),
                times,
            ),
            Section(
                "Is the stated uncertainty true?",
                ("On the diagonal the errors are as large as stated; above it larger.",),
                (
                    Picture(
                        _calibration(rows), "stated uncertainty against error", _calibrated(rows)
                    ),
                ),
            ),
            Section(
                "How it was measured",
                (
                    (
                        "Simulated frames with the noise of a sensor (1 % at white), shot and read"
                        f" noise, drawn anew for each of {REPEATS} repeats; frames from {FRAMES[0]}"
                        f" to {FRAMES[-1]}. Bars and white: the camera of the worked example at F/4"
                        " in focus, on the middle of its sensor; the truth is the transfer of"
                        " pixel and blur in closed form, for max and min eq. (2)'s 1 up to half a"
                        " cycle a pixel, and the described lattice, its pitch in units of itself."
                        " Edge: 5 degrees, a Gaussian blur of 0.7 px, from 0.2 to 0.8 of white;"
                        " the truth is its transfer function up to half a cycle a pixel."
                    ),
                ),
            ),
            Section("All figures", tables=(measure_table(rows),)),
        ),
        made,
    )


def measure_table(rows: Sequence[Row]) -> Table:
    """Every row, for people."""
    headings = (
        "quantity",
        "method",
        "px",
        "frames",
        "rms error",
        "stated",
        "bias",
        "camera s",
        "processor s",
    )
    cells = tuple(
        (
            row.quantity, row.method, f"{row.pixels}", f"{row.frames}", f"{row.rms_error:.2e}",
            "none" if row.uncertainty is None else two_digits(row.uncertainty), f"{row.bias:+.1e}",
            f"{row.camera_s:.1f}",
            f"{row.processor_s:.4f}",
        )
        for row in rows
    )  # fmt: skip
    return Table("Errors against the truth; times for measuring once", headings, cells)


def measure_summary(rows: Sequence[Row]) -> Table:
    """What a terminal has room for."""
    whole = measure_table(rows)
    kept = (0, 1, 2, 3, 4, 5)
    return Table(
        "Root mean square error and stated uncertainty",
        tuple(whole.headings[n] for n in kept),
        tuple(tuple(row[n] for n in kept) for row in whole.rows),
    )


def _lines(rows: Sequence[Row], quantity: str) -> list[list[Row]]:
    """Rows of one method and picture size, rising with the frames."""
    mine = [row for row in rows if row.quantity == quantity]
    keys = dict.fromkeys((row.method, row.pixels) for row in mine)
    return [[row for row in mine if (row.method, row.pixels) == key] for key in keys]


def _error_time(rows: Sequence[Row], quantity: str) -> str:
    with sheet(5.2, 3.9) as figure:
        axes = figure.add_subplot()
        sizes = sorted({row.pixels for row in rows if row.quantity == quantity})
        for line in _lines(rows, quantity):
            colour, size = COLOURS[line[0].method], 4 + 1.6 * sizes.index(line[0].pixels)
            label = f"{line[0].method}, {line[0].pixels / 1e6:.2g} Mpx"
            axes.loglog(
                [row.total_s for row in line],
                [row.rms_error for row in line],
                "o-",
                color=colour,
                markersize=size,
                label=label,
            )
            stated = [(row.total_s, row.uncertainty) for row in line if row.uncertainty is not None]
            if stated:
                axes.loglog(
                    *zip(*stated, strict=True),
                    "o:",
                    color=colour,
                    markersize=size,
                    markerfacecolor="white",
                    linewidth=0.8,
                )
        axes.set(xlabel="time of camera and processor, s", ylabel="error", title=quantity)
        axes.legend(loc="best")
        return as_svg(figure)


def _calibration(rows: Sequence[Row]) -> str:
    with sheet(5.2, 4.4) as figure:
        axes = figure.add_subplot()
        known = [row for row in rows if row.uncertainty is not None]
        values = [
            value for row in known for value in (row.rms_error, row.uncertainty or row.rms_error)
        ]
        span = np.array([min(values) / 2, max(values) * 2])
        axes.loglog(span, span, color="black", linewidth=0.8)
        for mark, quantity in zip(
            MARKS, dict.fromkeys(row.quantity for row in known), strict=False
        ):
            for method in dict.fromkeys(row.method for row in known if row.quantity == quantity):
                mine = [row for row in known if row.quantity == quantity and row.method == method]
                label = f"{quantity}: {method}"
                axes.loglog(
                    [row.uncertainty for row in mine],
                    [row.rms_error for row in mine],
                    mark,
                    color=COLOURS[method],
                    label=label,
                )
        axes.set(xlabel="uncertainty stated", ylabel="root mean square error", xlim=span, ylim=span)
        axes.legend(loc="upper left")
        return as_svg(figure)


def _calibrated(rows: Sequence[Row]) -> str:
    ratios = [row.rms_error / row.uncertainty for row in rows if row.uncertainty]
    return (
        f"Errors are {min(ratios):.2f} to {max(ratios):.2f} times what was stated, in the median"
        f" {np.median(ratios):.2f} times."
    )


def _answer(rows: Sequence[Row], quantity: str) -> str:
    best = [row for row in rows if row.quantity == quantity and row.method != CLASSIC]
    one = min((row for row in best if row.frames == 1), key=lambda row: row.rms_error)
    return (
        f"{quantity.capitalize()}: {'relative ' * (quantity == PITCH)}rms error"
        f" {two_digits(one.rms_error)} from one"
        f" frame of {one.pixels / 1e6:.2g} megapixels ({one.method}), in"
        f" {one.processor_s:.2g} s of processor time."
    )


def _reads(rows: Sequence[Row], quantity: str) -> str:
    slopes = {
        line[0].method: order([row.frames for row in line], [row.rms_error for row in line])
        for line in reversed(_lines(rows, quantity))
    }
    words = ", ".join(f"{method} {slope:.2f}" for method, slope in sorted(slopes.items()))
    tail = " The free form does not assume the Gaussian that is there." if quantity == EDGE else ""
    return (
        f"The error falls as the number of frames to the power: {words} (-0.50 where noise alone"
        f" decides).{tail}"
    )
