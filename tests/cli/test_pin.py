"""Serial numbers: checked whenever a bench is connected, written after a person saw each axis
move.
"""

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.bench import connect
from flflab.bench import read_bench
from flflab.cli.pin import with_serials
from flflab.errors import DeviceError, InputError
from sim.serve import Served, serve, write_bench

Run = Callable[..., Any]
CHECK = [sys.executable, "-P", "-m", "flflab", "bench", "check", "--bench"]


@pytest.fixture
def bench(root: Path, tmp_path: Path) -> Iterator[tuple[Served, Path]]:
    """A served bench, homed, and a file that leads to it."""
    source = yaml.safe_load((root / "examples/benches/simulated.yaml").read_text(encoding="utf-8"))
    source["optics"] = str(root / "examples" / "cameras" / "osinski.yaml")
    source["simulated"] |= {"clock": 200}
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(source, sort_keys=False), encoding="utf-8")
    described = read_bench(tmp_path / "bench.yaml")
    with serve(described) as served:
        write_bench(described, served, tmp_path / "served.yaml")
        with connect(tmp_path / "served.yaml") as bench:
            for name in ("main_lens_stage", "sensor_stage", "array_stage", "target_stage"):
                bench.axes[name].home().wait(20)
            bench.sensor_stage.move_to(5.0).wait(20)
        yield served, tmp_path / "served.yaml"


def pinned(file: Path, answers: str, *options: str) -> tuple[int, str]:
    """``check --pin`` on a terminal at which a person types these answers."""
    person, terminal = os.openpty()
    try:
        os.write(person, answers.encode())
        ended = subprocess.run(
            [*CHECK, str(file), "--pin", *options],
            stdin=terminal, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            check=False,
        )  # fmt: skip
    finally:
        os.close(person)
        os.close(terminal)
    return ended.returncode, ended.stdout


def serials(file: Path) -> dict[str, str | None]:
    axes = yaml.safe_load(file.read_text(encoding="utf-8"))["axes"]
    return {name: axis.get("serial") for name, axis in axes.items()}


def stands(served: Served) -> dict[str, float]:
    return served.world.elements(served.world.clock.now())


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo terminals")
def test_numbers_are_written_when_a_person_saw_each_axis_move_and_hold_from_then_on(
    bench: tuple[Served, Path],
) -> None:
    served, file = bench
    before = file.read_text(encoding="utf-8")
    axes = read_bench(file).description.axes
    code, said = pinned(file, "y\n" * len(axes) + "y\n")
    assert code == 0, said
    for name, axis in axes.items():
        assert re.search(rf"{name}, serial number \d+: did {axis.moves} move by 1 mm towards", said)
    assert "sensor.z move by 1 mm towards -z (against the light)" in said
    assert served.world.carriages["sensor_stage"].at(served.world.clock.now()) == pytest.approx(
        5.0, abs=0.01
    )
    found = serials(file)
    assert all(found.values())
    assert len(set(found.values())) == len(found)
    kept = [line for line in file.read_text(encoding="utf-8").splitlines() if "serial:" not in line]
    assert kept == before.splitlines()
    with connect(file):  # it is the bench that it was
        pass


@pytest.mark.ci
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo terminals")
def test_exchanged_devices_are_refused_and_pinned_over_only_where_that_is_asked_for(
    bench: tuple[Served, Path],
) -> None:
    _, file = bench
    assert pinned(file, "y\n" * 5)[0] == 0
    right = serials(file)
    data = yaml.safe_load(file.read_text(encoding="utf-8"))
    lens, target = data["axes"]["main_lens_stage"], data["axes"]["target_stage"]
    lens["device"], target["device"] = target["device"], lens["device"]
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    with pytest.raises(DeviceError) as refused:
        connect(file)
    for name in ("main_lens_stage", "target_stage"):
        assert re.search(rf"{name}: .*says serial number '\d+'.*nothing moved", str(refused.value))
    code, said = pinned(file, "y\n" * 5)
    assert code == 1
    assert "--pin --replace" in said
    assert serials(file) == right
    assert pinned(file, "y\ny\nn\n", "--replace")[0] == 1
    assert serials(file) == right  # a no leaves the file as it was
    code, said = pinned(file, "y\n" * 5, "--replace")
    assert code == 0, said
    assert serials(file)["main_lens_stage"] == right["target_stage"]


def test_where_nobody_can_be_asked_nothing_moves_and_nothing_is_written(
    bench: tuple[Served, Path], flflab: Run
) -> None:
    served, file = bench
    before = file.read_text(encoding="utf-8"), stands(served)
    refused = flflab("bench", "check", "--bench", file, "--pin")
    assert refused.code == 1
    assert "no terminal to ask on" in refused.err
    assert before == (file.read_text(encoding="utf-8"), stands(served))


@pytest.mark.parametrize(
    "text",
    ["axes:\n  x:  # the array\n    driver: zaber\n    device: 2\n", "axes: {x: {driver: zaber}}\n",
     "axes:\n  x:\n    driver: zaber\n    serial: 7  # old\ncamera: {}\n"],
    ids=["block", "flow", "over another"],
)  # fmt: skip
@pytest.mark.parametrize("serial", ["100002", 'a"b: \\\n#', "1e3"])
def test_a_number_is_written_as_a_text_whatever_the_device_says(text: str, serial: str) -> None:
    changed = yaml.safe_load(with_serials(text, "bench.yaml", {("axes", "x"): serial}))
    assert changed["axes"]["x"].pop("serial") == serial
    assert changed["axes"]["x"]["driver"] == "zaber"


def test_a_number_is_not_written_where_it_would_be_another_device_s_too() -> None:
    text = "axes:\n  x: &any\n    driver: zaber\n  y: *any\n"
    with pytest.raises(InputError, match=r"an anchor.*by hand.*axes\.y 5"):
        with_serials(text, "bench.yaml", {("axes", "y"): "5"})
