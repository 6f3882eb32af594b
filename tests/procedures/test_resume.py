"""A run that was cut short, at any point and in any way, is gone on with and is then the run it
would have been.
"""

import hashlib
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import event_model
import numpy as np
import pytest
import yaml

from drivers.bench import ConnectedBench
from flflab.bench import Bench
from flflab.cli.many_runs import analyse
from flflab.cli.run import resume_run, run_study
from flflab.cli.verdict import conclude
from flflab.errors import (
    CommunicationError,
    DeviceError,
    InputError,
    MeasurementError,
    MotionError,
    RecordError,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.record import (
    ContinuedRecording,
    Run,
    claim_folder,
    keep_descriptions,
    read_documents,
    read_run,
)
from flflab.study import Study
from procedures.resume import (
    difference_over_noise,
    require_same,
    require_unfinished,
    rest_of,
    resume,
)
from procedures.study import begin_recording, take_study, tell_nobody

Described = Callable[..., tuple[Study, Bench]]
Connect = Callable[..., ConnectedBench]
Write = Callable[..., tuple[Path, Path]]
Until = Callable[..., None]
Camera = Callable[..., Any]
TWO = {"exposure": {"frames": 2}}


def cut_after(bench: ConnectedBench, frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The shutter sticks after so many pictures."""
    grab = bench.camera.grab

    def failing(*exposed: Any) -> Any:
        if bench.camera.number >= frames:  # pyright: ignore[reportAttributeAccessIssue, reportUnknownMemberType]
            raise MotionError("the shutter is stuck")
        return grab(*exposed)

    monkeypatch.setattr(bench.camera, "grab", failing)


@pytest.mark.parametrize(
    "frames",
    [0, 5, 14, *(pytest.param(frames, marks=pytest.mark.ci) for frames in (1, 2, 9, 12, 13))],
)
def test_wherever_a_run_is_cut_it_is_taken_to_its_end_with_each_point_once(
    frames: int,
    described: Described,
    in_memory: Connect,
    memory_camera: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    study, described_bench = described(study=TWO)
    bench = in_memory(described_bench, memory_camera(shape=(90, 120)))
    cut_after(bench, frames, monkeypatch)
    with pytest.raises(MotionError):
        take_study(bench, study, begin_recording(bench, study, tmp_path), tell_nobody, "sweep")
    cut = read_run(tmp_path)
    another = in_memory(described_bench, memory_camera(shape=(90, 120)))
    resume(
        another,
        study,
        cut,
        rest_of(cut, study, described_bench),
        ContinuedRecording(tmp_path),
        tell_nobody,
    )
    run = read_run(tmp_path)
    points = [
        f"c{c}/{kind}/{repeat}"
        for kind in ("white", "four-dot", "bars")
        for c in (0, 1)
        for repeat in (0, 1)
    ]
    keys = [frame.key for frame in run.frames]
    assert sorted(key for key in keys if not key.startswith("dark/")) == sorted(points)
    assert len(keys) == len(set(keys)) == 14
    assert (run.complete, [one["resumes"] for one in run.resumed]) == (True, [cut.start["uid"]])
    for frame in run.frames:
        assert frame.index < 14
        run.picture(frame)
        if frame.configuration is not None:
            wanted = study.configurations[frame.configuration]
            assert (frame.distance, frame.array, frame.sensor) == pytest.approx(
                (wanted.distance, wanted.array, wanted.sensor), abs=1e-9
            )
            assert frame.target == frame.key.split("/")[1]
    for name, document in read_documents(tmp_path):
        event_model.schema_validators[event_model.DocumentNames[name]].validate(document)


@pytest.mark.parametrize("lost", [1, 4, 14])
def test_frames_that_a_power_cut_took_are_taken_again(
    lost: int,
    described: Described,
    in_memory: Connect,
    memory_camera: Callable[..., Any],
    tmp_path: Path,
) -> None:
    study, described_bench = described(study=TWO)
    bench = in_memory(described_bench, memory_camera(shape=(90, 120)))
    take_study(bench, study, begin_recording(bench, study, tmp_path), tell_nobody, "sweep")
    whole = read_run(tmp_path)
    pixels, size = (tmp_path / "frames.h5").read_bytes(), 2 * 90 * 120
    first = pixels.index(whole.picture(whole.frames[14 - lost]).astype("<u2").tobytes())
    (tmp_path / "frames.h5").write_bytes(
        pixels[:first] + bytes(lost * size) + pixels[first + lost * size :]
    )
    cut = read_run(tmp_path)
    assert cut.lost == tuple(frame.key for frame in whole.frames[14 - lost :])
    require_unfinished(cut)
    another = in_memory(described_bench, memory_camera(shape=(90, 120)))
    rest = rest_of(cut, study, described_bench)
    resume(another, study, cut, rest, ContinuedRecording(tmp_path), tell_nobody)
    run = read_run(tmp_path)
    assert (run.complete, run.lost) == (True, ())
    assert [frame.key for frame in run.frames] == [frame.key for frame in whole.frames]
    assert run.resumed[-1]["retakes"] == list(cut.lost)
    for frame in run.frames:
        run.picture(frame)


def test_the_report_of_a_run_that_was_cut_says_so_and_how_to_go_on(
    described: Described,
    in_memory: Connect,
    memory_camera: Camera,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    study, described_bench = described()
    folder = claim_folder(tmp_path / "run")
    keep_descriptions(folder, described_bench, tmp_path / "study.yaml")
    bench = in_memory(described_bench, memory_camera(shape=(90, 120)))
    cut_after(bench, 4, monkeypatch)
    with pytest.raises(MotionError):
        take_study(bench, study, begin_recording(bench, study, folder), tell_nobody, "validate")
    with pytest.raises(
        MeasurementError,
        match=rf"no four-dot frame; the run stopped .* taken: `flflab resume {folder}` goes on$",
    ):
        conclude(read_run(folder))
    assert capsys.readouterr().err == "not recorded to its end; measuring and comparing\n"


def pictures_of(run: Run) -> dict[str, tuple[str, dict[Any, float], float]]:
    return {
        frame.key: (
            hashlib.sha256(run.picture(frame).tobytes()).hexdigest(),
            frame.worlds,
            frame.exposure_s,
        )
        for frame in run.frames
    }


@pytest.mark.ci
@pytest.mark.timeout(300)
@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
def test_a_run_interrupted_and_then_killed_is_frame_by_frame_the_one_that_never_was(
    write: Write, until: Until, tmp_path: Path
) -> None:
    small = {
        "dots": {"kind": "four-dot", "spacing": "4 mm"},
        "bars": {"kind": "bars", "width": "12 mm", "height": "8 mm"},
    }
    shown = {
        one["kind"]: {key: size for key, size in one.items() if key != "kind"}
        for one in small.values()
    }
    places = {"configurations": [{"f_number": [2.8, 4], "distance": "507 mm"}]}
    # The simulated bench dies with the run: to the next one power was cut.
    study, bench = write(study=TWO | small | places | {"draws": 450}, targets=shown)
    camera = yaml.safe_load((tmp_path / "camera.yaml").read_text())
    camera["sensor"] |= {"resolution": [760, 560], "pixel": "1.66 um"}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    whole = run_study(study, bench, tmp_path / "whole", None, tell_nobody, "sweep")
    cut, chance = tmp_path / "cut", random.Random(7)  # noqa: S311
    command = [
        sys.executable,
        "-P",
        "-m",
        "flflab",
        "sweep",
        str(study),
        "--bench",
        str(bench),
        "--out",
        str(cut),
    ]
    by_operator = sys.platform != "win32"  # there Ctrl-C reaches a whole console, this test's too
    for attempt, ending in enumerate((signal.SIGINT if by_operator else signal.SIGTERM, None)):
        had = len(read_run(cut).frames) if attempt else 0
        with subprocess.Popen(
            command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL
        ) as process:
            goal = had + chance.randint(1, 5)
            until(lambda goal=goal: _recorded(cut) >= goal)
            process.kill() if ending is None else process.send_signal(ending)
            _, said = process.communicate()
        assert not read_run(cut).complete
        if ending == signal.SIGINT:
            assert process.returncode == 130
            assert b"Traceback" not in said
            assert b"flflab resume" in said
        command = [sys.executable, "-P", "-m", "flflab", "resume", str(cut)]
    resumed = resume_run(cut, None, tell_nobody)
    assert len(resumed.resumed) == 2
    assert pictures_of(resumed) == pictures_of(whole)
    for folder in (whole.folder, cut):
        assert analyse(0, folder).sentences
    assert (cut / "comparison.csv").read_bytes() == (whole.folder / "comparison.csv").read_bytes()
    page = (cut / "report.html").read_bytes()
    analyse(0, cut)
    assert (cut / "report.html").read_bytes() == page


def _recorded(folder: Path) -> int:
    return (
        (folder / "documents.jsonl").read_text().count('"event"')
        if (folder / "documents.jsonl").exists()
        else 0
    )


@pytest.mark.ci
def test_after_a_device_error_a_run_goes_on_at_other_addresses_of_the_same_bench(
    served: Callable[..., Any], tmp_path: Path
) -> None:
    faults = [{"device": "target_stage", "fault": "silence", "after": 60}]
    places = {
        "configurations": [{"f_number": 4, "distance": [f"{490 + 5 * k} mm" for k in range(4)]}]
    }
    with served(study=places, faults=faults) as (_, study, bench), pytest.raises(DeviceError):
        run_study(study, bench, tmp_path / "cut", None, tell_nobody, "sweep")
    had = len(read_run(tmp_path / "cut").frames)
    with pytest.raises(
        CommunicationError,
        match=rf"(?s)cannot be reached.*`flflab resume {tmp_path / 'cut'} --bench FILE`$",
    ):
        resume_run(tmp_path / "cut", None, tell_nobody)
    with served(study=places) as (_, study, bench):
        run = resume_run(tmp_path / "cut", bench, tell_nobody)
        whole = run_study(study, bench, tmp_path / "whole", None, tell_nobody, "sweep")
    assert 0 < had < len(run.frames)
    assert pictures_of(run) == pictures_of(whole)


@pytest.mark.ci
def test_a_bench_that_shows_something_else_is_refused_in_a_sentence(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, bench = write()
    run_study(study, bench, tmp_path / "run", None, tell_nobody, "sweep")
    folder = shorten(tmp_path / "run", 3)
    described = yaml.safe_load((folder / "bench.yaml").read_text())
    described["simulated"]["truths"] = {"iris.scale": 0.05}
    (folder / "bench.yaml").write_text(yaml.safe_dump(described, sort_keys=False))
    with pytest.raises(
        MeasurementError, match=r"c1/four-dot/0: taken again it differs .* put it back and resume"
    ):
        resume_run(folder, None, tell_nobody)
    assert len(read_run(folder).frames) == 3


def shorten(folder: Path, frames: int) -> Path:
    """The record of a run as it was after so many frames, unpacked."""
    import h5py

    run = read_run(folder)
    with h5py.File(folder / "frames.h5") as file:
        dataset: Any = file["frames"]
        content, room = dataset[:], len(run.frames) + 5
    with h5py.File(folder / "frames.h5", "w") as file:
        file.create_dataset(
            "frames",
            data=np.concatenate([content, np.zeros((room, *content.shape[1:]), np.uint16)]),
        )
    lines = (folder / "documents.jsonl").read_text().splitlines(keepends=True)
    events = [number for number, line in enumerate(lines) if line.startswith('{"name": "event"')]
    (folder / "documents.jsonl").write_text("".join(lines[: events[frames - 1] + 1]))
    (folder / "SHA256SUMS").unlink()
    return folder


def test_what_cannot_be_gone_on_with_is_refused(
    described: Described, in_memory: Connect, memory_camera: Callable[..., Any], tmp_path: Path
) -> None:
    study, bench = described()
    connected = in_memory(bench, memory_camera(shape=(90, 120)))
    take_study(connected, study, begin_recording(connected, study, tmp_path), tell_nobody, "sweep")
    with pytest.raises(InputError, match="taken to its end, there is nothing to continue"):
        require_unfinished(read_run(tmp_path))
    lines = (tmp_path / "documents.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "documents.jsonl").write_text(
        "".join(lines[:-1]).replace('"plan_name": "sweep"', '"plan_name": "align"')
    )
    (tmp_path / "SHA256SUMS").unlink()
    with pytest.raises(InputError, match="a run of align cannot be continued"):
        require_unfinished(read_run(tmp_path))
    (tmp_path / "documents.jsonl").write_text("")
    with pytest.raises(RecordError, match="nothing was recorded; begin it again"):
        read_run(tmp_path)


def test_a_calibration_that_was_cut_is_gone_on_with_as_one(
    described: Described,
    in_memory: Connect,
    memory_camera: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    study, described_bench = described(study={"targets": ["dots"]})
    bench = in_memory(described_bench, memory_camera(shape=(90, 120)))
    cut_after(bench, 3, monkeypatch)
    with pytest.raises(MotionError):
        take_study(bench, study, begin_recording(bench, study, tmp_path), tell_nobody, "calibrate")
    cut = read_run(tmp_path)
    require_unfinished(cut)
    another = in_memory(described_bench, memory_camera(shape=(90, 120)))
    resume(
        another,
        study,
        cut,
        rest_of(cut, study, described_bench),
        ContinuedRecording(tmp_path),
        tell_nobody,
    )
    run = read_run(tmp_path)
    assert run.complete
    assert {part["plan_name"] for part in (run.start, *run.resumed)} == {"calibrate"}


NOISE = SensorNoise(0.34, 1.0, 64.0, 4095.0)


def exposed(level: float, rng: np.random.Generator, rows: int = 300) -> Any:
    light = np.where(np.arange(400) % 3 == 0, level, 0.0)
    return (
        np.rint(rng.normal(64 + light, np.sqrt(NOISE.variance(64 + light)), (rows, 400)))
        .clip(0, 4095)
        .astype(np.uint16)
    )


@pytest.mark.parametrize("level", [0.0, 3.0, 10.0, 30.0, 300.0, 3900.0])
def test_two_pictures_of_one_light_differ_by_their_noise(level: float) -> None:
    rng = np.random.default_rng(3)
    assert difference_over_noise(exposed(level, rng), exposed(level, rng), NOISE) == pytest.approx(
        1, abs=0.02
    )


def test_three_per_cent_less_light_is_another_bench() -> None:
    rng = np.random.default_rng(1)
    require_same("c0/bars/0", exposed(2800, rng), exposed(2800, rng), NOISE)
    with pytest.raises(
        MeasurementError, match=r"c0/bars/0: taken again it differs .* allowed is 1\.2"
    ):
        require_same("c0/bars/0", exposed(2800, rng), exposed(2716, rng), NOISE)
