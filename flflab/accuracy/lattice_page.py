"""The page of ``flflab accuracy lattice``: errors of centres and pitch against the f-number, stated
next to achieved, and the table.
"""

from collections.abc import Sequence

from matplotlib.ticker import NullFormatter, ScalarFormatter

from flflab.accuracy.drawing import BLUE, GREY, ORANGE, as_svg, sheet
from flflab.accuracy.lattice import FRAMES, Row
from flflab.accuracy.page import Page, Picture, Section, Table
from flflab.digits import two_digits


def lattice_page(rows: Sequence[Row], camera: str, made: str) -> Page:
    """Lay out the page.

    Args:
        rows: of ``lattice_rows``.
        camera: its name.
        made: where and when they were measured.
    """
    return Page(
        f"Lattice of micro-images from a white picture: {camera}",
        (_answer(rows),),
        (
            Section(
                "Error against the f-number",
                (
                    (
                        "Hollow marks are the standard uncertainties that the measurement states,"
                        " filled ones what it was wrong by, root mean square. The grey line is what"
                        " is left without noise, at the worst centre of all."
                    ),
                ),
                (
                    Picture(
                        _origins(rows), "error of the origin against the f-number", _reads(rows)
                    ),
                    Picture(
                        _pitches(rows),
                        "error of the pitch against the f-number",
                        "The same of the pitch, as a share of it.",
                    ),
                ),
            ),
            Section(
                "How it was measured",
                (
                    (
                        "Simulated white frames of the whole sensor with natural fall-off, shot"
                        " and read noise, 1 % where the light is brightest, drawn anew for each of"
                        f" {FRAMES} frames an f-number; fall-off and tilt are fitted. The truth is"
                        " the lattice of the camera file."
                    ),
                ),
            ),
            Section("All figures", tables=(lattice_table(rows),)),
        ),
        made,
    )


def lattice_table(rows: Sequence[Row]) -> Table:
    """Every row, for people."""
    headings = ("F/", "micro-images", "bias px", "pitch bias", "origin px", "pitch", "centres px")
    cells = tuple(
        (
            f"{row.f_number:g}", f"{row.micro_images}", f"{row.bias_px:.5f}",
            f"{row.pitch_bias:+.0e}",
            f"{row.origin_px:.4f} ({row.origin_error_px:.4f})",
            f"{row.pitch:.1e} ({row.pitch_error:.1e})", f"({row.centres_error_px:.4f})",
        )
        for row in rows
    )  # fmt: skip
    return Table(
        "Lattice from one white frame: stated standard uncertainty and, in brackets, the error"
        " achieved, rms",
        headings,
        cells,
    )


def lattice_summary(rows: Sequence[Row]) -> Table:
    """What a terminal has room for."""
    whole = lattice_table(rows)
    kept = (0, 1, 2, 4, 5)
    return Table(
        whole.caption,
        tuple(whole.headings[n] for n in kept),
        tuple(tuple(row[n] for n in kept) for row in whole.rows),
    )


def _answer(rows: Sequence[Row]) -> str:
    worst, most = max(rows, key=lambda row: row.bias_px), max(rows, key=lambda row: row.origin_px)
    pitch = max(row.pitch for row in rows)
    return (
        f"Without noise the largest error of a centre is {two_digits(worst.bias_px)} px"
        f" (F/{worst.f_number:g}); one white frame gives the origin to"
        f" {two_digits(most.origin_px)} px and the pitch to {two_digits(pitch)} of it at every"
        " f-number."
    )


def _reads(rows: Sequence[Row]) -> str:
    ratios = [row.origin_error_px / row.origin_px for row in rows]
    return (
        f"Errors of the origin are {min(ratios):.2f} to {max(ratios):.2f} times what is stated;"
        f" {FRAMES} frames scatter that by a quarter."
    )


def _origins(rows: Sequence[Row]) -> str:
    return _drawn(
        rows,
        [row.origin_px for row in rows],
        [row.origin_error_px for row in rows],
        [row.bias_px for row in rows],
        "origin",
        "error, px",
    )


def _pitches(rows: Sequence[Row]) -> str:
    bias = [abs(row.pitch_bias) for row in rows]
    return _drawn(
        rows,
        [row.pitch for row in rows],
        [row.pitch_error for row in rows],
        bias,
        "pitch",
        "error, share of the pitch",
    )


def _drawn(
    rows: Sequence[Row],
    stated: Sequence[float],
    achieved: Sequence[float],
    bias: Sequence[float],
    title: str,
    label: str,
) -> str:
    with sheet(5.2, 3.9) as figure:
        axes = figure.add_subplot()
        stops = [row.f_number for row in rows]
        axes.loglog(stops, stated, "o", color=BLUE, markerfacecolor="white", label="stated")
        axes.loglog(stops, achieved, "o", color=ORANGE, label="achieved")
        axes.loglog(stops, bias, ":", color=GREY, label="without noise")
        axes.set(xlabel="f-number", ylabel=label, title=title)
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xticks(stops)
        axes.legend(loc="best")
        return as_svg(figure)
