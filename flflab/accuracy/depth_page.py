"""The page of ``flflab accuracy depth``: error of the triangulated depth against distance, model
next to measurement, and the table.
"""

from collections.abc import Sequence

from flflab.accuracy.depth import PLACES, Row
from flflab.accuracy.drawing import BLUE, GREY, ORANGE, as_svg, sheet
from flflab.accuracy.page import Page, Picture, Section, Table
from flflab.digits import two_digits


def depth_page(rows: Sequence[Row], camera: str, made: str) -> Page:
    """Lay out the page.

    Args:
        rows: of ``depth_rows``.
        camera: its name.
        made: where and when they were measured.
    """
    return Page(
        f"Depth error against distance: {camera}",
        _answers(rows),
        (
            Section(
                "Error against distance",
                (
                    (
                        "Depth error of one dot, triangulated from its views. Line: limit by noise"
                        " in the model. Hollow marks: stated uncertainty (noise, and errors of fits"
                        " to blurred and cut spots). Filled marks: actual error. Grey line: shift"
                        " caused by 1 µm error of the camera file's gap."
                    ),
                ),
                (
                    Picture(_errors(rows), "depth error against distance", _reads(rows)),
                    Picture(
                        _views(rows),
                        "views and blur against distance",
                        "How many views a dot has, by the model and as measured, and the blur on"
                        " the sensor.",
                    ),
                ),
            ),
            Section(
                "How it was measured",
                (
                    (
                        "Simulated frames of the whole sensor with shot and read noise, 1 % at"
                        f" white, without fall-off and distortion: {len(PLACES)} places of the"
                        " target sideways at each distance, four dots in a frame, the lattice"
                        " measured from a white frame. Dots are 16 px wide in focus and 8"
                        " diameters apart; distances go to where the blur is as wide as a dot. The"
                        " camera file is taken as true."
                    ),
                ),
            ),
            Section("All figures", tables=(depth_table(rows),)),
        ),
        made,
    )


def depth_table(rows: Sequence[Row]) -> Table:
    """Every row, for people."""
    headings = (
        "distance",
        "blur px",
        "views: model",
        "measured",
        "by noise",
        "stated",
        "achieved",
        "bias",
        "1 µm of gap",
    )
    cells = tuple(
        (
            f"{row.distance_mm:.1f}", f"{row.blur_px:.2f}", f"{row.model_views:.2f}",
            f"{row.views:.2f}", _mm(row.model_mm),
            _mm(row.stated_mm), _mm(row.rms_error_mm),
            "none" if row.bias_mm is None else f"{row.bias_mm:+.4f}", f"{row.gap_mm_per_um:.3f}",
        )
        for row in rows
    )  # fmt: skip
    return Table(
        "Depth of a dot by triangulation, mm; standard uncertainties and root mean square errors",
        headings,
        cells,
    )


def depth_summary(rows: Sequence[Row]) -> Table:
    """What a terminal has room for."""
    headings = ("distance", "views", "by noise", "stated", "achieved", "1 µm gap")
    cells = tuple(
        (
            f"{row.distance_mm:.1f}",
            f"{row.views:.2f}",
            _mm(row.model_mm),
            _mm(row.stated_mm),
            _mm(row.rms_error_mm),
            f"{row.gap_mm_per_um:.3f}",
        )
        for row in rows
    )
    return Table("Error of a dot's depth by triangulation, mm", headings, cells)


def _mm(value: float | None) -> str:
    return "none" if value is None else two_digits(value)


def _errors(rows: Sequence[Row]) -> str:
    with sheet(5.2, 3.9) as figure:
        axes = figure.add_subplot()
        model = [(row.distance_mm, row.model_mm) for row in rows if row.model_mm is not None]
        stated = [(row.distance_mm, row.stated_mm) for row in rows if row.stated_mm is not None]
        achieved = [
            (row.distance_mm, row.rms_error_mm) for row in rows if row.rms_error_mm is not None
        ]
        for points, style, label in (
            (model, {"linestyle": "-", "color": BLUE}, "model: noise alone"),
            (
                stated,
                {"linestyle": "", "marker": "o", "color": ORANGE, "markerfacecolor": "white"},
                "stated",
            ),
            (achieved, {"linestyle": "", "marker": "o", "color": ORANGE}, "achieved"),
            (
                [(row.distance_mm, row.gap_mm_per_um) for row in rows],
                {"linestyle": ":", "color": GREY},
                "1 µm of the gap",
            ),
        ):
            axes.semilogy(
                [at for at, _ in points], [value for _, value in points], label=label, **style
            )
        axes.set(
            xlabel="distance of the target, mm", ylabel="depth error, mm", title="depth of a dot"
        )
        axes.legend(loc="best")
        return as_svg(figure)


def _views(rows: Sequence[Row]) -> str:
    with sheet(5.2, 3.9) as figure:
        axes = figure.add_subplot()
        away = [row.distance_mm for row in rows]
        axes.plot(away, [row.model_views for row in rows], color=BLUE, label="views, model")
        axes.plot(away, [row.views for row in rows], "o", color=ORANGE, label="views, measured")
        axes.plot(away, [row.blur_px for row in rows], ":", color=GREY, label="blur, px")
        axes.set(
            xlabel="distance of the target, mm",
            ylabel="views of a dot; blur, px",
            title="views and blur",
            ylim=(0, None),
        )
        axes.legend(loc="best")
        return as_svg(figure)


def _answers(rows: Sequence[Row]) -> tuple[str, ...]:
    found = [row for row in rows if row.rms_error_mm is not None]
    if not found:
        return ("At none of these distances does a dot have the two views that depth takes.",)
    best = min(found, key=lambda row: row.blur_px)
    worst = max(found, key=lambda row: row.rms_error_mm or 0.0)
    return (
        (
            f"In focus, at {best.distance_mm:.1f} mm, a dot's depth has an rms error of"
            f" {_mm(best.rms_error_mm)} mm (stated {_mm(best.stated_mm)} mm, from noise alone"
            f" {_mm(best.model_mm)} mm); at worst, at {worst.distance_mm:.1f} mm,"
            f" {_mm(worst.rms_error_mm)} mm."
        ),
        (
            "The camera file is taken as true: an error of 1 µm of its gap moves the depth in focus"
            f" by {best.gap_mm_per_um:.3f} mm."
        ),
    )


def _reads(rows: Sequence[Row]) -> str:
    found = [row for row in rows if row.rms_error_mm is not None and row.stated_mm]
    if not found:
        return "No depth was found."
    achieved = [(row.rms_error_mm or 0.0) / (row.stated_mm or 1.0) for row in found]
    against = [(row.stated_mm or 0.0) / row.model_mm for row in found if row.model_mm]
    return (
        f"Errors are {min(achieved):.2f} to {max(achieved):.2f} times what is stated; what is"
        f" stated is {min(against):.2f} to {max(against):.2f} times what noise alone makes."
    )
