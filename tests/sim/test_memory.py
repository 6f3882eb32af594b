"""A simulated bench stands, in the next program, where it stood in this one."""

import json
import tempfile
from pathlib import Path

import pytest
import yaml

from drivers.bench import connect
from drivers.simulated import memory_of
from flflab.bench import Bench, read_bench, with_seed
from sim.memory import recall, remember
from sim.serve import Served, serve, write_bench

PLACES = {"target_stage": 12.5, "array_stage": 20.0, "ring": 0.1, "goniometer": 0.01}  # mm, rad


@pytest.fixture
def described(root: Path, tmp_path: Path) -> Bench:
    """The bench of every axis, its stages 200 times faster than real ones."""
    source = root / "examples" / "benches" / "full.yaml"
    bench = yaml.safe_load(source.read_text(encoding="utf-8"))
    bench["optics"] = str((source.parent / bench["optics"]).resolve())
    bench["simulated"]["clock"] = 200
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    return read_bench(tmp_path / "bench.yaml")


def truth(served: Served) -> dict[str, float]:
    now = served.world.clock.now()
    return served.world.elements(now) | served.world.angles(now)


def test_places_references_iris_and_target_are_kept(described: Bench, tmp_path: Path) -> None:
    with serve(described) as served:
        write_bench(described, served, tmp_path / "served.yaml")
        with connect(tmp_path / "served.yaml") as bench:
            bench.home(*[name for name in bench.axes if name != "main_lens_stage"])
            for name, place in PLACES.items():
                bench.axes[name].move_to(place).wait(20)
            bench.iris.set(5.6).wait(20)
            bench.target.set("bars").wait(20)
            told = {name: bench.axes[name].position() for name in PLACES}
        true = truth(served)
        remember(served.world, served.stages, tmp_path / "memory.json")
    with serve(described) as served:
        recall(served.world, served.stages, tmp_path / "memory.json")
        write_bench(described, served, tmp_path / "served.yaml")
        assert truth(served) == pytest.approx(true, abs=1e-9)
        with connect(tmp_path / "served.yaml") as bench:
            for name, place in told.items():
                assert bench.axes[name].position() == pytest.approx(place, abs=1e-9)
            assert not bench.main_lens_stage.is_homed()
            assert bench.iris.value() == pytest.approx(5.6, rel=0.005)
            assert bench.target.value() == "bars"
            bench.target_stage.move_to(20.0).wait(20)
        assert truth(served)["target.z"] == pytest.approx(true["target.z"] + 7.5, abs=0.01)


def test_another_file_camera_or_seed_begins_anew(
    described: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    first = memory_of(described)
    assert first is not None
    assert first == memory_of(read_bench(described.file))
    text = described.file.read_text(encoding="utf-8")
    others = [memory_of(with_seed(described, 7))]
    described.file.write_text(text.replace("minimum_gap: 0.3 mm", "minimum_gap: 0.4 mm"), "utf-8")
    others.append(memory_of(read_bench(described.file)))
    assert len({first, *others}) == 3
    first.parent.rmdir()
    first.parent.symlink_to(described.file.parent)  # whose it is, nobody knows
    assert memory_of(described) is None
    first.parent.unlink()


@pytest.mark.parametrize(
    "spoilt",
    ["", "[]", "{}", '{"axes": 3}', json.dumps({"axes": {}, "iris": float("nan"), "wheel": 0}),
     '{"axes": {"target_stage": {"place": 1e999, "counter": 0, "homed": true}}, "iris": 4,'
     ' "wheel": 0}'],
)  # fmt: skip
def test_a_spoilt_memory_changes_nothing(spoilt: str, described: Bench, tmp_path: Path) -> None:
    (tmp_path / "memory.json").write_text(spoilt, encoding="utf-8")
    with serve(described) as served:
        before = truth(served)
        recall(served.world, served.stages, tmp_path / "memory.json")
        recall(served.world, served.stages, tmp_path / "missing.json")
        assert truth(served) == before
