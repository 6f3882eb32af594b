"""A command that works for long says so on a terminal, and leaves standard output alone."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from numba.core.event import trigger_event

from flflab.cli import at_work
from flflab.image import picture

Run = Callable[..., Any]


def test_where_no_terminal_is_nothing_is_said(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(at_work, "SILENCE_S", 0.01)
    with at_work.told_at_work():
        time.sleep(0.3)
    assert capfd.readouterr() == ("", "")


def test_on_a_terminal_it_says_for_how_long(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(at_work, "SILENCE_S", 0.01)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    with at_work.told_at_work():
        time.sleep(1.3)
    told = capfd.readouterr()
    assert "0:00:01" in told.err
    assert at_work.WORDS in told.err
    assert "compiling" not in told.err
    assert told.out == ""


def test_while_a_kernel_is_compiled_that_is_what_is_said_within_80_columns(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(at_work, "SILENCE_S", 0.01)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    with at_work.told_at_work():
        with trigger_event("numba:compile"):
            time.sleep(1.3)
        time.sleep(1.0)
    told = capfd.readouterr().err
    assert at_work.COMPILING in told
    assert told.index(at_work.COMPILING) < told.rindex(at_work.WORDS)
    assert told.count(at_work.WORDS) > told.count(at_work.COMPILING)


def test_a_picture_that_takes_long_says_so_beside_its_json(
    flflab: Run, small_camera: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(at_work, "SILENCE_S", 0.0)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    form = picture.take_picture
    monkeypatch.setattr(
        picture, "take_picture", lambda *scene, **asked: (time.sleep(1.3), form(*scene, **asked))[1]
    )
    ended = flflab(
        "image",
        small_camera,
        "--target",
        "bars",
        "--distance",
        "506.7 mm",
        "--json",
        "-o",
        tmp_path / "bars.npy",
    )
    assert ended.code == 0
    assert "error_estimate" in ended.json
    assert at_work.WORDS in ended.err
