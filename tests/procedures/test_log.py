"""The log of a run: times of one clock, and nothing that a terminal would obey."""

import logging
import re
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from flflab.errors import RecordError
from flflab.record import Recording
from procedures.log import logged


@pytest.mark.skipif(sys.platform == "win32", reason="has no tzset")
def test_times_are_utc_wherever_the_bench_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TZ", "America/New_York")
    time.tzset()
    recording = Recording(tmp_path, 1, (2, 2))
    before = time.time()
    with logged(recording):
        logging.getLogger("drivers.axis").warning("told to stop")
    recording.close()
    monkeypatch.undo()
    time.tzset()
    line = (tmp_path / "log.txt").read_text()
    found = re.fullmatch(
        r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d),\d{3} UTC WARNING drivers.axis: told to stop\n", line
    )
    assert found
    said = np.datetime64(found[1].replace(" ", "T")).astype("datetime64[s]").astype(int)
    assert abs(said - before) < 5


def test_what_a_device_said_does_not_reach_a_terminal_as_commands(tmp_path: Path) -> None:
    recording = Recording(tmp_path, 1, (2, 2))
    with logged(recording):
        logging.getLogger("drivers.axis").warning("it said %s", "\x1b]52;c;cm0gLXJm\x07")
    recording.close()
    assert r"it said \x1b]52;c;cm0gLXJm\x07" in (tmp_path / "log.txt").read_text()


def test_a_log_that_is_a_link_is_not_written_through(tmp_path: Path) -> None:
    (tmp_path / "victim").write_text("mine")
    run = tmp_path / "run"
    run.mkdir()
    recording = Recording(run, 1, (2, 2))
    (run / "log.txt").symlink_to(tmp_path / "victim")
    with pytest.raises(RecordError, match="is a link"), logged(recording):
        logging.getLogger("drivers.axis").warning("told to stop")
    recording.close()
    assert (tmp_path / "victim").read_text() == "mine"
