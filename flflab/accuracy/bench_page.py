"""The page of ``flflab accuracy bench``: time of a validation against the accuracy of its pictures,
and what the verdict gains.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from flflab.accuracy.drawing import BLUE, GREEN, ORANGE, RED, as_svg, sheet
from flflab.accuracy.page import Page, Picture, Section, Table

NOTICED = 0.9  # of the time: what saves less is not worth a word


@dataclass(frozen=True)
class BenchRow:
    """One validation.

    Attributes:
        tolerance: of the drawn charts, root mean square of white.
        frames: of every point.
        recording_s: that recording took, s.
        judging_s: that measuring, comparing and reporting took, s.
        rms_z: root mean square of all standardised differences from the model.
        rms_z_contrast: the same of contrasts.
        least_p: p-value of the quantity that is nearest to being rejected.
        least_p_of: its name.
        uncertainty_contrast: median standard uncertainty of a difference of contrast.
        accepted: the verdict.
    """

    tolerance: float
    frames: int
    recording_s: float
    judging_s: float
    rms_z: float
    rms_z_contrast: float
    least_p: float
    least_p_of: str
    uncertainty_contrast: float
    accepted: bool

    @property
    def seconds(self) -> float:
        """Of the whole validation."""
        return self.recording_s + self.judging_s


def bench_page(rows: Sequence[BenchRow], made: str) -> Page:
    """Lay out the page.

    Args:
        rows: one a setting.
        made: where and when they were measured.
    """
    return Page(
        "What accuracy costs: a validation",
        bench_advice(rows),
        (
            Section(
                "Time and verdict",
                (
                    "Each mark is one validation of the same simulated bench. Left: how long it"
                    " took. Right: how far measurement and model lie apart, in their own"
                    " uncertainties; near 1 is honest.",
                ),
                (
                    Picture(
                        _against(rows, "seconds", "time of a validation, s"),
                        "time against accuracy",
                        "Drawing more finely takes longer; where the curve is flat it costs"
                        " nothing.",
                    ),
                    Picture(
                        _against(rows, "rms_z", "rms z of all values"),
                        "rms z against accuracy",
                        "Where rms z no longer falls, finer pictures gain the verdict nothing.",
                    ),
                ),
            ),
            Section("All figures", tables=(bench_table(rows),)),
        ),
        made,
    )


def bench_advice(rows: Sequence[BenchRow]) -> tuple[str, ...]:
    """What to do: the coarsest pictures whose verdict and rms z are those of the finest."""
    single = sorted((row for row in rows if row.frames == 1), key=lambda row: row.tolerance)
    finest = single[0]
    good = [
        row for row in single if row.accepted == finest.accepted and row.rms_z <= 1.1 * finest.rms_z
    ]
    enough = good[-1]
    faster = enough.seconds < NOTICED * finest.seconds
    sentences = [
        f"Pictures drawn to {enough.tolerance:.2g} of white are enough: rms z is"
        f" {enough.rms_z:.2f} against {finest.rms_z:.2f} at {finest.tolerance:.2g}, and a"
        f" validation takes {enough.seconds:.0f} s"
        + (f" instead of {finest.seconds:.0f} s; finer ones buy nothing." if faster else
           ", no less than with finer ones.")
    ]  # fmt: skip
    sentences += [
        f"{more.frames} frames a point take {more.seconds:.0f} s; the uncertainty of a contrast"
        f" becomes {more.uncertainty_contrast:.2g} where one frame leaves"
        f" {one.uncertainty_contrast:.2g}."
        for more in rows
        if more.frames > 1
        for one in single
        if one.tolerance == more.tolerance
    ]
    turned = [row for row in single if row.accepted != finest.accepted]
    if turned:
        coarse = min(row.tolerance for row in turned)
        sentences.append(f"From {coarse:.2g} of white on the verdict is another one.")
    return tuple(sentences)


def bench_table(rows: Sequence[BenchRow]) -> Table:
    """Every row, for people."""
    cells = tuple(
        (
            f"{row.tolerance:.2g}",
            str(row.frames),
            f"{row.recording_s:.0f}",
            f"{row.judging_s:.0f}",
            f"{row.rms_z:.2f}",
            f"{row.rms_z_contrast:.2f}",
            f"{row.least_p:.2g} ({row.least_p_of})",
            "agrees" if row.accepted else "rejected",
        )
        for row in rows
    )
    headings = ("drawn to", "frames", "record s", "judge s", "rms z", "of contrast", "least p",
                "verdict")  # fmt: skip
    return Table(
        "Validations of one simulated bench, its pictures drawn to such a share of white",
        headings, cells,
    )  # fmt: skip


def _against(rows: Sequence[BenchRow], name: str, label: str) -> str:
    with sheet(4.6, 3.6) as figure:
        axes = figure.add_subplot()
        for frames, colour in zip(sorted({row.frames for row in rows}), (ORANGE, BLUE, GREEN),
                                  strict=False):  # fmt: skip
            mine = sorted(
                (row for row in rows if row.frames == frames), key=lambda row: row.tolerance
            )
            said = "1 frame a point" if frames == 1 else f"{frames} frames a point"
            axes.plot([row.tolerance for row in mine], [getattr(row, name) for row in mine], "o-",
                      color=colour, label=said)  # fmt: skip
            bad = [row for row in mine if not row.accepted]
            axes.plot([row.tolerance for row in bad], [getattr(row, name) for row in bad], "x",
                      color=RED, markersize=9)  # fmt: skip
        axes.set(xscale="log", xlabel="pictures drawn to, share of white (rms)", ylabel=label)
        axes.set_ylim(0, 1.15 * max(getattr(row, name) for row in rows))
        axes.legend()
        return as_svg(figure)
