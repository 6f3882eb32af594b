"""The line of progress and the tables of a verdict on narrow terminals."""

import io
import math

import pytest
from rich.console import Console

from flflab.cli.progress import counted_progress
from flflab.cli.run import time_left
from flflab.cli.verdict import verdict_table
from flflab.verdict.comparison import Comparison, Verdict

FRAMES = (
    (0, None, "", "connect"),
    (7, 53, "", "home array_stage and sensor_stage"),
    (12, 53, "~3 h 20 min left", "configuration 3, four-dot, frame 0; exposure 7.81 ms, gain 1"),
    (100, 1053, "~40 s left", "move"),
)


@pytest.mark.parametrize("width", [80, 60])
def test_progress_is_one_line_whose_columns_stay_where_they_are(width: int) -> None:
    console = Console(width=width, file=io.StringIO(), force_terminal=True, color_system=None)
    starts: set[tuple[int, int]] = set()
    shown: list[str] = []
    for done, total, left, what in FRAMES:
        bar = counted_progress(console)
        bar.add_task(what, total=total, completed=done, left=left)
        with console.capture() as taken:
            console.print(bar.get_renderable())
        (line,) = taken.get().splitlines()
        assert len(line) <= width
        shown.append(line)
        starts.add((line.index("-:--:--") if "-:--:--" in line else line.index("0:00:0"),
                    line.index(what[:4])))  # fmt: skip
    assert len(starts) == 1
    assert "12/53" in shown[2]
    assert "~3 h 20 min left" in shown[2]


def test_no_time_is_said_while_nobody_knows() -> None:
    assert time_left(math.nan) == ""
    assert time_left(11999) == "~3 h 20 min left"


@pytest.mark.parametrize("width", [120, 80, 60, 50, 40])
def test_every_width_shows_every_verdict_whole(width: int) -> None:
    verdicts = (
        Verdict("micro_images_mm", 9, 1 / 501, 500, 8.0, 0.00625, False, ""),
        Verdict("elr_row_px", 3, 0.5, 500, 1.0, 0.00625, True, ""),
    )
    console = Console(width=width, file=io.StringIO())
    with console.capture() as taken:
        console.print(verdict_table(Comparison((), verdicts), width))
    shown = taken.get()
    assert max(len(line) for line in shown.splitlines()) <= width
    assert "rejected" in shown
    assert "agrees" in shown
    assert "50 %" in shown
    assert ("none of 500, p < 0.2 %" in shown) == (width >= 50)
    assert "…" not in shown
    assert ("reject below" in shown) == (width >= 72)
