"""After a motion that failed an axis counts as anywhere in its travel, until its reference is found
again; judged by where toy stages truly are.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

import drivers
from flflab.errors import InterlockError, MotionError, NotHomedError

MICROSTEP = 0.49609375e-3
NAMES = ("main_lens", "array", "sensor", "target")


@pytest.fixture
def stages(toy_stage: type[Any]) -> list[Any]:
    """Lens, array, sensor and target; the array takes a second and a half for 15 mm."""
    stages = [toy_stage() for _ in NAMES]
    stages[1].speed = 20_000.0
    return stages


@pytest.fixture
def file(root: Path, tmp_path: Path, stages: list[Any], toy_chain: Callable[..., str]) -> Path:
    bench = yaml.safe_load((root / "examples/benches/simulated.yaml").read_text(encoding="utf-8"))
    bench["optics"] = str(root / "examples/cameras/osinski.yaml")
    address = toy_chain(*stages)
    for name in NAMES:
        bench["axes"][f"{name}_stage"]["address"] = address
    bench |= {name: {"driver": "manual"} for name in ("iris", "target")}
    bench["camera"] = {
        "driver": "folder", "address": str(tmp_path), "full_scale": 4095, "black_level": 64,
        "electrons_per_dn": 3, "read_noise_electrons": 3,
        "exposures": ["1 ms", "1 s"],
    }  # fmt: skip
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench), encoding="utf-8")
    return tmp_path / "bench.yaml"


def gap(stages: list[Any]) -> float:
    return 80 - 40 - (stages[1].position + stages[2].position) * MICROSTEP


def test_an_array_whose_controller_says_idle_too_early_is_stopped_and_nothing_goes_towards_it(
    file: Path, stages: list[Any]
) -> None:
    stages[1].fault = lambda command, reply: lies(reply)
    with drivers.connect(file) as bench:
        with pytest.raises(MotionError, match=r"ended at .* instead"):
            bench.array_stage.move_to(20.0).wait(20)
        assert "stop" in stages[1].heard
        assert not stages[1].busy
        stages[1].go(20.0 / MICROSTEP)  # and goes on whatever it was told
        with pytest.raises(InterlockError, match="array_stage, without a reference: home it first"):
            bench.sensor_stage.move_to(20.0)
        with pytest.raises(NotHomedError, match="a motion of it failed"):
            bench.array_stage.position()
        with pytest.raises(NotHomedError, match="its counter may have lost steps; home it first"):
            bench.array_stage.move_to(1.0)
    assert gap(stages) > 0.3
    stages[1].fault = None
    stages[1].go(stages[1].position)
    with drivers.connect(file) as later:  # another program
        with pytest.raises(InterlockError):
            later.sensor_stage.move_to(20.0)
        later.array_stage.home().wait(20)
        later.array_stage.move_to(5.0).wait(20)
    with drivers.connect(file) as last:
        assert last.array_stage.position() == pytest.approx(5.0, abs=0.001)


def lies(reply: bytes, state: bytes = b"IDLE") -> bytes:
    """The reply with another state in it, and the checksum for that."""
    body = re.sub(rb":..\r\n$", b"", re.sub(rb"BUSY|IDLE", state, reply))
    return b"%s:%02X\r\n" % (body, -sum(body[1:]) % 256)


def test_a_stage_that_is_held_is_lost_though_its_counter_agrees_with_itself(
    file: Path, stages: list[Any]
) -> None:
    stages[1].stuck_at = 10_000.0
    with drivers.connect(file) as bench:
        with pytest.raises(MotionError):
            bench.array_stage.move_to(20.0).wait(20)
        assert not bench.array_stage.is_homed()
        with pytest.raises(InterlockError):
            bench.sensor_stage.move_to(20.0)
        bench.sensor_stage.move_to(0.0).wait(20)  # away from it


@pytest.mark.ci
def test_a_stage_that_failed_and_says_that_it_moves_on_and_on_may_be_anywhere(
    file: Path, stages: list[Any]
) -> None:
    stages[1].stuck_at, stages[1].speed = 1000.0, 2000.0
    with drivers.connect(file) as bench:
        status = bench.array_stage.move_to(5.0)
        stages[1].fault = lambda command, reply: lies(reply, b"BUSY")
        with pytest.raises(MotionError, match="no progress"):
            status.wait(20)
        assert bench.array_stage.reach() is None
        with pytest.raises(InterlockError, match="array_stage, without a reference"):
            bench.sensor_stage.move_to(30.0)


def test_a_motion_that_was_stopped_keeps_its_place(file: Path, stages: list[Any]) -> None:
    with drivers.connect(file) as bench:
        status = bench.array_stage.move_to(20.0)
        bench.array_stage.stop()
        with pytest.raises(MotionError, match="stopped on the way"):
            status.wait(20)
        there = stages[1].position * MICROSTEP
        assert bench.array_stage.position() == pytest.approx(there, abs=0.001)
