"""What every camera promises, asked of each driver on a device that none of its authors wrote, or
on the simulated bench.

``scpi`` and ``folder`` look at the simulated bench; ``gphoto2`` speaks to libgphoto2's virtual PTP
camera, ``genicam`` to the GenTL producer ``viky``, ``opencv`` plays numbered pictures; ``pylon``
speaks to pylon's emulated camera, where its extra is installed.
"""

import importlib.util
import math
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from bluesky import protocols

from drivers.base import Camera, Detector, Frame
from drivers.registry import CAMERAS
from flflab.bench import read_bench
from flflab.errors import DeviceError, LimitError
from flflab.files.raw import RawPicture, write_raw
from sim.serve import serve, warm_up

NOISE: dict[str, Any] = {"black_level": 64, "electrons_per_dn": 2.0, "read_noise_electrons": 3.0}

RAMP = (np.arange(48 * 64).reshape(48, 64) % 4000).astype(np.uint16)


@dataclass(frozen=True)
class Peer:
    """A device to speak to: driver, address, keys, and an exposure that it can be set to beside its
    first.
    """

    driver: str
    address: str
    keys: dict[str, Any]
    exposure: float


EXTRAS = {
    "gphoto2": "gphoto2",
    "genicam": "harvesters",
    "pylon": "pypylon",
}  # what each needs beside the core


def drivers() -> Iterator[Any]:
    """Every driver whose peer is on this machine; the slower ones in ci."""
    for name in sorted(CAMERAS):
        if importlib.util.find_spec(EXTRAS.get(name, "cv2")) is not None:
            yield pytest.param(name, marks=[pytest.mark.ci] if name in ("folder", "pylon") else [])


@pytest.fixture(scope="module", params=list(drivers()))
def peer(
    request: pytest.FixtureRequest, root: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Peer]:
    folder = tmp_path_factory.mktemp(request.param)
    with ExitStack() as stack:
        yield PEERS[request.param](folder, root, stack, request)


def on_the_simulated_bench(driver: str, keys: dict[str, Any]) -> Callable[..., Peer]:
    def make(folder: Path, root: Path, stack: ExitStack, request: pytest.FixtureRequest) -> Peer:
        optics = yaml.safe_load(
            (root / "examples/cameras/osinski.yaml").read_text(encoding="utf-8")
        )
        optics["sensor"] |= {"resolution": [64, 48], "pixel": "20 um"}
        (folder / "camera.yaml").write_text(yaml.safe_dump(optics), encoding="utf-8")
        bench = yaml.safe_load(
            (root / "examples/benches/simulated.yaml").read_text(encoding="utf-8")
        )
        bench |= {"optics": "camera.yaml", "camera": {"driver": driver, "address": "simulated"}}
        bench["simulated"]["clock"] = 100
        (folder / "bench.yaml").write_text(yaml.safe_dump(bench), encoding="utf-8")
        served = stack.enter_context(serve(read_bench(folder / "bench.yaml")))
        warm_up(served).join()
        return Peer(driver, served.addresses["camera"]["address"], keys, 0.02)

    return make


def on_the_virtual_camera(
    folder: Path, root: Path, stack: ExitStack, request: pytest.FixtureRequest
) -> Peer:
    card: Path = request.getfixturevalue("card")
    write_raw(card / "frame.dng", RawPicture(RAMP, "rggb", (64, 64, 64, 64), 4095))
    (card / "frame.dng").replace(
        card / "frame.jpg"
    )  # the virtual camera takes pictures called .jpg, whatever is in them
    return Peer("gphoto2", "usb:001,001", NOISE | {"full_scale": 4095, "quiet": "20 ms"}, 0.02)


def on_numbered_pictures(
    folder: Path, root: Path, stack: ExitStack, request: pytest.FixtureRequest
) -> Peer:
    for number in range(60):
        assert cv2.imwrite(str(folder / f"frame_{number:03d}.png"), RAMP + np.uint16(number))
    keys = NOISE | {"full_scale": 4095, "exposures": ["20 ms", "20 ms"], "stale": 0}
    return Peer("opencv", str(folder / "frame_%03d.png"), keys, 0.02)


def on_viky(folder: Path, root: Path, stack: ExitStack, request: pytest.FixtureRequest) -> Peer:
    found = importlib.util.find_spec("genicam")
    assert found is not None
    assert found.origin is not None
    keys = NOISE | {
        "producer": str(Path(found.origin).parent / "viky.cti"),
        "exposure": "20 ms",
        "settings": {"AcquisitionFrameRate": 200},
    }
    return Peer("genicam", "VikyTL_DEV_green", keys, 0.02)


def on_the_emulated_basler(
    folder: Path, root: Path, stack: ExitStack, request: pytest.FixtureRequest
) -> Peer:
    request.getfixturevalue("emulated_basler")
    assert cv2.imwrite(str(folder / "ramp.png"), RAMP * np.uint16(16))
    settings = {
        "ImageFilename": str(folder / "ramp.png"),
        "ImageFileMode": "On",
        "TestImageSelector": "Off",
    }
    return Peer(
        "pylon",
        "0815-0000",
        NOISE | {"pixel_format": "Mono12", "columns": 64, "rows": 48, "settings": settings},
        0.02,
    )


FOLDER_KEYS = NOISE | {
    "full_scale": 4095,
    "released_by": "program",
    "exposures": ["1 ms", "10 s"],
    "gains": [1, 16],
    "settle": "50 ms",
}
PEERS: dict[str, Callable[..., Peer]] = {
    "scpi": on_the_simulated_bench("scpi", {}),
    "folder": on_the_simulated_bench("folder", FOLDER_KEYS),
    "gphoto2": on_the_virtual_camera,
    "opencv": on_numbered_pictures,
    "genicam": on_viky,
    "pylon": on_the_emulated_basler,
}


@pytest.fixture
def camera(peer: Peer) -> Iterator[Camera]:
    driver = CAMERAS[peer.driver]
    with ExitStack() as shared:

        def share(address: str, opener: Callable[[], Any]) -> Any:
            opened = opener()
            shared.callback(opened.close)
            return opened

        camera = Camera(
            "camera", driver.open(peer.address, driver.keys.model_validate(peer.keys), share)
        )
        yield camera
        camera.close()
        camera.close()


def test_a_frame_is_a_plane_of_numbers_with_what_it_was_taken_with(
    camera: Camera, peer: Peer
) -> None:
    camera.prepare(peer.exposure)
    frames = [camera.grab(), camera.grab(), camera.grab()]
    for frame in frames:
        assert frame.picture.dtype == np.uint16
        assert frame.picture.shape == frames[0].picture.shape
        assert frame.picture.ndim == 2
        assert 0 < frame.picture.max() <= camera.full_scale
        assert frame.exposure_s == pytest.approx(peer.exposure, rel=0.01)
        assert frame.gain == pytest.approx(1.0)
        assert re.fullmatch(r"(Mono|Bayer(RG|BG|GR|GB)|[RGB])(8|10|12|14|16)", frame.pixel_format)
        assert camera.pixel_format in ("", frame.pixel_format)
    assert [frame.number for frame in frames] == [1, 2, 3]
    assert [frame.dropped for frame in frames] == [0, 0, 0]
    assert 1e9 < frames[0].timestamp <= frames[1].timestamp <= frames[2].timestamp


def test_it_arms_triggers_and_fetches_in_this_order_only(camera: Camera, peer: Peer) -> None:
    with pytest.raises(DeviceError, match=r"before it was armed; arm it first"):
        camera.trigger()
    with pytest.raises(DeviceError, match=r"no exposure under way; arm and trigger first"):
        camera.fetch()
    camera.arm()
    camera.arm()
    camera.trigger()
    with pytest.raises(DeviceError, match=r"fetch that one first"):
        camera.arm()
    with pytest.raises(DeviceError, match=r"fetch that one first"):
        camera.prepare(peer.exposure)
    assert camera.fetch().number == 1
    with pytest.raises(DeviceError, match=r"no exposure under way"):
        camera.fetch()
    assert camera.dropped == 0


def test_what_it_cannot_do_is_refused_and_changes_nothing(camera: Camera, peer: Peer) -> None:
    camera.prepare(peer.exposure)
    least, most = camera.exposure_limits
    for exposure, gain in (
        (least * 0.9, 1.0),
        (most * 1.1, 1.0),
        (math.nan, 1.0),
        (peer.exposure, camera.gain_limits[1] * 1.1),
    ):
        with pytest.raises(LimitError, match=r"camera: asked for .* allowed is"):
            camera.prepare(exposure, gain)
    assert camera.grab().exposure_s == pytest.approx(peer.exposure, rel=0.01)


def test_the_facts_of_its_noise_go_with_the_gain(camera: Camera, peer: Peer) -> None:
    most = min(2.0, camera.gain_limits[1])
    camera.prepare(peer.exposure, 1.0)
    once = camera.dn_per_electron, camera.read_noise_dn
    camera.prepare(peer.exposure, most)
    assert (camera.dn_per_electron, camera.read_noise_dn) == pytest.approx(
        (once[0] * most, once[1] * most), rel=0.01
    )
    assert min(*once, camera.full_scale) > 0
    assert camera.offset_dn == 64
    assert camera.grab().gain == pytest.approx(most, rel=0.01)


def test_bluesky_triggers_and_reads_it(camera: Camera, tmp_path: Path) -> None:
    detector = Detector(camera)
    detector.folder = tmp_path
    assert isinstance(detector, protocols.Triggerable)
    assert isinstance(detector, protocols.Readable)
    detector.trigger().wait(20)
    assert detector.read()["camera_number"]["value"] == 1
    detector.close()
    assert len(camera.identity()) > 5


def test_two_threads_get_frames_of_their_own(camera: Camera) -> None:
    frames: list[Frame] = []
    threads = [threading.Thread(target=lambda: frames.append(camera.grab())) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(frame.number for frame in frames) == [1, 2]
