"""A run from somebody else: its file of frames opens no other file, whatever it names."""

import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from flflab.errors import InputError, RecordError
from flflab.files.image import read_picture
from flflab.record import Recording, Run, checksum, export_nexus, pack, read_run

SHAPE = (8, 16)
SECRET = bytes(range(256))


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """A whole run of one frame, and beside it a file that is nobody's business."""
    (tmp_path / "secret").write_bytes(SECRET)
    folder = tmp_path / "run"
    folder.mkdir()
    picture = np.frombuffer(SECRET, dtype="<u2").reshape(SHAPE)
    recording = Recording(folder, 1, SHAPE)
    recording.document("start", {"uid": "first", "axes": [], "sensor_noise": {}})
    place = recording.frame(picture)
    recording.document("stream_datum", {"indices": {"start": place, "stop": place + 1}})
    elements = ("main_lens", "array", "sensor", "target")
    data = {
        "point": "c0/bars/0", "configuration": 0, "target": "bars", "repeat": 0, "iris": 4.0,
        "exposure_s": 0.01, "gain": 1.0, "saturated": 0, "number": 0, "crc32": checksum(picture),
        **{f"world_{element}_z_mm": 0.0 for element in elements},
    }  # fmt: skip
    recording.document("event", {"time": 0.0, "data": data})
    recording.document("stop", {"exit_status": "success"})
    recording.close()
    return read_run(folder)


def external_storage(file: Path, secret: Path) -> None:
    with h5py.File(file, "w") as into:
        into.create_dataset(
            "frames", (1, *SHAPE), "<u2", external=[(str(secret), 0, h5py.h5f.UNLIMITED)]
        )


def external_link(file: Path, secret: Path) -> None:
    other = secret.with_name("other.h5")
    with h5py.File(other, "w") as into:
        into["frames"] = np.frombuffer(SECRET, dtype="<u2").reshape(1, *SHAPE)
    with h5py.File(file, "w") as into:
        into["frames"] = h5py.ExternalLink(str(other), "frames")


def soft_link_to_external(file: Path, secret: Path) -> None:
    external_link(file, secret)
    with h5py.File(file, "r+") as into:
        into["away"] = into.get("frames", getlink=True)
        del into["frames"]
        into["frames"] = h5py.SoftLink("/away")


def virtual_dataset(file: Path, secret: Path) -> None:
    other = secret.with_name("other.h5")
    external_link(file, secret)
    layout = h5py.VirtualLayout((1, *SHAPE), "<u2")
    layout[:] = h5py.VirtualSource(str(other), "frames", (1, *SHAPE))
    with h5py.File(file, "w") as into:
        into.create_virtual_dataset("frames", layout)


WAYS = [external_storage, external_link, soft_link_to_external, virtual_dataset]


@pytest.mark.parametrize("elsewhere", WAYS)
def test_numbers_that_lie_in_another_file_are_not_read(
    elsewhere: Callable[[Path, Path], None], run: Run, tmp_path: Path
) -> None:
    elsewhere(run.folder / "frames.h5", tmp_path / "secret")
    for use in (
        lambda: run.picture(run.frames[0]),
        lambda: export_nexus(run, tmp_path / "out.nxs"),
        lambda: pack(run),
    ):
        with pytest.raises(RecordError, match=r"frames\.h5: (keeps /frames|frames is a)"):
            use()
    assert not (tmp_path / "out.nxs").exists()
    assert (
        hashlib.sha256((tmp_path / "secret").read_bytes()).digest()
        == hashlib.sha256(SECRET).digest()
    )


@pytest.mark.parametrize("elsewhere", WAYS)
def test_a_picture_that_lies_in_another_file_is_not_measured(
    elsewhere: Callable[[Path, Path], None], tmp_path: Path
) -> None:
    (tmp_path / "secret").write_bytes(SECRET)
    elsewhere(tmp_path / "mine.h5", tmp_path / "secret")
    with pytest.raises(InputError, match=r"mine\.h5: (keeps /frames|one set of)"):
        read_picture(tmp_path / "mine.h5", 0)


def test_a_dataset_of_another_kind_is_no_file_of_frames(run: Run) -> None:
    with h5py.File(run.folder / "frames.h5", "w") as into:
        into["frames"] = np.zeros((3, 4))
    with pytest.raises(RecordError, match="is damaged, or no file of frames"):
        run.picture(run.frames[0])


@pytest.mark.skipif(sys.platform == "win32", reason="pipes and devices of POSIX")
@pytest.mark.parametrize("name", ["documents.jsonl", "frames.h5", "SHA256SUMS", "log.txt"])
@pytest.mark.parametrize("make", [os.mkfifo, lambda place: os.symlink("/dev/zero", place)])
def test_a_pipe_or_a_device_among_the_files_of_a_run_is_refused_at_once(
    make: Callable[[Path], None], name: str, run: Run
) -> None:
    (run.folder / name).unlink(missing_ok=True)
    make(run.folder / name)
    with pytest.raises(RecordError, match=f"{name}: is a pipe or a device"):
        read_run(run.folder)
