"""A loss of power: what a record names is on the disk, and what older records lost there is told
and left out.
"""

import json
import os
import shutil
import stat
import sys
from dataclasses import replace
from pathlib import Path
from typing import cast

import h5py
import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import RecordError
from flflab.record import (
    ContinuedRecording,
    Recording,
    Run,
    checksum,
    pack,
    read_documents,
    read_run,
)

SHAPE = (40, 60)
SIZE = 2 * SHAPE[0] * SHAPE[1]


def picture(number: int) -> npt.NDArray[np.uint16]:
    return np.random.default_rng(number).poisson(100, SHAPE).astype(np.uint16)


def add(recording: Recording, number: int) -> None:
    place = recording.frame(picture(number))
    recording.document("stream_datum", {"indices": {"start": place, "stop": place + 1}})
    elements = ("main_lens", "array", "sensor", "target")
    data = {
        "point": f"c{number}/bars/0", "configuration": number, "target": "bars", "repeat": 0,
        "iris": 4.0, "exposure_s": 0.01, "gain": 1.0, "saturated": 0, "number": number,
        "crc32": checksum(picture(number)),
        **{f"world_{element}_z_mm": 0.0 for element in elements},
    }  # fmt: skip
    recording.document("event", {"time": float(number), "data": data})


def begun(folder: Path, frames: int, room: int = 6) -> Recording:
    recording = Recording(folder, room, SHAPE)
    recording.document("start", {"uid": "first", "axes": []})
    for number in range(frames):
        add(recording, number)
    recording.settle()
    return recording


def lose(folder: Path, frames: range) -> None:
    """The pixels of some frames never reached the disk."""
    with h5py.File(folder / "frames.h5") as file:
        start = cast(h5py.Dataset, file["frames"]).id.get_offset()
    with (folder / "frames.h5").open("r+b") as pixels:
        for number in frames:
            pixels.seek(start + number * SIZE)
            pixels.write(bytes(SIZE))


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="asks Linux for a file's name")
def test_whenever_power_is_cut_the_disk_holds_the_pixels_of_every_event_that_it_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, disk = tmp_path / "run", tmp_path / "disk"
    folder.mkdir()
    disk.mkdir()
    moments: list[Path] = []

    def forced(descriptor: int) -> None:
        """What is forced to the disk is there from now on; nothing else is."""
        place = Path(f"/proc/self/fd/{descriptor}").resolve()
        if place.parent == folder:
            shutil.copyfile(place, disk / place.name)
        moments.append(Path(shutil.copytree(disk, tmp_path / f"cut {len(moments)}")))

    monkeypatch.setattr(os, "fsync", forced)
    monkeypatch.setattr(os, "fdatasync", forced)
    begun(folder, 3).close()
    monkeypatch.undo()
    seen: set[int] = set()
    for moment in moments:
        if not (moment / "documents.jsonl").exists():
            continue
        run = read_run(moment)
        assert run.lost == ()
        for frame in run.frames:
            np.testing.assert_array_equal(run.picture(frame), picture(frame.number))
        seen.add(len(run.frames))
    assert seen == {0, 1, 2, 3}


@pytest.mark.parametrize("lost", [1, 3, 4])
def test_frames_lost_at_the_end_are_told_and_left_out(tmp_path: Path, lost: int) -> None:
    begun(tmp_path, 4).close()
    lose(tmp_path, range(4 - lost, 4))
    run = read_run(tmp_path)
    assert run.lost == tuple(f"c{number}/bars/0" for number in range(4 - lost, 4))
    assert [frame.number for frame in run.frames] == list(range(4 - lost))
    assert not run.complete


def test_a_run_that_ended_well_and_lost_its_last_frame_since_is_not_whole(tmp_path: Path) -> None:
    recording = begun(tmp_path, 3)
    recording.document("stop", {"exit_status": "success"})
    recording.close()
    assert read_run(tmp_path).complete
    lose(tmp_path, range(2, 3))
    run = read_run(tmp_path)
    assert (run.complete, run.lost, run.stop) == (False, ("c2/bars/0",), None)


def test_a_frame_damaged_amid_good_ones_is_no_power_cut(tmp_path: Path) -> None:
    begun(tmp_path, 4).close()
    lose(tmp_path, range(1, 2))
    run = read_run(tmp_path)
    assert (len(run.frames), run.lost) == (4, ())
    with pytest.raises(RecordError, match=r"c1/bars/0 .* not as it was recorded"):
        run.picture(run.frames[1])


def test_lost_frames_are_taken_again_in_their_places_and_their_documents_kept_aside(
    tmp_path: Path,
) -> None:
    begun(tmp_path, 4, room=4).close()
    lose(tmp_path, range(2, 4))
    before = (tmp_path / "documents.jsonl").read_bytes()
    recording = ContinuedRecording(tmp_path)
    recording.document("start", {"uid": "second", "resumes": "first"})
    for number in (2, 3):
        add(recording, number)
    recording.document("stop", {"exit_status": "success"})
    recording.close()
    run = read_run(tmp_path)
    assert (run.complete, run.lost) == (True, ())
    assert [(frame.number, frame.index) for frame in run.frames] == [(k, k) for k in range(4)]
    for frame in run.frames:
        np.testing.assert_array_equal(run.picture(frame), picture(frame.number))
    aside = (tmp_path / "lost.jsonl").read_bytes()
    assert before.endswith(aside)
    kept = [json.loads(line)["doc"] for line in aside.splitlines()]
    assert [doc["data"]["point"] for doc in kept if "data" in doc] == ["c2/bars/0", "c3/bars/0"]
    names = [name for name, _ in read_documents(tmp_path)]
    assert names.count("event") == names.count("stream_datum") == 4


@pytest.mark.parametrize("share", [0.99, 0.5, 0.1])
def test_a_file_of_frames_cut_short_gives_what_it_has_and_is_gone_on_with(
    tmp_path: Path, share: float
) -> None:
    begun(tmp_path, 4, room=4).close()
    whole = (tmp_path / "frames.h5").stat().st_size
    read_before = read_run(tmp_path)
    os.truncate(tmp_path / "frames.h5", int(share * whole))
    run = read_run(tmp_path)
    assert len(run.frames) == {0.99: 3, 0.5: 1, 0.1: 0}[share]
    for frame in run.frames:
        np.testing.assert_array_equal(run.picture(frame), picture(frame.number))
    with pytest.raises(RecordError, match=r"is cut short, .* MB are there, and not c3"):
        read_before.picture(read_before.frames[3])
    with pytest.raises(RecordError, match="is cut short"):
        pack(_as_if_complete(read_before))
    recording = ContinuedRecording(tmp_path)
    for number in range(len(run.frames), 4):
        add(recording, number)
    recording.close()
    again = read_run(tmp_path)
    assert (len(again.frames), again.lost) == (4, ())
    assert (tmp_path / "frames.h5").stat().st_size == whole


def _as_if_complete(run: Run) -> Run:
    return replace(run, stop={"exit_status": "success"})


def test_a_run_folders_links_are_not_written_through(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    run = tmp_path / "run"
    run.mkdir()
    begun(run, 2).close()
    (run / "documents.jsonl").rename(run / "kept")
    (run / "documents.jsonl").symlink_to(run / "kept")
    with pytest.raises(RecordError, match="is a link, and links are not written through"):
        ContinuedRecording(run)
    (run / "documents.jsonl").unlink()
    (run / "kept").rename(run / "documents.jsonl")
    (run / "SHA256SUMS").symlink_to(victim)
    (run / "SHA256SUMS").resolve().write_text("")  # no sums, so that the run reads
    recording = ContinuedRecording(run)
    recording.document("stop", {"exit_status": "success"})
    recording.close()
    assert victim.read_text() == ""
    assert not (run / "SHA256SUMS").is_symlink()


@pytest.mark.skipif(sys.platform == "win32", reason="locks otherwise")
@pytest.mark.parametrize("number", ["ENOLCK", "EOPNOTSUPP", "ENOSYS"])
def test_a_disk_that_knows_no_locks_is_written_and_read_with_a_remark(
    tmp_path: Path, number: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import errno
    import fcntl

    def refuse(*_: object) -> None:
        raise OSError(getattr(errno, number), "no locks")

    monkeypatch.setattr(fcntl, "flock", refuse)
    recording = begun(tmp_path, 2)
    assert "this disk knows no locks" in recording.remark
    recording.close()
    assert len(read_run(tmp_path).frames) == 2
    again = ContinuedRecording(tmp_path)
    assert "this disk knows no locks" in again.remark
    again.close()


@pytest.mark.parametrize("number", ["EINVAL", "ENOSYS", "EOPNOTSUPP"])
@pytest.mark.parametrize("folders_only", [True, False])
def test_a_disk_that_cannot_be_asked_to_keep_at_once_is_written_with_a_remark(
    tmp_path: Path, number: str, folders_only: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    import errno

    def refuse(descriptor: int) -> None:
        if not folders_only or stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(getattr(errno, number), "cannot")

    for name in ("fsync", "fdatasync"):
        monkeypatch.setattr(os, name, refuse, raising=False)
    recording = begun(tmp_path, 2)
    assert "a power cut may take the last frames" in recording.remark
    recording.close()
    assert len(read_run(tmp_path).frames) == 2


def test_a_disk_that_fails_to_keep_a_frame_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import errno

    def fail(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    recording = begun(tmp_path, 1)
    for name in ("fsync", "fdatasync"):
        monkeypatch.setattr(os, name, fail, raising=False)
    with pytest.raises(RecordError, match=r"could not be written \(Input/output error\)"):  # noqa: PT012
        add(recording, 1)
        recording.settle()
    recording.close()
    assert len(read_run(tmp_path).frames) == 1


def test_a_disk_with_locks_needs_no_remark(tmp_path: Path) -> None:
    recording = begun(tmp_path, 1)
    assert recording.remark == ""
    recording.close()
