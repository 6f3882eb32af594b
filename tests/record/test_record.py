"""A run's folder: what is written is read back, whatever happened to the writer."""

import json
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import pytest

from flflab.bench import read_bench, with_seed
from flflab.errors import RecordError
from flflab.record import (
    ContinuedRecording,
    Recording,
    claim_folder,
    keep_descriptions,
    new_folder,
    read_documents,
    read_run,
)

SHAPE = (6, 8)
BUILT_IN = Path(__file__).parents[2] / "flflab" / "builtin"
WRITER = """
import sys
import threading
from pathlib import Path
import numpy as np
from flflab.record import Recording

recording = Recording(Path(sys.argv[1]), 100000, (60, 80))
recording.document("start", {"uid": "s", "axes": []})
for number in range(100000):
    place = recording.frame(np.full((60, 80), number % 4096, np.uint16))
    recording.document("stream_datum", {"indices": {"start": place, "stop": place + 1}})
    worlds = {f"world_{element}_z_mm": 0.0 for element in ("main_lens", "array", "sensor", "target")}
    event = {"point": f"c0/bars/{number}", "configuration": 0, "target": "bars", "repeat": number, "iris": 4.0, "exposure_s": 0.01,
             "gain": 1.0, "saturated": 0, "number": number, **worlds}
    recording.document("event", {"time": 0.0, "data": event})
    print(number, flush=True)
"""  # noqa: E501


def picture(number: int) -> npt.NDArray[np.uint16]:
    return np.random.default_rng(number).integers(0, 4096, SHAPE, dtype=np.uint16)


def event(key: str, **changes: Any) -> dict[str, Any]:
    worlds = {
        "world_main_lens_z_mm": 0.5,
        "world_array_z_mm": 60.5,
        "world_sensor_z_mm": 61.75,
        "world_target_z_mm": -506.5,
    }
    data = {
        "point": key, "configuration": 3, "target": "bars", "repeat": 0, "iris": 4.0, "a_mm": 1.25,
        "exposure_s": 0.01, "gain": 1.0,
        "saturated": 0, "number": 7, **worlds,
    }  # fmt: skip
    return {"time": 12.5, "data": data | changes}


def write_two(folder: Path) -> Recording:
    recording = Recording(folder, 3, SHAPE)
    recording.document("start", {"uid": "s", "axes": ["a"], "sensor_noise": {"offset_dn": 64.0}})
    for number, key in enumerate(("c3/bars/0", "dark/0.01s/0")):
        place = recording.frame(picture(number))
        recording.document("stream_datum", {"indices": {"start": place, "stop": place + 1}})
        recording.document("event", event(key, configuration=-1 if number else 3))
    recording.settle()
    return recording


def test_what_was_recorded_is_read_back(tmp_path: Path) -> None:
    recording = write_two(tmp_path)
    recording.document("stop", {"exit_status": "success"})
    recording.close()
    run = read_run(tmp_path)
    bars, dark = run.frames
    assert (bars.key, bars.configuration, bars.distance, bars.array, bars.sensor) == (
        "c3/bars/0",
        3,
        507.0,
        60.0,
        61.25,
    )
    assert (bars.readings, bars.exposure_s, bars.saturated, bars.number, bars.time) == (
        {"a": 1.25},
        0.01,
        0,
        7,
        12.5,
    )
    assert dark.configuration is None
    assert run.dark(0.01) == dark
    assert run.stop == {"exit_status": "success"}
    for number, frame in enumerate(run.frames):
        np.testing.assert_array_equal(run.picture(frame), picture(number))


def test_a_run_being_written_can_be_read(tmp_path: Path) -> None:
    recording = write_two(tmp_path)
    program = (
        "import sys; from pathlib import Path; from flflab.record import read_run;"
        " print(len(read_run(Path(sys.argv[1])).frames))"
    )
    finished = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    recording.close()
    assert finished.stdout.strip() == "2"


def test_a_last_line_cut_short_is_left_out_wherever_it_is_cut(tmp_path: Path) -> None:
    write_two(tmp_path).close()
    file = tmp_path / "documents.jsonl"
    whole = file.read_bytes()
    last = whole.rstrip(b"\n").rfind(b"\n") + 1
    for cut in range(last, len(whole)):
        file.write_bytes(whole[:cut])
        assert [frame.key for frame in read_run(tmp_path).frames] == ["c3/bars/0"]


def test_a_line_changed_later_is_named(tmp_path: Path) -> None:
    write_two(tmp_path).close()
    file = tmp_path / "documents.jsonl"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([lines[0], lines[1][:-9], *lines[2:]]) + "\n")
    with pytest.raises(RecordError, match=r"documents\.jsonl:2: not a document"):
        read_run(tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
def test_after_kill_9_every_finished_point_is_readable_but_for_the_one_just_handed_over(
    tmp_path: Path,
) -> None:
    for attempt, points in enumerate((2, 40)):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        with subprocess.Popen(
            [sys.executable, "-c", WRITER, str(folder)], stdout=subprocess.PIPE, text=True
        ) as writer:
            assert writer.stdout is not None
            said = [int(writer.stdout.readline()) for _ in range(points)]
            writer.send_signal(signal.SIGKILL)
        frames = read_run(folder).frames
        assert len(frames) >= said[-1]
        run = read_run(folder)
        assert all((run.picture(frame) == frame.number % 4096).all() for frame in frames)
        assert len({frame.key for frame in frames}) == len(frames)


def test_handing_over_a_frame_waits_for_the_one_before_and_for_nothing_else(tmp_path: Path) -> None:
    class Slow:
        """Pixels that take as long as somebody wants."""

        def __init__(self, pixels: Any) -> None:
            self.pixels, self.go_on = pixels, threading.Event()

        def write(self, content: memoryview) -> int:
            self.go_on.wait(10)
            return self.pixels.write(content)

        def __getattr__(self, name: str) -> Any:
            return getattr(self.pixels, name)

    recording = Recording(tmp_path, 3, SHAPE)
    slow = recording._pixels = Slow(recording._pixels)  # noqa: SLF001  # pyright: ignore[reportPrivateUsage, reportAttributeAccessIssue]
    recording.document("start", {"uid": "s"})
    recording.frame(picture(0))
    recording.document("event", {"number": 0})
    assert [name for name, _ in read_documents(tmp_path)] in ([], ["start"])
    second = threading.Thread(target=lambda: recording.frame(picture(1)))
    second.start()
    second.join(0.05)
    assert second.is_alive()
    slow.go_on.set()
    second.join(10)
    assert [name for name, _ in read_documents(tmp_path)] == ["start", "event"]
    np.testing.assert_array_equal(recording.picture(1), picture(1))
    recording.close()


def test_documents_hold_what_numpy_counts(tmp_path: Path) -> None:
    recording = Recording(tmp_path, 1, SHAPE)
    recording.document(
        "start",
        {
            "a": np.float32(0.5),
            "b": np.int64(3),
            "c": np.arange(3),
            "d": np.bool_(True),
            "e": (1, None),
        },
    )
    recording.close()
    assert list(read_documents(tmp_path)) == [
        ("start", {"a": 0.5, "b": 3, "c": [0, 1, 2], "d": True, "e": [1, None]})
    ]


def test_a_run_is_never_overwritten(tmp_path: Path) -> None:
    write_two(tmp_path).close()
    with pytest.raises(RecordError, match="holds a run already"):
        claim_folder(tmp_path)
    with pytest.raises(RecordError, match="another run is recorded there"):
        Recording(tmp_path, 1, SHAPE)
    folders = {new_folder("first", tmp_path / "runs") for _ in range(3)}
    assert len(folders) == 3
    assert all(folder.name.split("Z-", 1)[1].startswith("first") for folder in folders)


@pytest.mark.parametrize(
    "others", [("notes.txt",), ("bench.yaml", "study.yaml"), ("versions.json", "a", "b", "c", "d")]
)
def test_a_run_has_a_folder_to_itself(tmp_path: Path, others: tuple[str, ...]) -> None:
    for name in others:
        (tmp_path / name).write_text(name)
    with pytest.raises(
        RecordError,
        match=(
            r"holds other files \((notes|bench|a, b, c and 1 more).*; give a new or an empty one$"
        ),
    ):
        claim_folder(tmp_path)
    assert {one.name: one.read_text() for one in tmp_path.iterdir()} == {
        name: name for name in others
    }


def test_the_folder_of_a_run_that_never_began_is_taken_again(tmp_path: Path) -> None:
    bench = read_bench(BUILT_IN / "benches" / "simulated.yaml")
    for _ in range(2):  # new, then with the descriptions of the first time
        keep_descriptions(
            claim_folder(tmp_path / "run"), bench, BUILT_IN / "studies" / "first.yaml"
        )
    assert claim_folder(tmp_path / "run") == tmp_path / "run"
    keep_descriptions(tmp_path / "run", bench, None)
    assert {one.name for one in (tmp_path / "run").iterdir()} == {
        "bench.yaml",
        "camera.yaml",
        "versions.json",
        "SHA256SUMS",
    }


@pytest.mark.parametrize("resumed", [False, True], ids=["killed", "resumed and killed"])
@pytest.mark.parametrize("name", ["bench.yaml", "camera.yaml", "study.yaml"])
def test_a_description_that_was_edited_is_told_of_a_run_that_never_ended(
    name: str, resumed: bool, tmp_path: Path
) -> None:
    keep_descriptions(
        tmp_path,
        read_bench(BUILT_IN / "benches" / "simulated.yaml"),
        BUILT_IN / "studies" / "first.yaml",
    )
    write_two(tmp_path).close()
    if resumed:
        ContinuedRecording(tmp_path).close()
    assert len(read_run(tmp_path).frames) == 2
    (tmp_path / name).write_text((tmp_path / name).read_text().replace(" mm", " cm", 1))
    with pytest.raises(
        RecordError, match=rf"{name}: not as it was recorded .*; take it from a copy"
    ):
        read_run(tmp_path)


def test_what_a_file_browser_hides_in_an_empty_folder_is_in_nobodys_way(tmp_path: Path) -> None:
    (tmp_path / ".DS_Store").write_text("")
    assert claim_folder(tmp_path) == tmp_path


def test_where_nothing_was_recorded_is_told_from_where_no_folder_is(tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_text("")
    for folder, says in (
        (tmp_path, "nothing was recorded there yet; begin the run anew"),
        (tmp_path / "no", "there is no such folder"),
    ):
        with pytest.raises(RecordError) as refusal:
            read_run(folder)
        assert str(refusal.value).startswith(f"{folder}: {says}")


def test_a_file_in_the_place_of_a_run_is_told_without_repeating_its_path(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file", tmp_path / "file" / "run"):
        with pytest.raises(RecordError) as refusal:
            claim_folder(place)
        assert "Errno" not in str(refusal.value)
        assert str(refusal.value).count(str(tmp_path)) == 1


def test_a_run_that_does_not_fit_on_the_disk_is_refused_before_it_begins(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="GB are free"):
        Recording(tmp_path, 1_000_000, (100_000, 100_000))
    assert list(tmp_path.iterdir()) == []


def test_frames_are_allocated_before_the_first_one_so_that_adding_one_changes_nothing_else(
    tmp_path: Path,
) -> None:
    recording = Recording(tmp_path, 3, SHAPE)
    before = (tmp_path / "frames.h5").read_bytes()
    recording.frame(picture(0))
    recording.settle()
    after = (tmp_path / "frames.h5").read_bytes()
    recording.close()
    assert len(after) == len(before)
    with h5py.File(tmp_path / "frames.h5") as file:
        dataset = file["frames"]
        assert isinstance(dataset, h5py.Dataset)
        start = dataset.id.get_offset()
    assert before[:start] == after[:start]
    assert before[start + picture(0).nbytes :] == after[start + picture(0).nbytes :]


@pytest.mark.parametrize("style", ["as it is", "in one line"])
def test_the_descriptions_kept_read_back_as_the_ones_used(tmp_path: Path, style: str) -> None:
    bench = read_bench(BUILT_IN / "benches" / "simulated.yaml")
    if style == "in one line":
        import yaml

        data = yaml.safe_load(bench.file.read_text()) | {
            "optics": str(BUILT_IN / "cameras" / "osinski.yaml")
        }
        (tmp_path / "one.yaml").write_text(json.dumps(data))
        bench = read_bench(tmp_path / "one.yaml")
    folder = tmp_path / "run"
    folder.mkdir()
    keep_descriptions(folder, bench, BUILT_IN / "studies" / "first.yaml")
    kept = read_bench(folder / "bench.yaml")
    assert kept.optics == bench.optics
    assert kept.description.model_copy(update={"optics": ""}) == bench.description.model_copy(
        update={"optics": ""}
    )
    assert (folder / "study.yaml").read_bytes() == (
        BUILT_IN / "studies" / "first.yaml"
    ).read_bytes()
    assert "python" in json.loads((folder / "versions.json").read_text())


def test_a_camera_of_another_size_than_described_is_named(tmp_path: Path) -> None:
    recording = Recording(tmp_path, 1, SHAPE)
    with pytest.raises(
        RecordError,
        match=r"pictures of 4 x 3 pixels, its camera file says 8 x 6; correct sensor\.resolution",
    ):
        recording.frame(np.zeros((3, 4), np.uint16))
    recording.discard()
    assert list(tmp_path.iterdir()) == []


def test_the_seed_that_a_run_was_given_is_kept_with_its_descriptions(tmp_path: Path) -> None:
    bench = read_bench(BUILT_IN / "benches" / "simulated.yaml")
    assert bench.description.simulated.seed != 4711
    keep_descriptions(tmp_path, with_seed(bench, 4711), None)
    kept = read_bench(tmp_path / "bench.yaml")
    assert (
        kept.description.model_copy(update={"optics": bench.description.optics})
        == with_seed(bench, 4711).description
    )
