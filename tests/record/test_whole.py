"""A record that is gone on with after a cut, whose every byte is watched, and that is packed when
it is done.
"""

import hashlib
import json
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
import numpy.typing as npt
import pytest

import flflab
from flflab.cli.export import export
from flflab.errors import InputError, RecordError
from flflab.record import (
    ContinuedRecording,
    Recording,
    checksum,
    pack,
    read_documents,
    read_run,
    versions,
)
from flflab.record.folder import git_state
from procedures.validate import judged

SHAPE = (40, 60)
ROOM = 9


def picture(number: int) -> npt.NDArray[np.uint16]:
    return np.random.default_rng(number).poisson(100, SHAPE).astype(np.uint16)


def add(recording: Recording, number: int) -> None:
    place = recording.frame(picture(number))
    recording.document("stream_datum", {"indices": {"start": place, "stop": place + 1}})
    worlds = {
        f"world_{element}_z_mm": 0.0 for element in ("main_lens", "array", "sensor", "target")
    }
    data = {
        "point": f"c0/bars/{number}", "configuration": 0, "target": "bars", "repeat": number,
        "iris": 4.0, "exposure_s": 0.01, "gain": 1.0,
        "saturated": 0, "number": number, "crc32": checksum(picture(number)), **worlds,
    }  # fmt: skip
    recording.document("event", {"time": float(number), "data": data})


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """A record cut in the middle of writing the event of its third frame."""
    recording = Recording(tmp_path, ROOM, SHAPE)
    recording.document("start", {"uid": "first", "axes": []})
    for number in range(3):
        add(recording, number)
    recording.close()
    file = tmp_path / "documents.jsonl"
    file.write_bytes(file.read_bytes()[:-7])
    return tmp_path


@pytest.fixture
def whole(cut: Path) -> Path:
    """The same record gone on with to its end."""
    recording = ContinuedRecording(cut)
    recording.document("start", {"uid": "second", "resumes": "first"})
    for number in (2, 3):
        add(recording, number)
    recording.document("stop", {"exit_status": "success"})
    recording.close()
    return cut


def test_a_record_that_was_cut_is_gone_on_with_and_has_each_point_once(whole: Path) -> None:
    run = read_run(whole)
    assert [frame.key for frame in run.frames] == [f"c0/bars/{number}" for number in range(4)]
    assert (run.start["uid"], [start["resumes"] for start in run.resumed], run.complete) == (
        "first",
        ["first"],
        True,
    )
    assert [frame.index for frame in run.frames] == [
        0,
        1,
        2,
        3,
    ]  # the frame without an event was written over
    for number, frame in enumerate(run.frames):
        np.testing.assert_array_equal(run.picture(frame), picture(number))
    assert all(json.loads(line) for line in (whole / "documents.jsonl").read_text().splitlines())


def test_a_part_that_has_not_ended_makes_the_run_unfinished_again(whole: Path) -> None:
    recording = ContinuedRecording(whole)
    recording.document("start", {"uid": "third", "resumes": "second"})
    recording.close()
    run = read_run(whole)
    assert not run.complete
    assert run.cut == (None, {"exit_status": "success"})


def test_a_record_that_is_being_written_is_gone_on_with_by_nobody_else(cut: Path) -> None:
    first = ContinuedRecording(cut)
    content = (cut / "documents.jsonl").read_bytes()
    with pytest.raises(RecordError, match="another program is writing this run"):
        ContinuedRecording(cut)
    assert (cut / "documents.jsonl").read_bytes() == content
    first.close()
    ContinuedRecording(cut).close()


def test_a_flipped_byte_in_a_frame_is_named_when_the_frame_is_read(whole: Path) -> None:
    with h5py.File(whole / "frames.h5") as file:
        offset = cast(h5py.Dataset, file["frames"]).id.get_offset()
    content = bytearray((whole / "frames.h5").read_bytes())
    content[offset + 2 * (SHAPE[0] * SHAPE[1] * 2) + 17] ^= 0x04
    (whole / "frames.h5").write_bytes(content)
    run = read_run(whole)
    for frame in run.frames[:2]:
        run.picture(frame)
    with pytest.raises(
        RecordError,
        match=r"frames\.h5: frame c0/bars/2 \(number 2 of the file\) is not as it was recorded",
    ):
        run.picture(run.frames[2])


def test_a_changed_document_or_description_is_named(whole: Path) -> None:
    file = whole / "documents.jsonl"
    content = file.read_bytes()
    file.write_bytes(content.replace(b'"iris": 4.0', b'"iris": 5.0', 1))
    with pytest.raises(RecordError, match=r"documents\.jsonl: not as it was recorded"):
        read_run(whole)
    file.write_bytes(content)
    assert len(read_run(whole).frames) == 4


@pytest.mark.parametrize("name", ["bench.yaml", "study.yaml", "versions.json"])
def test_a_missing_description_is_said_to_be_missing(cut: Path, name: str) -> None:
    (cut / name).write_text("{}")
    recording = ContinuedRecording(cut)
    recording.document("stop", {"exit_status": "success"})
    recording.close()
    (cut / name).unlink()
    with pytest.raises(
        RecordError, match=rf"{name}: is missing, and was there when recorded; take it from a copy"
    ):
        read_run(cut)


def test_the_sums_are_those_that_other_programs_compute(whole: Path) -> None:
    lines = (whole / "SHA256SUMS").read_text().splitlines()
    assert lines == [
        f"{hashlib.sha256((whole / 'documents.jsonl').read_bytes()).hexdigest()}  documents.jsonl"
    ]
    events = [doc["data"] for name, doc in read_documents(whole) if name == "event"]
    with h5py.File(whole / "frames.h5") as file:
        dataset = cast(Any, file["frames"])
        for place, event in enumerate(events):
            assert zlib.crc32(dataset[place].astype("<u2").tobytes()) == int(event["crc32"], 16)


def test_a_packed_run_is_smaller_and_the_same_to_plain_h5py(whole: Path) -> None:
    before = (whole / "frames.h5").stat().st_size
    pack(read_run(whole))
    assert (whole / "frames.h5").stat().st_size < 0.5 * before * 4 / ROOM + 5000
    with h5py.File(whole / "frames.h5") as file:
        dataset = cast(Any, file["frames"])
        assert (dataset.shape, dataset.dtype, dataset.compression, dataset.shuffle) == (
            (4, *SHAPE),
            np.dtype("<u2"),
            "gzip",
            True,
        )
        for number in range(4):
            np.testing.assert_array_equal(dataset[number], picture(number))
    content = (whole / "frames.h5").read_bytes()
    pack(read_run(whole))
    assert (whole / "frames.h5").read_bytes() == content
    assert {one.name for one in whole.iterdir()} == {"frames.h5", "documents.jsonl", "SHA256SUMS"}


def test_a_run_that_has_not_ended_is_not_packed_since_it_may_be_gone_on_with(cut: Path) -> None:
    content = (cut / "frames.h5").read_bytes()
    pack(read_run(cut))
    assert (cut / "frames.h5").read_bytes() == content


def test_the_commands_say_what_cannot_be_packed_and_what_has_nothing_to_compare(cut: Path) -> None:
    with pytest.raises(InputError, match="its frames are not packed yet; `flflab resume"):
        export(cut, pack=True)
    with pytest.raises(
        InputError, match="a run of something else without a study has nothing to compare"
    ):
        judged(read_run(cut))


def test_where_packing_fails_the_raw_frames_are_left(whole: Path) -> None:
    content = bytearray((whole / "frames.h5").read_bytes())
    place = bytes(content).find(picture(1).tobytes())
    content[place] ^= 1
    (whole / "frames.h5").write_bytes(content)
    with pytest.raises(RecordError, match=r"frame c0/bars/1 .* is not as it was recorded"):
        pack(read_run(whole))
    assert (whole / "frames.h5").read_bytes() == bytes(content)
    assert {one.name for one in whole.iterdir()} == {"frames.h5", "documents.jsonl", "SHA256SUMS"}


@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files the POSIX way")
def test_where_the_disk_takes_no_packed_file_the_raw_frames_are_left(whole: Path) -> None:
    import resource

    content = (whole / "frames.h5").read_bytes()
    limit, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, hard))
    try:
        with pytest.raises(
            RecordError,
            match=(
                r"the disk does not take the packed file beside it \(File too large\); make room$"
            ),
        ):
            pack(read_run(whole))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    assert (whole / "frames.h5").read_bytes() == content
    assert {one.name for one in whole.iterdir()} == {"frames.h5", "documents.jsonl", "SHA256SUMS"}


@pytest.mark.parametrize(
    ("left", "says"),
    [
        (None, "is missing"),
        (0, "is damaged, or no file of frames"),
    ],
)
def test_a_file_of_frames_that_is_gone_is_told_alike_to_who_reads_packs_or_goes_on(
    whole: Path, left: int | None, says: str
) -> None:
    run, file = read_run(whole), whole / "frames.h5"
    if left is None:
        file.unlink()
    else:
        file.write_bytes(file.read_bytes()[:left])
    for use in (
        lambda: run.picture(run.frames[0]),
        lambda: pack(run),
        lambda: ContinuedRecording(whole),
    ):
        with pytest.raises(RecordError) as refusal:
            use()
        assert str(refusal.value) == f"{file}: {says}; take it from a copy"


def test_the_commit_that_ran_is_recorded_and_whether_files_were_changed(tmp_path: Path) -> None:
    assert git_state(tmp_path) == {}
    commands = (
        "init -q",
        "config user.name a",
        "config user.email a@b.c",
        "add x",
        "commit -q -m one",
    )
    (tmp_path / "x").write_text("1")
    for words in commands:
        subprocess.run(["git", "-C", str(tmp_path), *words.split()], check=True)
    commit = git_state(tmp_path)["git"]
    assert len(commit) == 40
    (tmp_path / "x").write_text("2")
    assert git_state(tmp_path)["git"] == f"{commit}, with changed files"
    installed = Path(flflab.__file__).resolve().parents[1]
    assert ("git" in versions()) == (installed / ".git").exists()
