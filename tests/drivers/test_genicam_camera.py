"""Cameras with GenICam features: the GenTL producer ``viky``, and where its extra is installed
pylon's emulated camera in a closed loop.
"""

import importlib.util
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from drivers.base import Camera
from drivers.cameras.genicam import GenicamCamera, GenicamKeys
from drivers.cameras.pylon import PylonCamera, PylonKeys
from drivers.genicam_nodes import next_frame_number
from flflab.bench import read_bench
from flflab.errors import CommunicationError, DeviceError
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.focus import focus_figure
from sim.clock import RunningClock
from sim.motion import rest
from sim.world import World

NOISE: dict[str, Any] = {"black_level": 0, "electrons_per_dn": 2, "read_noise_electrons": 3}
basler = pytest.mark.skipif(
    importlib.util.find_spec("pypylon") is None,
    reason="pypylon is not installed (extra basler, 240 MB)",
)


def viky(address: str = "VikyTL_DEV_red", **keys: Any) -> Camera:
    found = importlib.util.find_spec("genicam")
    assert found is not None
    assert found.origin is not None
    known = NOISE | {"producer": str(Path(found.origin).parent / "viky.cti"), "exposure": "10 ms"}
    return Camera("camera", GenicamCamera(address, GenicamKeys.model_validate(known | keys)))


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "which camera": (
        {"address": ""},
        (
            r"3 cameras answer to that; there are VikyTL_DEV_red / 0 / Viky; .*give an id as the"
            r" address"
        ),
    ),
    "a camera that is not there": (
        {"address": "nobody"},
        r"camera nobody: 0 cameras answer to that",
    ),
    "no producer": (
        {"producer": "nowhere.cti"},
        r"there is no GenTL producer \(nowhere\.cti\); give the maker's \.cti file",
    ),
    "an unknown exposure": (
        {"exposure": None},
        r"its exposure can be neither set nor read; give in the bench file what it is",
    ),
    "a format it has not": (
        {"pixel_format": "Mono12"},
        r"asked for PixelFormat Mono12, refused: .*; give what the camera can do",
    ),
    "a packed format": (
        {"pixel_format": "Mono12p"},
        r"pixel_format Mono12p cannot be taken; give Mono8 to Mono16",
    ),
    "too many columns": ({"columns": 900}, r"asked for Width 900, refused: .*Max = 800"),
    "a feature it has not": (
        {"settings": {"ExposureTime": 3}},
        r"asked for ExposureTime 3.*no such feature",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_a_gentl_camera_cannot_be_is_refused(what: str) -> None:
    keys, says = REFUSED[what]
    with pytest.raises(DeviceError, match=says):
        viky(**keys)


def test_a_gentl_camera_shows_its_ball_in_the_size_asked_for() -> None:
    camera = viky(columns=200, rows=100, settings={"AcquisitionFrameRate": 100})
    frames = [camera.grab() for _ in range(3)]
    assert {frame.picture.shape for frame in frames} == {(100, 200)}
    assert {frame.pixel_format for frame in frames} == {"Mono8"}
    assert "Viky" in camera.identity()
    camera.close()


def test_numbers_that_jump_are_lost_frames_and_a_gige_counter_may_wrap() -> None:
    assert [
        next_frame_number("camera", *pair)
        for pair in ((None, 7), (7, 8), (65535, 65536), (65535, 0), (65535, 1))
    ] == [
        7,
        8,
        65536,
        0,
        1,
    ]
    for last, came in ((7, 9), (7, 7), (7, 6), (100, 1)):
        with pytest.raises(
            CommunicationError,
            match=rf"frame number {came} came where {last + 1} is due, one was lost or doubled",
        ):
            next_frame_number("camera", last, came)


@pytest.fixture
def emulated(emulated_basler: None, tmp_path: Path) -> Iterator[Callable[..., tuple[Camera, Any]]]:
    """Opens pylon's emulated camera on a picture file; gives our camera and pylon's own handle for
    planting faults.
    """
    opened: list[Camera] = []

    def start(picture: Any, **keys: Any) -> tuple[Camera, Any]:
        show(tmp_path, picture)
        rows, columns = picture.shape
        files = {
            "ImageFilename": str(tmp_path / "seen.png"),
            "ImageFileMode": "On",
            "TestImageSelector": "Off",
        }
        known = NOISE | {
            "pixel_format": "Mono12",
            "columns": columns,
            "rows": rows,
            "settings": files,
        }
        commands = PylonCamera("0815-0000", PylonKeys.model_validate(known | keys))
        opened.append(Camera("camera", commands))
        return opened[-1], commands

    yield start
    for camera in opened:
        camera.close()


def show(folder: Path, picture: Any) -> None:
    """What the emulated camera sees from now on: 16 bits, of which it keeps the upper 12."""
    assert cv2.imwrite(str(folder / "seen.png"), (picture * 16).astype(np.uint16))


RAMP = np.arange(48 * 64).reshape(48, 64)


@basler
def test_an_emulated_basler_is_set_in_seconds_and_factors_and_read_to_the_bit(
    emulated: Any,
) -> None:
    camera, _ = emulated(RAMP)
    camera.prepare(0.02, 2.0)  # the camera itself counts in microseconds and decibel
    frame = camera.grab()
    assert np.array_equal(frame.picture, RAMP)
    assert (frame.exposure_s, frame.gain) == pytest.approx((0.02, 2.0), rel=1e-3)
    assert camera.exposure_limits == pytest.approx((1e-6, 10.0))


@basler
def test_a_colour_mosaic_keeps_its_pattern(emulated: Any, tmp_path: Path) -> None:
    camera, _ = emulated(RAMP, pixel_format="BayerRG12")
    assert cv2.imwrite(
        str(tmp_path / "seen.png"), np.full((48, 64, 3), (10, 100, 200), np.uint8)
    )  # blue, green, red
    camera.close()
    frame = camera.grab()
    assert frame.pixel_format == "BayerRG12"
    assert (frame.picture[:2, :2] // 16).tolist() == [[200, 100], [100, 10]]


@basler
def test_torn_frames_frames_nobody_asked_for_and_a_camera_that_was_away(emulated: Any) -> None:
    camera, commands = emulated(RAMP, timeout="0.5 s")
    basler = commands._camera  # noqa: SLF001 - pylon's own way of planting a fault
    basler.ForceFailedBufferCount.Value = 1
    basler.ForceFailedBuffer.Execute()
    with pytest.raises(
        CommunicationError,
        match=r"camera 0815-0000: the frame is torn \(The buffer was incompletely grabbed",
    ):
        camera.grab()
    assert (camera.grab().number, camera.dropped) == (2, 1)
    camera.arm()
    commands._camera.ExecuteSoftwareTrigger()  # noqa: SLF001
    time.sleep(0.3)
    with pytest.raises(CommunicationError, match="sent frames unasked; see who else triggers it"):
        camera.grab()
    frame = camera.grab()
    assert np.array_equal(frame.picture, RAMP)
    assert (frame.number, frame.dropped) == (3, 1)
    commands._camera.Close()  # noqa: SLF001 - away
    with pytest.raises(
        CommunicationError, match=r"camera 0815-0000: (asked for|takes no trigger within 0\.5 s)"
    ):
        camera.grab()
    assert camera.grab().dropped == 1


@basler
@pytest.mark.ci
def test_the_loop_is_closed_the_sensor_moves_and_the_camera_sees_what_the_world_then_shows(
    emulated: Any, root: Path, tmp_path: Path
) -> None:
    optics = yaml.safe_load((root / "examples/cameras/osinski.yaml").read_text(encoding="utf-8"))
    optics["sensor"] |= {"resolution": [240, 180], "pixel": "3 um"}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(optics), encoding="utf-8")
    described = yaml.safe_load(
        (root / "examples/benches/simulated.yaml").read_text(encoding="utf-8")
    )
    described["optics"] = "camera.yaml"
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(described), encoding="utf-8")
    clock = RunningClock(1000)
    world = World(read_bench(tmp_path / "bench.yaml"), clock)
    world.wheel.motion = rest(1.0)  # bars

    def seen() -> Any:
        scene = world.scene(clock.now())
        assert scene.camera is not None
        assert scene.distance is not None
        return np.clip(
            np.rint(2000 * render(one_plane(scene.camera, scene.target, scene.distance))), 0, 4095
        )

    carriage = world.carriages["sensor_stage"]
    sharp = world.axes["sensor_stage"].start
    camera, _ = emulated(seen())
    figures: dict[float, float] = {}
    for shift in (-0.1, -0.05, 0.0, 0.05, 0.1):
        carriage.motion = rest(sharp + shift)
        drawn = seen()
        camera.close()  # the emulated camera reads its file when it begins to grab
        show(tmp_path, drawn)
        frame = camera.grab()
        assert np.array_equal(frame.picture, drawn)
        figures[shift] = focus_figure(frame.picture)
    assert max(figures, key=lambda shift: figures[shift]) == 0.0, figures
