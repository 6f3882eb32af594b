"""The plans themselves, on a bench in memory: looked through by bluesky, done by its engine, and
what their documents say.
"""

import asyncio
import gc
import logging
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import event_model
import pytest
from bluesky.simulators import check_limits, summarize_plan

from drivers.bench import ConnectedBench
from flflab.bench import Bench
from flflab.errors import LimitError, MotionError
from flflab.record import Recording, read_documents, read_run
from flflab.study import Study
from procedures.engine import RunInterruptedError, as_run, perform, running_engine
from procedures.steps import Move, Step, steps
from procedures.study import begin_recording, take_study, tell_nobody
from procedures.sweep import Course, Progress, instruments, sweep

Described = Callable[..., tuple[Study, Bench]]
Connect = Callable[..., ConnectedBench]


@pytest.fixture
def bench(
    described: Described, in_memory: Connect, memory_camera: Callable[..., Any]
) -> ConnectedBench:
    _, bench = described()
    return in_memory(bench, memory_camera(shape=(90, 120)))


@pytest.fixture
def study(described: Described) -> Study:
    return described()[0]


def test_bluesky_finds_a_position_out_of_limits_before_anything_moves(
    study: Study, bench: ConnectedBench, tmp_path: Path
) -> None:
    recording = begin_recording(bench, study, tmp_path)
    wrong: tuple[Step, ...] = (*steps(study, bench.described), Move(0, ({"target_stage": 151.0},)))

    def plan() -> Any:
        return sweep(instruments(bench, study, recording), wrong, Course(), tell_nobody)

    with pytest.raises(LimitError, match=r"target_stage: asked to go to 151\.0+ mm"):
        perform(plan(), plan(), {}, bench, recording)
    assert not any(axis.is_homed() for axis in bench.axes.values())
    assert not (tmp_path / "documents.jsonl").exists()


def test_a_ctrl_c_before_the_run_begins_moves_nothing_and_leaves_no_record_behind(
    study: Study, bench: ConnectedBench, tmp_path: Path
) -> None:
    recording = begin_recording(bench, study, tmp_path)

    def plan(*, rehearsed: bool) -> Any:
        if rehearsed:
            signal.raise_signal(signal.SIGINT)
        yield from sweep(
            instruments(bench, study, recording),
            steps(study, bench.described),
            Course(),
            tell_nobody,
        )

    with pytest.raises(RunInterruptedError, match="before anything was recorded"):
        perform(plan(rehearsed=False), plan(rehearsed=True), {}, bench, recording)
    assert not any(axis.is_homed() for axis in bench.axes.values())
    assert not (tmp_path / "documents.jsonl").exists()


def test_a_ctrl_c_as_a_run_ends_is_told_like_any_and_the_record_is_whole(
    study: Study, bench: ConnectedBench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = begin_recording(bench, study, tmp_path)
    hear = recording.document

    def hear_the_end(name: str, document: Any) -> None:
        hear(name, document)
        if name == "stop":
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.3)  # the engine is asked to pause meanwhile, and has nothing left to do

    monkeypatch.setattr(recording, "document", hear_the_end)
    with pytest.raises(RunInterruptedError, match=f"interrupted; recorded so far is in {tmp_path}"):
        take_study(bench, study, recording, tell_nobody, "sweep")
    assert read_run(tmp_path).complete


def test_bluesky_reads_the_plan_aloud(
    study: Study, bench: ConnectedBench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = begin_recording(bench, study, tmp_path)
    plan = sweep(
        instruments(bench, study, recording), steps(study, bench.described), Course(), tell_nobody
    )
    summarize_plan(as_run(plan, {}, threading.Event()))
    recording.close()
    said = capsys.readouterr().out
    assert said.count("target -> ") == 4
    assert "target_stage -> 100.0" in said
    assert "array_stage -> 20.0" in said


def test_the_engine_leaves_no_thread_and_looks_through_a_plan_without_it(
    study: Study, bench: ConnectedBench, tmp_path: Path
) -> None:
    before = {thread.name for thread in threading.enumerate()}
    recording = begin_recording(bench, study, tmp_path)
    with running_engine():
        check_limits(
            sweep(
                instruments(bench, study, recording),
                steps(study, bench.described),
                Course(),
                tell_nobody,
            )
        )
    recording.close()
    assert {thread.name for thread in threading.enumerate()} == before


async def _stopped() -> None:
    raise MotionError("stopped on the way, as it was told")


def test_what_the_engine_leaves_behind_is_for_the_log_alone(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """asyncio prints it, with a traceback, below the sentence that tells an operator of the
    interruption.
    """
    caplog.set_level(logging.INFO)
    with running_engine() as engine:
        failed = asyncio.run_coroutine_threadsafe(_left_behind(), engine.loop).result(5)
        while not failed.done():
            time.sleep(0.001)
    del failed
    gc.collect()
    assert [record.levelno for record in caplog.records] == [logging.INFO]
    assert "as it was told" in caplog.text


async def _left_behind() -> "asyncio.Task[None]":
    return asyncio.get_running_loop().create_task(_stopped())


def test_a_study_is_recorded_point_by_point(
    study: Study, bench: ConnectedBench, tmp_path: Path
) -> None:
    told: list[Progress] = []
    take_study(bench, study, begin_recording(bench, study, tmp_path), told.append, "sweep")
    run = read_run(tmp_path)
    keys = [
        f"{c}/{kind}/0"
        for kind, order in (("white", "c0 c1"), ("four-dot", "c1 c0"), ("bars", "c0 c1"))
        for c in order.split()
    ]
    assert [frame.key for frame in run.frames[:-1]] == keys
    assert run.frames[-1].key.startswith("dark/")
    assert run.frames[-1].target == "black"
    assert run.dark(run.frames[0].exposure_s) == run.frames[-1]
    assert run.stop is not None
    assert run.stop["exit_status"] == "success"
    for frame in run.frames[:-1]:
        wanted = study.configurations[frame.configuration or 0]
        assert (frame.distance, frame.array, frame.sensor) == pytest.approx(
            (wanted.distance, wanted.array, wanted.sensor), abs=1e-9
        )
        assert frame.f_number == wanted.f_number
        assert run.picture(frame).shape == (90, 120)
    assert run.sensor_noise == {
        "dn_per_electron": 0.34,
        "read_noise_dn": 1.0,
        "offset_dn": 64.0,
        "full_scale_dn": 4095,
    }
    assert [step.done for step in told] == list(range(told[-1].total + 1))
    said = {step.last for step in told} - {""}
    assert len(said) >= 5
    own = {
        frame.key: f"frame 0: exposure {1e3 * frame.exposure_s:.3g} ms" for frame in run.frames
    }  # each frame with its own exposure
    due = {
        f"configuration {key[1]}, {key.split('/')[1]}, {words}"
        for key, words in own.items()
        if key[0] == "c"
    }
    assert said <= {*due, f"dark, {own[run.frames[-1].key]}"}


def test_every_document_passes_event_models_schemas(
    study: Study, bench: ConnectedBench, tmp_path: Path
) -> None:
    take_study(bench, study, begin_recording(bench, study, tmp_path), tell_nobody, "sweep")
    documents = list(read_documents(tmp_path))
    for name, document in documents:
        event_model.schema_validators[event_model.DocumentNames[name]].validate(document)
    names = [name for name, _ in documents]
    assert names == [
        "start",
        "descriptor",
        "stream_resource",
        *["stream_datum", "event"] * 7,
        "stop",
    ]
    resource = documents[2][1]
    assert (resource["uri"], resource["parameters"]["dataset"], resource["mimetype"]) == (
        "frames.h5",
        "/frames",
        "application/x-hdf5",
    )
    places = [document["indices"] for name, document in documents if name == "stream_datum"]
    assert places == [{"start": place, "stop": place + 1} for place in range(7)]
    keys = [document["data"]["point"] for name, document in documents if name == "event"]
    assert len(set(keys)) == len(keys)


def test_what_fails_ends_the_run_in_a_sentence_with_every_axis_stopped(
    study: Study, bench: ConnectedBench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames_before_the_fault = 3
    grab = bench.camera.grab

    def failing(*exposed: Any) -> Any:
        frame = grab(*exposed)
        if frame.number > frames_before_the_fault:
            raise MotionError("the shutter is stuck; look what holds it")
        return frame

    monkeypatch.setattr(bench.camera, "grab", failing)
    with pytest.raises(MotionError, match=r"^the shutter is stuck; look what holds it$"):
        take_study(bench, study, begin_recording(bench, study, tmp_path), tell_nobody, "sweep")
    run = read_run(tmp_path)
    assert run.stop is not None
    assert (run.stop["exit_status"], run.stop["reason"]) == (
        "fail",
        "the shutter is stuck; look what holds it",
    )
    assert 0 < len(run.frames) <= frames_before_the_fault
    assert all(run.picture(frame).any() for frame in run.frames)
    for axis in bench.axes.values():
        assert axis._commands.heard[-1][0] == "stop"  # noqa: SLF001  # pyright: ignore[reportPrivateUsage, reportAttributeAccessIssue, reportUnknownMemberType]
    assert "the shutter is stuck" in (tmp_path / "log.txt").read_text()


def test_a_recording_that_is_full_ends_the_run(
    study: Study, bench: ConnectedBench, tmp_path: Path
) -> None:
    with pytest.raises(Exception, match="has room for 2 frames"):
        take_study(bench, study, Recording(tmp_path, 2, (90, 120)), tell_nobody, "sweep")
    assert len(read_run(tmp_path).frames) == 2
