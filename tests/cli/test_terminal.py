"""What others said is shown and not obeyed, and what a terminal lacks ends no command."""

import io
import re
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rich import box
from rich.table import Table

from flflab.cli import main
from flflab.cli.saying import replace_what_the_terminal_lacks, say
from flflab.cli.terminal import Terminal
from flflab.printable import nearest, printable, shortened

Run = Callable[..., Any]
EVIL = "a\x1b]0;PWNED\x07[/bold][link=file:///etc/passwd]b\u202ec[red] :smile: \x9b31m"
SHOWN = r"a\x1b]0;PWNED\x07[/bold][link=file:///etc/passwd]b\u202ec[red] :smile: \x9b31m"


def test_what_does_not_show_is_written_as_python_writes_it() -> None:
    assert printable(EVIL) == SHOWN
    assert printable("12.5 µm ± 3 °, größer\n\tb") == "12.5 µm ± 3 °, größer\n\tb"
    assert printable("\r\x00\x7f\u200b\ud800") == r"\r\x00\x7f\u200b\ud800"


@pytest.mark.parametrize("colours", [False, True])
def test_tables_and_lines_show_brackets_and_escapes_as_they_are(
    colours: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if colours:
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("COLUMNS", "400")
    console = Terminal(piped=400)
    table = Table(title=EVIL)
    table.add_column(EVIL)
    table.add_row(EVIL)
    console.print(table, highlight=False)
    console.print(EVIL, highlight=False, soft_wrap=True)
    say(EVIL)
    said = capsys.readouterr()
    out = re.sub(r"\x1b\[[0-9;]*m", "", said.out)  # rich's own colours
    for evil in ("\x1b", "\x07", "\u202e", "\x9b"):
        assert evil not in out + said.err
    assert out.count(SHOWN) == 4
    assert said.err == f"{SHOWN}\n"


def test_a_table_is_as_wide_as_it_may_be_where_no_terminal_folds_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    table = Table()
    table.add_column("x" * 120)
    Terminal(piped=140).print(table)
    assert "x" * 120 in capsys.readouterr().out


@pytest.mark.parametrize("encoding", ["cp932", "gbk", "ascii", "cp1252", "utf-8"])
def test_a_character_that_the_terminal_lacks_is_replaced(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", out)
    replace_what_the_terminal_lacks()
    print("b = 1.15 mm ± 3 µm, χ² \udcff")
    Terminal().print("σ ≤ 2 µm — größer")
    out.flush()
    said = out.buffer.getvalue().decode(encoding)  # type: ignore[attr-defined]
    assert said.startswith("b = 1.15 mm ")
    assert ("±" in said) == (encoding != "ascii")


@pytest.mark.parametrize(
    ("given", "meant"),
    [("vallidate", "validate"), ("Plan", "plan"), ("calibrat", "calibrate"), ("mesure", "measure")],
)
def test_a_misspelt_command_is_told_with_the_one_it_is_likely_to_be(
    given: str, meant: str, flflab: Run
) -> None:
    ended = flflab(given)
    assert (ended.code, f"Did you mean '{meant}'?" in ended.err) == (2, True)
    assert "Traceback" not in ended.err


def test_a_word_that_is_like_no_other_has_no_nearest() -> None:
    assert nearest("xyzzy", ["validate", "plan"]) == ""
    assert nearest("f_numbr", ["focal_length", "f_number"]) == "f_number"


def test_a_long_value_is_cut_in_a_sentence() -> None:
    assert shortened("9" * 5000) == f"'{'9' * 79}..."
    assert shortened([1, 2]) == "[1, 2]"


def test_where_memory_runs_out_one_sentence_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def asks_for_too_much() -> None:
        np.empty(1 << 60, np.uint8)

    monkeypatch.setattr("flflab.cli.command.stranger_among_packages", asks_for_too_much)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("flflab: not enough memory (Unable to allocate 1.00 EiB")
    assert said.endswith("; ask for less at once, or close other programs")


@pytest.mark.parametrize("width", [120, 36, 24])
def test_a_terminal_narrower_than_a_table_shows_its_numbers_whole(
    width: int, capsys: pytest.CaptureFixture[str]
) -> None:
    table = Table(title="Places", box=box.SIMPLE)
    for head in ("axis", "reading\nmm", "world"):
        table.add_column(head)
    table.add_row("array_stage", "20.00000", "-60.0001")
    Terminal(piped=width).print_table(table)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= width
    for whole in ("Places", "array_stage", "20.00000", "-60.0001", "axis", "reading", "world"):
        assert whole in shown
    assert ("reading mm" in shown) == (width == 24)  # rows one below the other
