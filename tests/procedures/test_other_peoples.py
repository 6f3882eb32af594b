"""bluesky's own plans on our devices, served by the simulation, and our plans on ophyd's simulated
ones.
"""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from urllib.parse import urlparse
from urllib.request import url2pathname

import h5py
import pytest
from bluesky import RunEngine
from bluesky import plans as bp
from bluesky.callbacks import LiveTable
from bluesky.callbacks.best_effort import BestEffortCallback
from event_model import DocumentNames, schema_validators
from ophyd.sim import SynAxis, SynSignal

from drivers.base import wait_all
from drivers.bench import ConnectedBench, connect
from flflab.bench import Bench
from flflab.study import Study
from procedures.devices import Stages
from procedures.glance import Glance
from procedures.steps import Move, SetIris, ShowTarget, steps
from procedures.sweep import Course, Instruments, Progress, sweep


def test_blueskys_own_plans_run_on_our_axes_iris_and_target(
    served: Callable[..., Any], engine: RunEngine
) -> None:
    events: list[dict[str, Any]] = []

    def keep(name: str, document: Any) -> None:
        schema_validators[DocumentNames[name]].validate(document)
        if name == "event":
            events.append(document["data"])

    with served() as (_, _, bench_file), connect(bench_file) as bench:
        array, sensor, lens = bench.array_stage, bench.sensor_stage, bench.main_lens_stage
        wait_all(*(axis.home() for axis in (array, sensor, lens)), timeout=30)
        engine(bp.count([array, bench.iris, bench.target], 2), keep)
        engine(bp.scan([bench.iris], lens, 1.0, 3.0, 3), keep)
        engine(bp.grid_scan([], array, 5.0, 6.0, 2, sensor, 5.0, 7.0, 3, snake_axes=True), keep)
        engine(bp.rel_scan([], lens, -0.5, 0.5, 2), keep)
        stops: list[Any] = [bench.iris, [4.0, 8.0]]
        engine(bp.list_scan([], *stops), keep)
        places = (array.position(), sensor.position(), lens.position())
    assert [event.get("target") is not None for event in events] == [True] * 2 + [False] * (
        3 + 6 + 2 + 2
    )
    assert [event["main_lens_stage"] for event in events[2:5]] == pytest.approx(
        [1.0, 2.0, 3.0], abs=5e-4
    )
    grid = [(event["array_stage"], event["sensor_stage"]) for event in events[5:11]]
    assert grid == [
        pytest.approx(point, abs=5e-4) for point in ((5, 5), (5, 6), (5, 7), (6, 7), (6, 6), (6, 5))
    ]
    assert [event["main_lens_stage"] for event in events[11:13]] == pytest.approx(
        [2.5, 3.5], abs=5e-4
    )
    assert [event["iris"] for event in events[13:]] == pytest.approx([4.0, 8.0], rel=0.005)
    assert places == pytest.approx((6.0, 5.0, 3.0), abs=5e-4), (
        "a relative scan goes back to where it began"
    )


def test_a_scan_under_anybodys_engine_leaves_its_frames_in_a_file(
    described: Callable[..., tuple[Study, Bench]],
    in_memory: Callable[..., ConnectedBench],
    memory_camera: Callable[..., Any],
    engine: RunEngine,
    tmp_path: Path,
) -> None:
    documents: list[tuple[str, dict[str, Any]]] = []

    def keep(name: str, document: Any) -> None:
        schema_validators[DocumentNames[name]].validate(document)
        documents.append((name, document))

    printed: list[str] = []
    table = BestEffortCallback()
    table.disable_plots()
    engine.subscribe(table)
    camera = memory_camera(shape=(6, 8))
    with in_memory(described()[1], camera) as bench:
        bench.home()
        bench.detector.folder = tmp_path / "frames"
        bench.detector.prepare(5e-3)
        live = LiveTable([bench.sensor_stage.name, "camera_mean_dn"], out=printed.append)
        listeners: Any = [keep, live]
        for _ in range(2):
            plan = bp.scan([bench.detector], bench.sensor_stage, 18.7, 18.8, 3)
            engine(plan, listeners)
        last = bench.detector.latest
    resources = [document for name, document in documents if name == "stream_resource"]
    data = [document for name, document in documents if name == "stream_datum"]
    events = [document["data"] for name, document in documents if name == "event"]
    assert len(resources) == 2  # a file a run
    assert [document["seq_nums"] for document in data[:3]] == [
        {"start": place, "stop": place + 1} for place in (1, 2, 3)
    ]
    read: list[Any] = []
    for resource in resources:
        with h5py.File(url2pathname(urlparse(resource["uri"]).path)) as file:
            read += list(cast(Any, file[resource["parameters"]["dataset"]])[:])
    assert len(read) == len(data) == len(events) == 6
    assert [float(frame.mean()) for frame in read] == [event["camera_mean_dn"] for event in events]
    assert last is not None
    assert (read[-1] == last.picture).all()
    assert [event["sensor_stage"] for event in events] == [18.7, 18.75, 18.8] * 2
    assert any("sensor_stage" in line and "camera_mean_dn" in line for line in printed)
    start = documents[0][1]
    assert start["hints"]["dimensions"] == [(["sensor_stage"], "primary")]


def test_the_moves_of_a_sweep_run_on_ophyds_simulated_devices(
    described: Callable[..., tuple[Study, Bench]], engine: RunEngine, tmp_path: Path
) -> None:
    """Nothing of ours is below the plan: axes, iris and target are ophyd's."""
    study, bench = described()
    moves = tuple(
        step for step in steps(study, bench) if isinstance(step, Move | SetIris | ShowTarget)
    )
    axes = {name: SynAxis(name=name) for name in bench.description.axes}
    iris, target = SynAxis(name="iris"), SynSignal(name="target")
    went: dict[str, list[float]] = {name: [] for name in axes}
    for name, axis in axes.items():
        axis.subscribe(lambda *_, value, name=name, **__: went[name].append(value), run=False)
    peers: Any = SimpleNamespace(axes=axes, iris=iris, target=target, described=bench)
    nothing: Any = SimpleNamespace(latest=None, shot=None, arrived=None)
    told: list[Progress] = []
    idle = Glance(study, bench, nothing)
    engine(
        sweep(
            Instruments(peers, nothing, Stages({}, bench), nothing, idle, 0.7),
            moves,
            Course(),
            told.append,
        )
    )
    due: dict[str, list[float]] = {name: [] for name in axes}
    for step in moves:
        for group in step.groups if isinstance(step, Move) else ():
            for name, reading in group.items():
                due[name].append(reading)
    assert any(due.values())
    assert went == due
    assert len(told) == len(moves) + 1
