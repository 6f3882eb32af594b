"""Which frames of a record may be judged, and why the others may not."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flflab.record import ELEMENTS, Recording, Run, frames_said, read_run, world_key

SHAPE = (20, 30)
HOUR = 3600.0
NEW = {"record_schema": 2}


def recorded(
    folder: Path, start: dict[str, Any], frames: list[tuple[str, str, float, dict[str, Any]]]
) -> Run:
    """A run of frames: point, target, time in h, and facts that are not as usual."""
    recording = Recording(folder, len(frames), SHAPE)
    recording.document("start", {"uid": "s", "axes": ["a"], "sensor_noise": {}} | start)
    worlds = {world_key(element): 0.0 for element in ELEMENTS}
    for key, target, hours, facts in frames:
        place = recording.frame(np.zeros(SHAPE, dtype=np.uint16))
        recording.document("stream_datum", {"indices": {"start": place, "stop": place + 1}})
        data = {
            "point": key, "configuration": 0, "target": target, "repeat": 0, "iris": 4.0,
            "a_mm": 1.25, "exposure_s": 0.01, "gain": 1.0, "saturated": 0, "number": 7, **worlds,
        }  # fmt: skip
        recording.document("event", {"time": HOUR * hours, "data": data | facts})
    recording.document("stop", {"exit_status": "success"})
    recording.close()
    return read_run(folder)


STILL = {"moved_steps": 0.4}


def test_a_frame_that_failed_a_check_is_diagnostic_and_says_why(tmp_path: Path) -> None:
    start = NEW | {"temperature_range_degc": [19.0, 23.0]}
    run = recorded(
        tmp_path,
        start,
        [
            ("c0/white/0", "white", 1.0, STILL),
            ("c0/bars/0", "bars", 2.0, STILL | {"temperature_degc": 21.0}),
            ("c0/bars/1", "bars", 2.0, STILL | {"saturated": 60}),
            ("c0/bars/2", "bars", 2.0, {"moved_steps": 3.5}),
            ("c0/bars/3", "bars", 14.0, STILL),
            ("c0/bars/4", "bars", 2.0, STILL | {"temperature_degc": 25.0}),
            ("c0/bars/5", "bars", 2.0, STILL | {"saturated": 6}),
        ],
    )
    assert [frame.validity.status for frame in run.frames] == [
        "admitted", "admitted", "diagnostic", "diagnostic", "diagnostic", "diagnostic", "admitted",
    ]  # fmt: skip
    reasons = [frame.validity.reason for frame in run.frames]
    assert reasons[2] == "saturated (10 % of its pixels, 1 % are allowed)"
    assert reasons[3].startswith("moved during exposure (an axis by 3.5 of its steps")
    assert reasons[4].startswith("white picture out of date (taken 13.0 h before")
    assert reasons[5] == "temperature 25 degC outside the stated range, 19 to 23 degC"
    said = frames_said(run.frames)
    assert said.startswith("3 of 7 frames are admitted and used; not used: 1 diagnostic: satur")
    assert "(c0/bars/1)" in said
    assert list(run.table()["validity"])[:3] == ["admitted", "admitted", "diagnostic"]


@pytest.mark.parametrize(
    ("start", "status"), [({}, "admitted"), (NEW, "unvalidated")], ids=["old record", "now"]
)
def test_a_frame_that_nobody_watched_is_judged_only_of_an_old_record(
    start: dict[str, Any], status: str, tmp_path: Path
) -> None:
    run = recorded(tmp_path, start, [("c0/white/0", "white", 1.0, {})])
    (frame,) = run.frames
    assert frame.validity.status == status
    assert bool(frame.validity.reason) == (status == "unvalidated")
