"""A bench from a script: ``ff.connect``, go, snap, and a record that every command reads."""

from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from event_model import DocumentNames, schema_validators

import flflab as ff
from drivers.bench import ConnectedBench
from flflab.bench import Bench
from flflab.errors import (
    DeviceError,
    InputError,
    InterlockError,
    LimitError,
    NotHomedError,
    RecordError,
)
from flflab.record import export_nexus, pack, read_documents
from flflab.study import Study
from procedures.devices import Stages
from procedures.script import ScriptBench

InMemory = Callable[..., ConnectedBench]


@pytest.fixture
def bench(
    described: Callable[..., tuple[Study, Bench]],
    in_memory: InMemory,
    memory_camera: Callable[..., Any],
) -> Generator[ScriptBench, None, None]:
    """A bench whose devices do at once what they are told, its camera of 120 x 90 pixels."""
    _, read = described()
    connected = in_memory(read, memory_camera(shape=(90, 120)), ScriptBench)
    assert isinstance(connected, ScriptBench)
    with connected:
        yield connected


def test_a_script_homes_goes_and_takes_a_picture_on_a_served_bench(
    served: Callable[..., Any],
) -> None:
    with served() as (running, _, file), ff.connect(file) as bench:
        world = running.world
        assert set(bench.where().values()) == {None}
        bench.home()
        bench.go(
            main_lens_z="0 mm", array_z="60 mm", sensor_z="61.15 mm", target_z="-510 mm",
            f_number=4, target="white",
        )  # fmt: skip
        true = world.elements(world.clock.now())
        where = bench.where()
        frame = bench.snap(exposure="2 ms")
    assert where == {
        "main_lens.z": pytest.approx(0.0, abs=1e-3), "array.z": pytest.approx(60.0, abs=1e-3),
        "sensor.z": pytest.approx(61.15, abs=1e-3), "target.z": pytest.approx(-510.0, abs=1e-3),
    }  # fmt: skip
    assert true["sensor.z"] == pytest.approx(61.15, abs=0.02)  # its zero is known to 1 um
    assert frame.picture.shape == (90, 120)
    assert frame.exposure_s == pytest.approx(2e-3, rel=1e-3)
    assert int(frame.picture.max()) > 200  # light arrived


@pytest.mark.parametrize(
    ("asked", "kind", "says"),
    [
        ({"sensor_z": "20 mm"}, LimitError, r"sensor\.z: .* sensor_stage reaches 30 mm to 80 mm"),
        ({"sensor_z": "61.15"}, InputError, r"sensor\.z: '61\.15' has no unit"),
        ({"sensor_z": float("nan")}, LimitError, "sensor_stage reaches"),
        ({"prism_z": 3.0}, InputError, r"no prism_z on a bench; .* sensor\.z"),
        ({"array_roll": "1 deg"}, InputError, r"array\.roll: .* no axis of .* moves it"),
        ({"array_z": 62.0, "sensor_z": 62.1}, InterlockError, r"at least 0\.3 mm"),
        ({"array_z": 60.0, "f_number": 64.0}, LimitError, "iris: asked for 64"),
        ({"array_z": 60.0, "target": "rings"}, LimitError, "target: there is no 'rings' here"),
    ],
)  # fmt: skip
def test_what_is_impossible_is_refused_before_anything_moves(
    bench: ScriptBench, asked: dict[str, Any], kind: type[Exception], says: str
) -> None:
    bench.home()
    begun = [axis.motions for axis in bench.axes.values()]
    iris = bench.iris.value()
    with pytest.raises(kind, match=says):
        bench.go(**asked)
    assert [axis.motions for axis in bench.axes.values()] == begun
    assert bench.iris.value() == iris


def test_an_axis_without_reference_does_not_go(bench: ScriptBench) -> None:
    bench.home("array_stage", "sensor_stage")
    with pytest.raises(NotHomedError, match=r"target_stage: .* home it first"):
        bench.go(array_z=60.0, target_z=-500.0)
    assert bench.where()["array.z"] == pytest.approx(40.0)
    with pytest.raises(InputError, match="there is no axis turret on this bench"):
        bench.home("turret")


def test_array_and_sensor_go_together_in_an_order_that_keeps_their_gap(bench: ScriptBench) -> None:
    bench.home()
    bench.go(array_z=60.0, sensor_z=61.15)
    bench.go(array_z=65.0, sensor_z=66.15)
    bench.go(array_z=60.0, sensor_z=61.15)
    assert bench.where()["array.z"] == pytest.approx(60.0)
    assert bench.where()["sensor.z"] == pytest.approx(61.15)


def test_an_axis_that_moves_during_an_exposure_is_noticed(bench: ScriptBench) -> None:
    bench.home()
    stages = Stages(bench.axes, bench.described)
    assert stages.read()["moved_steps"]["value"] == -1  # nobody looked before
    stages.before.trigger().wait()
    assert stages.read()["moved_steps"]["value"] == 0
    stages.before.trigger().wait()
    bench.go(sensor_z="61.15 mm")
    resolution = bench.axes["sensor_stage"].resolution
    travelled = abs(bench.axes["sensor_stage"].position() - 0.0) / resolution
    assert 1000 < stages.read()["moved_steps"]["value"] <= travelled


def test_a_record_of_a_script_is_one_of_a_sweep(bench: ScriptBench, tmp_path: Path) -> None:
    bench.home()
    taken: list[Any] = []
    with bench.record("focus", out=tmp_path / "focus") as run:
        for place in (61.1, 61.15, 61.2):
            bench.go(array_z=60.0, sensor_z=place, target_z=-500.0, f_number=4, target="bars")
            taken.append(run.snap(note=f"sensor at {place} mm", exposure="5 ms"))
    for name, document in read_documents(tmp_path / "focus"):
        schema_validators[DocumentNames[name]].validate(document)
    found = ff.open_run(tmp_path / "focus")
    assert found.complete
    assert [frame.note for frame in found.frames] == [
        "sensor at 61.1 mm", "sensor at 61.15 mm", "sensor at 61.2 mm",
    ]  # fmt: skip
    assert (found.pictures() == np.stack([frame.picture for frame in taken])).all()
    table = found.table()
    assert table["world_sensor_z_mm"] == pytest.approx([61.1, 61.15, 61.2])
    assert table["sensor_stage_mm"] == pytest.approx([18.9, 18.85, 18.8])
    assert table["exposure_s"] == pytest.approx([5e-3] * 3)
    assert set(table["target"]) == {"bars"}
    assert set(table["validity"]) == {"admitted"}
    assert found.start["record_schema"] == 2
    assert found.start["study"] == "focus"
    for kept in ("bench.yaml", "camera.yaml", "versions.json", "log.txt", "SHA256SUMS"):
        assert (tmp_path / "focus" / kept).exists(), kept
    export_nexus(found, tmp_path / "focus.nxs")
    pack(found)
    assert (ff.open_run(tmp_path / "focus").pictures() == found.pictures()).all()


def test_a_script_that_fails_leaves_what_it_recorded_and_why(
    bench: ScriptBench, tmp_path: Path
) -> None:
    bench.home()
    run = bench.record("cut", out=tmp_path / "cut", frames=1)

    def script() -> None:
        with run:
            run.snap()
            run.snap()

    with pytest.raises(RecordError, match="room for 1 frames"):
        script()
    found = ff.open_run(tmp_path / "cut")
    assert not found.complete
    assert found.stop is not None
    assert found.stop["exit_status"] == "fail"
    assert "room for 1 frames" in found.stop["reason"]
    assert len(found.frames) == 1
    with pytest.raises(RecordError, match="outside the `with` block"):
        run.snap()
    with (
        pytest.raises(RecordError, match="holds a run already"),
        bench.record("cut", out=tmp_path / "cut"),
    ):
        pass


def test_no_picture_is_recorded_while_an_axis_moves_or_has_no_reference(
    bench: ScriptBench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with bench.record("still", out=tmp_path / "still") as run:
        with pytest.raises(NotHomedError):
            run.snap()
        bench.home()
        with monkeypatch.context() as patch:
            patch.setattr(bench.array_stage, "is_moving", lambda: True)
            with pytest.raises(DeviceError, match="array_stage: it still moves"):
                run.snap()
        run.snap()
    assert len(ff.open_run(tmp_path / "still").frames) == 1


@pytest.mark.ci
def test_ctrl_c_in_a_go_stops_what_moves(
    served: Callable[..., Any], until: Callable[..., None]
) -> None:
    with served(clock=1) as (running, _, file), ff.connect(file) as bench:
        bench.home("target_stage")
        axis = bench.target_stage
        begun = axis.move_to

        def interrupted(position: float) -> Any:
            begun(position)
            raise KeyboardInterrupt

        axis.move_to = interrupted
        with pytest.raises(KeyboardInterrupt):
            bench.go(target_z="-460 mm")
        until(lambda: not axis.is_moving(), 2.0)
        assert running.world.elements(running.world.clock.now())["target.z"] < -470


def test_an_unknown_name_of_the_front_door_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'conect'"):
        ff.conect  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]
    assert set(ff.__all__) <= set(dir(ff))
    assert all(callable(getattr(ff, name)) for name in ff.__all__)
