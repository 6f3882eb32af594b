"""Every fault that a simulated camera can show, by name, under the driver: recovery or one error;
no frame lost silently or taken twice.
"""

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.base import Camera, Frame
from drivers.cameras.folder import FolderCamera, FolderKeys
from drivers.cameras.scpi import ScpiCamera
from drivers.scpi_link import ScpiLink
from flflab.bench import Bench, read_bench
from flflab.errors import DeviceError
from sim.serve import CAMERA_FAULTS, Served, serve, warm_up

WriteBench = Callable[..., Bench]
LASTING = {"silence", "garbage", "cut", "hang-up"}  # they do not end by themselves
EXPOSURE = 0.004
GRABS = 4


def scpi_camera(served: Served) -> Camera:
    link = ScpiLink("camera", served.addresses["camera"]["address"], timeout=2.5)
    return Camera("camera", ScpiCamera(link, slack=2.5))


def folder_camera(served: Served) -> Camera:
    keys = FolderKeys.model_validate(
        {
            "black_level": 64, "electrons_per_dn": 3, "read_noise_electrons": 3, "full_scale": 4095,
            "released_by": "program",
            "exposures": ["1 ms", "1 s"], "timeout": "2.5 s", "settle": "60 ms",
        }
    )  # fmt: skip
    return Camera("camera", FolderCamera(Path(served.addresses["camera"]["address"]), keys))


OPEN: dict[str, Callable[[Served], Camera]] = {"scpi": scpi_camera, "folder": folder_camera}
SLOW = "silence", "cut", "garbage"  # of a camera that leaves files
CASES = [
    pytest.param(
        driver,
        fault,
        marks=pytest.mark.full if driver == "folder" and fault in SLOW else pytest.mark.ci,
    )
    for driver, faults in CAMERA_FAULTS.items()
    for fault in faults
]


@pytest.mark.parametrize(("driver", "fault"), CASES)
def test_a_fault_ends_in_recovery_or_one_error_and_no_frame_comes_twice(
    write_bench_file: WriteBench, driver: str, fault: str
) -> None:
    file = write_bench_file(
        faults=[{"device": "camera", "fault": fault, "after": {"scpi": 14, "folder": 2}[driver]}]
    ).file
    file.write_text(
        re.sub(r"camera:\n  driver: scpi", f"camera:\n  driver: {driver}", file.read_text())
    )
    with serve(read_bench(file)) as served:
        assert served.addresses["camera"]["driver"] == driver
        warm_up(served).join()
        camera = OPEN[driver](served)
        frames: list[Frame] = []
        errors: list[str] = []
        drops: list[int] = []
        for _ in range(GRABS):
            try:
                camera.prepare(EXPOSURE)
                frames.append(camera.grab())
            except DeviceError as error:
                errors.append(str(error))
                drops.append(camera.dropped)
            time.sleep(0.02)
        camera.close()
    assert len(frames) + len(errors) == GRABS
    for said in errors:
        assert re.search(r"^camera (at|in) \S+", said), said
        assert re.search(
            r"; (check|see|take|correct|set|let|is `flflab sim` still running)", said
        ), f"it does not say what to do: {said}"
    if fault in LASTING:
        assert errors
        assert len(frames) >= 1
    else:
        assert len(errors) <= 2
        assert len(frames) >= GRABS - 2
    assert len({frame.timestamp for frame in frames}) == len(frames), "a frame came twice"
    numbers = [frame.number for frame in frames]
    assert numbers == sorted(set(numbers))
    assert all(frame.exposure_s == EXPOSURE for frame in frames)
    # every exposure that was started is a frame or was told as an error
    assert numbers[-1] - frames[-1].dropped == len(frames)
    assert max([camera.dropped, *drops]) <= len(errors)


def test_the_ways_a_camera_can_fail_are_all_here() -> None:
    every: set[str] = {fault for faults in CAMERA_FAULTS.values() for fault in faults}
    said: dict[str, Any] = {
        "time-out": "silence",
        "dropped": "lost-frame",
        "torn": "cut",
        "late": "late",
        "unplugged": "hang-up",
    }
    assert set(said.values()) <= every
