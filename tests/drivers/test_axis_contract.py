"""What every axis promises, asked of each axis of a simulated bench served by another process, over TCP and over a pseudo terminal."""

import contextlib
import json
import math
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from bluesky import RunEngine, protocols
from bluesky import plan_stubs as bps
from bluesky import plans as bp
from bluesky.simulators import check_limits

import drivers
from drivers.base import Axis, wait_all
from drivers.bench import ConnectedBench
from flflab.errors import DeviceError, InterlockError, LimitError, MotionError, NotHomedError

AXES = ["main_lens_stage", "array_stage", "sensor_stage", "target_stage"]


@contextlib.contextmanager
def served(root: Path, folder: Path, clock: float, *options: str, faults: tuple[dict[str, Any], ...] = ()) -> Generator[Path]:
    """Serve the built-in bench at another clock in another process; yields a bench file with the addresses served."""
    source = root / "examples" / "benches" / "simulated.yaml"
    bench = yaml.safe_load(source.read_text(encoding="utf-8"))
    bench["optics"] = str((source.parent / bench["optics"]).resolve())
    bench["simulated"].update(clock=clock, faults=list(faults))
    (folder / "as_given.yaml").write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    command = [sys.executable, "-P", "-m", "flflab", "sim", str(folder / "as_given.yaml"), "--json", *options]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        addresses = json.loads(child.stdout.readline())
        for name, axis in addresses["axes"].items():
            bench["axes"][name]["address"] = axis["address"]
        for name in ("camera", "iris", "target"):
            bench[name]["address"] = addresses[name]["address"]
        file = folder / "served.yaml"
        file.write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
        yield file
        assert child.poll() is None
    assert child.returncode == 0


def options() -> list[Any]:
    no_pty = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals here")
    return [pytest.param((), id="tcp"), pytest.param(("--pty",), id="pty", marks=no_pty)]


@pytest.fixture(scope="module", params=options())
def bench(request: pytest.FixtureRequest, root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConnectedBench]:
    with served(root, tmp_path_factory.mktemp("bench"), 50.0, *request.param) as file, drivers.connect(file) as connected:
        readings = {name: axis.position() for name, axis in connected.axes.items()}
        for axis in connected.axes.values():
            assert not axis.is_moving()
            with pytest.raises(NotHomedError):
                axis.move_to(sum(axis.limits) / 2)
        assert readings == {name: axis.position() for name, axis in connected.axes.items()}, "connecting and refusing moved something"
        yield connected


@pytest.fixture(params=AXES)
def axis(request: pytest.FixtureRequest, bench: ConnectedBench) -> Axis:
    """One axis after the other; all axes stand at their references."""
    wait_all(*(axis.home() for axis in bench.axes.values()), timeout=20)
    return bench.axes[request.param]


@pytest.fixture
def engine() -> Iterator[RunEngine]:
    """A RunEngine whose loop ends with the test."""
    engine = RunEngine({}, context_managers=[])
    yield engine
    engine.loop.call_soon_threadsafe(engine.loop.stop)
    engine._th.join()  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
    engine.loop.close()


def test_it_satisfies_blueskys_promises(axis: Axis) -> None:
    for promise in ("Movable", "Readable", "Locatable", "Stoppable", "Checkable", "Configurable", "HasHints"):
        assert isinstance(axis, getattr(protocols, promise)), promise


def test_homing_ends_with_a_reference(axis: Axis) -> None:
    assert axis.is_homed()
    assert axis.position() == pytest.approx(0.0, abs=0.001)
    assert axis.warnings() == ()


def test_a_move_reads_back_to_the_microstep(axis: Axis) -> None:
    axis.move_to(23.456789).wait(10)
    assert axis.position() == pytest.approx(23.456789, abs=0.00049609375 / 2 + 1e-9)
    assert axis.position() / 0.00049609375 == pytest.approx(round(axis.position() / 0.00049609375), abs=1e-6)
    axis.move_by(-1.5).wait(10)
    assert axis.position() == pytest.approx(21.956789, abs=0.00049609375)


@pytest.mark.parametrize("position", [-0.001, 1e6, math.nan, math.inf])
def test_outside_its_limits_it_is_refused_and_stays(position: float, axis: Axis) -> None:
    before = axis.position()
    with pytest.raises(LimitError, match=axis.name):
        axis.move_to(position)
    assert axis.position() == before


def test_a_stop_from_another_thread_ends_the_motion_short(axis: Axis) -> None:
    status = axis.move_to(24.5)
    threading.Timer(0.01, axis.stop).start()
    with contextlib.suppress(MotionError):
        status.wait(5)
    assert not axis.is_moving()
    # The stop may come when the motion has just ended; what ended short must never pass for arrived.
    if abs(axis.position() - 24.5) > 0.001:
        assert not status.success
        assert "stopped on the way" in str(status.exception())


def test_a_plan_of_the_run_engine_moves_and_reads_it(axis: Axis, engine: RunEngine) -> None:
    documents: list[tuple[str, Any]] = []
    plan: Callable[[], Any] = lambda: bp.scan([], axis, 1.0, 3.0, 3)  # noqa: E731
    check_limits(plan())
    engine(plan(), lambda name, document: documents.append((name, document)))
    events = [document["data"][f"{axis.name}_mm"] for name, document in documents if name == "event"]
    assert events == pytest.approx([1.0, 2.0, 3.0], abs=0.0005)


def test_a_plan_outside_the_limits_is_refused_before_it_runs(axis: Axis, engine: RunEngine) -> None:
    with pytest.raises(LimitError):
        check_limits(bp.scan([], axis, 1.0, 1e4, 3))
    with pytest.raises(LimitError):
        engine(bps.mv(axis, 1e4))
    assert axis.position() == pytest.approx(0.0, abs=0.001)


def test_array_and_sensor_keep_their_distance(bench: ConnectedBench) -> None:
    wait_all(*(axis.home() for axis in bench.axes.values()), timeout=20)
    targets = {"array_stage": 20.0, "sensor_stage": 18.85}
    for name in bench.order_moves(targets):
        bench.axes[name].move_to(targets[name]).wait(10)
    gap = bench.least_gap()
    assert gap is not None
    assert 1.1 < gap < 1.15
    for too_near in (lambda: bench.array_stage.move_to(20.9), lambda: bench.sensor_stage.move_to(19.7)):
        with pytest.raises(InterlockError, match=r"at least 0\.3 mm are kept, nothing moved"):
            too_near()
    with pytest.raises(InterlockError):
        bench.order_moves({"array_stage": 30.0, "sensor_stage": 20.0})
    assert bench.order_moves({"array_stage": 21.0, "sensor_stage": 17.0}) == ("sensor_stage", "array_stage")
    bench.sensor_stage.move_to(0.0).wait(10)
    approach = bench.array_stage.move_to(30.0)
    with pytest.raises(InterlockError):
        bench.sensor_stage.move_to(12.0)
    approach.wait(10)


def test_one_stop_stops_every_axis(bench: ConnectedBench) -> None:
    wait_all(*(axis.home() for axis in bench.axes.values()), timeout=20)
    statuses = [axis.move_to(axis.limits[1] * 0.2) for axis in bench.axes.values()]
    bench.stop()
    for status in statuses:
        with contextlib.suppress(MotionError):
            status.wait(5)
    assert not any(axis.is_moving() for axis in bench.axes.values())


def test_the_table_of_devices_names_each(bench: ConnectedBench) -> None:
    rows = {row.name: row for row in bench.identities()}
    assert list(rows) == [*AXES, "camera", "iris", "target"]
    assert len({rows[name].identity for name in AXES}) == 4
    assert all(row.identity != "does not answer" for row in rows.values())


def test_iris_target_and_camera_answer_beside_the_axes(bench: ConnectedBench) -> None:
    bench.iris.set(5.6).wait(10)
    bench.target.set("white").wait(10)
    assert (bench.iris.value(), bench.target.value()) == (pytest.approx(5.6, rel=0.005), "white")
    bench.camera.prepare(0.02)
    assert bench.camera.full_scale == 4095


def go_back_and_forth(axis: Axis) -> None:
    for _ in range(4):
        axis.home().wait(20)
        axis.move_to(40.0).wait(20)


@pytest.mark.ci
@pytest.mark.parametrize("fault", ["silence", "garbage", "wrong-checksum", "cut", "hang-up", "stall", "reset"])
def test_a_fault_on_the_way_ends_in_one_sentence(fault: str, root: Path, tmp_path: Path) -> None:
    shows = {"device": "array_stage", "fault": fault, "after": 40}
    with served(root, tmp_path, 5.0, faults=(shows,)) as file, contextlib.suppress(DeviceError), drivers.connect(file) as bench:
        begin = time.monotonic()
        with pytest.raises(DeviceError) as caught:
            go_back_and_forth(bench.array_stage)
        assert "array_stage" in str(caught.value)
        assert str(caught.value).count("\n") == 0
        assert time.monotonic() - begin < 25
        with contextlib.suppress(DeviceError):
            bench.stop()
