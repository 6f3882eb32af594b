# longer than 450 lines because one subject's sentences of behaviour stand together
"""A whole run over the wire against the simulated bench, and the ways it can end: well, Ctrl-C,
kill -9, a fault.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import event_model
import numpy as np
import pytest

from drivers.bench import ConnectedBench
from flflab.bench import Bench, read_bench
from flflab.cli.run import resume_run, run_study
from flflab.errors import CommunicationError, DeviceError, FlflabError, MotionError, RecordError
from flflab.record import read_documents, read_run, run_folder
from flflab.study import read_study
from procedures.descriptions import with_descriptions
from procedures.study import begin_recording, tell_nobody
from procedures.sweep import Progress
from sim.motion import rest
from sim.world import WHEEL

Connect = Callable[..., ConnectedBench]
Until = Callable[..., None]
Write = Callable[..., tuple[Path, Path]]
ONE = {"configurations": [{"f_number": 4, "distance": "507 mm"}]}


@contextlib.contextmanager
def validating(
    study: Path, bench: Path, out: Path
) -> Generator["subprocess.Popen[str]", None, None]:
    command = [
        sys.executable,
        "-P",
        "-m",
        "flflab",
        "validate",
        str(study),
        "--bench",
        str(bench),
        "--out",
        str(out),
    ]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def events(out: Path) -> int:
    with contextlib.suppress(Exception):
        return sum(name == "event" for name, _ in read_documents(out))
    return 0


def test_a_study_over_the_wire(served: Callable[..., Any], tmp_path: Path) -> None:
    told: list[Progress] = []
    with served() as (running, study, bench):
        run = run_study(study, bench, tmp_path / "run", None, told.append, "sweep")
        elements = running.world.elements(running.world.clock.now())
    assert [frame.key for frame in run.frames[:2]] == ["c0/white/0", "c1/white/0"]
    assert len(run.frames) == 7
    assert told[-1].done == told[-1].total
    for name, document in read_documents(run.folder):
        event_model.schema_validators[event_model.DocumentNames[name]].validate(document)
    white, dark = (
        run.picture(run.frames[0]).astype(float),
        run.picture(run.frames[-1]).astype(float),
    )
    assert dark.mean() == pytest.approx(64, abs=0.2)
    assert 0.55 < (np.quantile(white, 0.99) - 64) / (4095 - 64) < 0.72
    last = run.frames[-1].worlds
    # The truth differs from the readings by the stages' zero and scale errors, standard deviation 1
    # um (the target's 50 um) and 1e-5.
    for element, true in elements.items():
        assert true == pytest.approx(
            last[element], abs=5 * (0.05 if element == "target.z" else 0.0015)
        )  # pyright: ignore[reportArgumentType]
    drawn = run.start["simulated_light"]
    assert {one["target"] for one in drawn} == {"white", "four-dot", "bars"}
    assert all(one["path"] == "closed forms" and one["configurations"] == [0, 1] for one in drawn)
    assert {device["name"] for device in run.start["devices"]} >= {
        "array_stage",
        "camera",
        "iris",
        "target",
    }


def test_an_axis_whose_limits_begin_beyond_its_reference_goes_to_its_first_place_as_well(
    served: Callable[..., Any], tmp_path: Path
) -> None:
    with served(study=ONE, axes={"target_stage": {"limits": ["93 mm", "150 mm"]}}) as (
        _,
        study,
        bench,
    ):  # at 507 mm it reads 93 mm
        run = run_study(study, bench, tmp_path / "run", None, tell_nobody, "sweep")
    assert [frame.distance for frame in run.frames] == pytest.approx([507] * 4, abs=1e-3)


@pytest.mark.ci
def test_a_stage_that_is_pushed_while_frames_are_taken_ends_the_run_before_a_frame_says_otherwise(
    served: Callable[..., Any], tmp_path: Path
) -> None:
    with served(study=ONE | {"exposure": {"frames": 3}}) as (running, study, bench):

        def push(progress: Progress) -> None:
            if progress.step.startswith("c0/four-dot/1"):
                carriage = running.world.carriages["array_stage"]
                carriage.motion = rest(carriage.at(running.world.clock.now()) - 0.02)

        pushed = (
            r"array_stage: sent to 20\.0000 mm, it now stands at 19\.980\d mm; see what pushed it"
        )
        with pytest.raises(MotionError, match=pushed):
            run_study(study, bench, tmp_path / "run", None, push, "sweep")
        run = read_run(tmp_path / "run")
        assert [frame.key for frame in run.frames][-1] == "c0/four-dot/0"
        resumed = resume_run(tmp_path / "run", None, tell_nobody)
    assert [frame.array for frame in resumed.frames] == pytest.approx(
        [60] * len(resumed.frames), abs=1e-3
    )
    assert resumed.complete


@pytest.mark.ci
def test_a_stage_that_stood_in_its_place_when_a_run_was_gone_on_with_may_not_be_pushed_either(
    served: Callable[..., Any], tmp_path: Path
) -> None:
    at_its_reference = {
        "configurations": [{"f_number": 4, "distance": "507 mm", "main_lens": "-10 mm"}],
        "exposure": {"frames": 3},
    }
    with served(study=at_its_reference) as (running, study, bench):

        def pushing(step: str) -> Callable[[Progress], None]:
            def push(progress: Progress) -> None:
                if progress.step.startswith(step):
                    carriage = running.world.carriages["main_lens_stage"]
                    carriage.motion = rest(carriage.at(running.world.clock.now()) + 0.02)

            return push

        with pytest.raises(MotionError, match="main_lens_stage: sent to"):
            run_study(study, bench, tmp_path / "run", None, pushing("c0/four-dot/1"), "sweep")
        running.world.carriages["main_lens_stage"].motion = rest(0.0)  # back by hand
        with pytest.raises(
            MotionError, match=r"main_lens_stage: sent to 0\.0000 mm, it now stands at 0\.019\d mm"
        ):
            resume_run(tmp_path / "run", None, pushing("c0/bars/1"))


@pytest.mark.ci
@pytest.mark.parametrize(
    ("moved", "place", "sentence"),
    [
        (
            "wheel",
            WHEEL.index("edge"),
            "target: set to four-dot, it now is edge; see what changed it and go on",
        ),
        ("iris", 5.6, r"iris: set to 4\.0, it now is 5\.6; see what changed it and go on"),
    ],
)
def test_a_target_or_an_iris_that_is_changed_while_frames_are_taken_ends_the_run(
    moved: str, place: float, sentence: str, served: Callable[..., Any], tmp_path: Path
) -> None:
    with served(study=ONE | {"exposure": {"frames": 3}}) as (running, study, bench):

        def change(progress: Progress) -> None:
            if progress.step.startswith("c0/four-dot/1"):
                getattr(running.world, moved).motion = rest(place)

        with pytest.raises(MotionError, match=sentence):
            run_study(study, bench, tmp_path / "run", None, change, "sweep")
        resumed = resume_run(tmp_path / "run", None, tell_nobody)
    assert resumed.complete
    for frame in resumed.frames:
        assert frame.f_number == 4.0
        assert frame.target == ("black" if frame.configuration is None else frame.key.split("/")[1])


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("study", "507 mm", "508 mm"),
        ("bench", "10 mm/s", "9 mm/s"),
        ("camera", "60 mm", "59 mm"),
        ("bench", "axes:", ""),
    ],
)
def test_a_description_that_is_edited_while_the_bench_is_connected_begins_no_run(
    name: str,
    before: str,
    after: str,
    write: Write,
    in_memory: Connect,
    memory_camera: Callable[..., Any],
    tmp_path: Path,
) -> None:
    study_file, bench_file = write(study=ONE)
    bench = read_bench(bench_file)
    study, folder = read_study(study_file, bench.optics), tmp_path / "run"
    connected = in_memory(bench, memory_camera(shape=(90, 120)))
    edited = tmp_path / f"{name}.yaml"
    described = edited.read_text()
    edited.write_text(described.replace(before, after, 1))
    with (
        pytest.raises(FlflabError, match=r"was changed while the bench was connected|not YAML"),
        run_folder(folder, "one") as place,
    ):
        with_descriptions(begin_recording(connected, study, place), bench, study_file, study)
    assert not folder.exists()
    edited.write_text(described)
    with run_folder(folder, "one") as place:
        with_descriptions(
            begin_recording(connected, study, place), bench, study_file, study
        ).close()


@pytest.mark.full
def test_the_seed_given_replaces_the_bench_files(
    served: Callable[..., Any], write: Callable[..., tuple[Path, Path]], tmp_path: Path
) -> None:
    study, bench = write(study=ONE)
    runs = [
        run_study(study, bench, tmp_path / name, seed, tell_nobody, "sweep")
        for name, seed in (("a", 7), ("b", 7), ("c", 8))
    ]
    assert [run.start["seed"] for run in runs] == [7, 7, 8]
    first, again, other = (run.picture(run.frames[0]) for run in runs)
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.2


@pytest.mark.skipif(sys.platform == "win32", reason="a process cannot be sent Ctrl-C here")
def test_ctrl_c_in_a_motion_stops_every_axis_and_keeps_the_record(
    served: Callable[..., Any], until: Until, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    with (
        served(study=ONE | {"exposure": {"frames": 4}}, clock=5) as (running, study, bench),
        validating(study, bench, out) as process,
    ):
        carriages = running.world.carriages

        def moving() -> bool:
            return all(
                carriages[name].moving(running.world.clock.now())
                for name in ("main_lens_stage", "target_stage")
            )

        until(moving)
        process.send_signal(signal.SIGINT)
        asked = time.monotonic()
        until(
            lambda: (
                not any(
                    carriage.moving(running.world.clock.now()) for carriage in carriages.values()
                )
            )
        )
        assert time.monotonic() - asked < 1.0
        places = [carriage.at(running.world.clock.now()) for carriage in carriages.values()]
        _, said = process.communicate(timeout=30)
        assert (process.returncode, said.splitlines()[-1]) == (
            130,
            f"flflab: interrupted; recorded so far is in {out}",
        )
        assert "Traceback" not in said
        assert [carriage.at(running.world.clock.now()) for carriage in carriages.values()] == places
    stop = read_run(out).stop
    assert stop is not None
    assert (stop["exit_status"], stop["reason"]) == ("abort", "interrupted by the operator")


@pytest.mark.ci
@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
def test_after_kill_9_in_mid_run_every_finished_point_is_readable(
    served: Callable[..., Any], until: Until, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    with (
        served(study=ONE | {"exposure": {"frames": 20}}) as (_, study, bench),
        validating(study, bench, out) as process,
    ):
        until(lambda: events(out) >= 5)
        process.kill()
        process.wait()
    run = read_run(out)
    assert len(run.frames) >= 5
    assert run.stop is None
    for frame in run.frames:
        assert run.picture(frame).max() > 500
    assert len({frame.key for frame in run.frames}) == len(run.frames)


@pytest.mark.parametrize(
    ("fault", "after", "kind", "sentence"),
    [
        pytest.param("silence", 120, CommunicationError, "no answer", marks=pytest.mark.ci),
        pytest.param("garbage", 120, CommunicationError, "not a reply", marks=pytest.mark.ci),
        ("stall", 60, MotionError, "stalled"),
        pytest.param("reset", 120, DeviceError, "home it", marks=pytest.mark.ci),
    ],
)
def test_a_faulty_stage_ends_the_run_in_a_sentence(
    fault: str,
    after: int,
    kind: type[DeviceError],
    sentence: str,
    served: Callable[..., Any],
    tmp_path: Path,
) -> None:
    places = {
        "configurations": [{"f_number": 4, "distance": [f"{480 + 5 * k} mm" for k in range(12)]}]
    }
    faults = [{"device": "target_stage", "fault": fault, "after": after}]
    with served(study=places, faults=faults) as (running, study, bench):
        with pytest.raises(kind, match=sentence) as caught:
            run_study(study, bench, tmp_path / "run", None, tell_nobody, "sweep")
        now = (
            running.world.clock.now() + 2 * running.world.clock.rate
        )  # 2 s later nothing has moved
        assert not any(carriage.moving(now) for carriage in running.world.carriages.values())
    run = read_run(tmp_path / "run")
    assert run.stop is not None
    assert run.stop["exit_status"] == "fail"
    assert run.stop["reason"] in str(caught.value)
    assert all(run.picture(frame).any() for frame in run.frames)


@pytest.mark.ci
def test_a_fault_ends_the_command_with_exit_code_1_and_a_sentence(
    served: Callable[..., Any], tmp_path: Path
) -> None:
    faults = [{"device": "array_stage", "fault": "silence", "after": 20}]
    with (
        served(study=ONE, faults=faults) as (_, study, bench),
        validating(study, bench, tmp_path / "run") as process,
    ):
        _, said = process.communicate(timeout=60)
    assert process.returncode == 1
    sentence = said.splitlines()[-1]
    assert sentence.startswith("flflab: ")
    assert "array_stage" in sentence
    assert "Traceback" not in said


@pytest.mark.ci
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="there are no process groups")
def test_a_ctrl_c_that_the_simulated_bench_hears_too_ends_well(
    write: Callable[..., tuple[Path, Path]], until: Until, tmp_path: Path
) -> None:
    study, bench = write(study=ONE | {"exposure": {"frames": 60}}, clock=5)
    out = tmp_path / "run"
    command = [
        sys.executable,
        "-P",
        "-m",
        "flflab",
        "validate",
        str(study),
        "--bench",
        str(bench),
        "--out",
        str(out),
    ]
    with subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    ) as process:
        until(
            lambda: (
                (out / "documents.jsonl").exists()
                and "start" in (out / "documents.jsonl").read_text()
            )
        )
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert said.splitlines()[-1] == f"flflab: interrupted; recorded so far is in {out}"
    assert (
        json.loads((out / "documents.jsonl").read_text().splitlines()[-1])["doc"]["exit_status"]
        == "abort"
    )


def test_who_begins_a_moment_later_in_the_same_folder_is_refused_and_changes_nothing(
    write: Write, in_memory: Connect, memory_camera: Callable[..., Any], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    study, bench = write()
    others = ("documents.jsonl", "bench.yaml", "camera.yaml", "study.yaml", "versions.json")

    def connect(described: Bench) -> ConnectedBench:
        for name in others:
            (tmp_path / "run" / name).write_text("another's")
        return in_memory(described, memory_camera(shape=(90, 120)))

    monkeypatch.setattr("drivers.bench.connect_described", connect)
    with pytest.raises(
        RecordError, match="run: another run is recorded there; give another folder"
    ):
        run_study(study, bench, tmp_path / "run", None, tell_nobody, "sweep")
    assert {one.name: one.read_text() for one in (tmp_path / "run").iterdir()} == dict.fromkeys(
        others, "another's"
    )
    assert "resume" not in capsys.readouterr().err


def test_a_run_that_cannot_begin_leaves_no_folder(
    write: Write,
    in_memory: Connect,
    memory_camera: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    study, bench = write()
    monkeypatch.chdir(tmp_path)
    full = SimpleNamespace(free=0)
    monkeypatch.setattr("flflab.record.writing.shutil.disk_usage", lambda _: full)  # pyright: ignore[reportUnknownLambdaType, reportUnknownArgumentType]

    def connect(described: Bench) -> ConnectedBench:
        return in_memory(described, memory_camera(shape=(90, 120)))

    def driven_by_another(described: Bench) -> ConnectedBench:
        raise DeviceError(f"{described.file}: another program drives this bench")

    for way, error in ((connect, RecordError), (driven_by_another, DeviceError)):
        monkeypatch.setattr("drivers.bench.connect_described", way)
        for folder in (tmp_path / "run", None):
            with pytest.raises(error, match=r"0\.00 GB are free|another program"):
                run_study(study, bench, folder, None, tell_nobody, "sweep")
            assert not (tmp_path / "run").exists()
            assert not [*(tmp_path / "runs").glob("*")]
    (tmp_path / "mine").mkdir()
    with pytest.raises(DeviceError):
        run_study(study, bench, tmp_path / "mine", None, tell_nobody, "sweep")
    assert (tmp_path / "mine").exists()
