"""What every axis promises (``drivers.contract``), asked of each axis of a simulated bench served
by another process, over TCP and over a pseudo terminal, and what only simulated ones are asked.

What goes wrong on the way is planted in benches served by this process: the bytes are the same, and
no Python starts for each.
"""

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

import drivers
from drivers.base import Axis, wait_all
from drivers.bench import ConnectedBench
from drivers.contract.promises import *  # noqa: F403 - the tests that are in the wheel
from flflab.bench import read_bench
from flflab.errors import (
    CommunicationError,
    DeviceError,
    InterlockError,
    MotionError,
    NotHomedError,
)
from sim.serve import serve, write_bench
from sim.zaber_settings import SETTINGS

LINEAR = ["main_lens_stage", "array_stage", "sensor_stage", "target_stage"]
TURNING = ["rotation_stage", "goniometer", "ring"]
AXES = [*LINEAR, *TURNING]
STEPS = dict.fromkeys(LINEAR, 0.00049609375) | {
    "main_lens_stage": 0.0025 / 256,
    "rotation_stage": 1 / 1919.6418578623391,
    "goniometer": 1 / 500,
    "ring": 1 / 50,
}  # mm, deg
# a child that draws ahead ends once its kernels are compiled, a minute or more where none were
COMPILED_S = 240.0
STARTS = {"rotation_stage.start": "4 deg", "goniometer.start": "-3 deg", "ring.start": "60 deg"}


def write_bench_of_all(root: Path, file: Path, clock: float, *faults: dict[str, Any]) -> Path:
    """Write the bench of every axis at another clock."""
    source = root / "examples" / "benches" / "full.yaml"
    bench = yaml.safe_load(source.read_text(encoding="utf-8"))
    optics = yaml.safe_load((source.parent / bench["optics"]).read_text(encoding="utf-8"))
    optics["sensor"] |= {"resolution": [64, 48], "pixel": "20 um"}
    (file.parent / "camera.yaml").write_text(yaml.safe_dump(optics), encoding="utf-8")
    bench["optics"] = "camera.yaml"
    bench["simulated"].update(clock=clock, faults=list(faults), truths=STARTS)
    file.write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    return file


def end(child: "subprocess.Popen[bytes]") -> None:
    """Close a child's input and wait for its end, but not for ever."""
    try:
        child.communicate(timeout=COMPILED_S)
    except subprocess.TimeoutExpired:
        child.kill()
        pytest.fail(
            f"{child.args}: should end within {COMPILED_S:g} s of the end of its input and did not;"
            " it was killed"
        )


@contextlib.contextmanager
def served(root: Path, folder: Path, clock: float, *options: str) -> Generator[Path]:
    """Serve the bench of every axis in another process; yields a bench file with the addresses
    served.
    """
    given = write_bench_of_all(root, folder / "as_given.yaml", clock)
    bench = yaml.safe_load(given.read_text(encoding="utf-8"))
    command = [sys.executable, "-P", "-m", "flflab", "sim", str(given), "--json", *options]
    with (
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child,
        contextlib.ExitStack() as at_last,
    ):
        at_last.callback(end, child)
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


def with_a_standa_stage(file: Path) -> Path:
    """The main lens on a Standa stage instead, emulated by its maker's library."""
    bench = yaml.safe_load(file.read_text(encoding="utf-8"))
    stage = bench["axes"]["main_lens_stage"]
    del stage["device"], stage["microstep"]
    stage |= {
        "driver": "standa",
        "address": f"xi-emu://{file.with_name('standa.bin')}",
        "step": "2.5 um",
        "speed": "200 mm/s",
    }
    file.write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    return file


def options() -> list[Any]:
    no_pty = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals here")
    return [
        pytest.param((), id="tcp"),
        pytest.param(("--pty",), id="pty", marks=[no_pty, pytest.mark.ci]),
    ]


@pytest.fixture(scope="module", params=options())
def bench(
    request: pytest.FixtureRequest, root: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ConnectedBench]:
    folder = tmp_path_factory.mktemp("bench")
    with (
        served(root, folder, 50.0, *request.param) as file,
        drivers.connect(with_a_standa_stage(file)) as connected,
    ):
        counters = [axis._commands.position() for axis in connected.axes.values()]  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
        for axis in connected.axes.values():
            assert not axis.is_moving()
            with pytest.raises(NotHomedError):
                axis.move_to(sum(axis.limits) / 2)
            with pytest.raises(NotHomedError, match="asked where it is"):
                axis.position()
        unmoved = [axis._commands.position() for axis in connected.axes.values()]  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
        assert unmoved == counters, "connecting and refusing moved something"
        home_all(connected)  # the first motion calls the sentinel, which stays as long as the bench
        yield connected


@pytest.fixture(params=AXES)
def axis(request: pytest.FixtureRequest, bench: ConnectedBench) -> Axis:
    """One axis after the other; all axes stand at their references."""
    home_all(bench)
    return bench.axes[request.param]


def home_all(bench: ConnectedBench) -> None:
    """Each while its neighbours are out of its way: a tilt without a reference may be anything."""
    for names in ([name for name in LINEAR if name != "array_stage"], ["array_stage"], TURNING):
        wait_all(*(bench.axes[name].home() for name in names), timeout=20)


def reading(axis: Axis, share: float) -> float:
    """A reading a share of the limits' upper end away from zero."""
    return share * axis.limits[1]


def step(axis: Axis) -> float:
    """The device's own step, mm or rad."""
    return STEPS[axis.name] / axis.coordinate.per_unit


def test_homing_ends_with_a_reference(axis: Axis) -> None:
    assert axis.is_homed()
    assert axis.position() == pytest.approx(0.0, abs=2 * step(axis))
    assert axis.warnings() == ()


def test_a_move_reads_back_to_the_devices_step(axis: Axis) -> None:
    target = reading(axis, 0.456789123)
    axis.move_to(target).wait(10)
    assert axis.position() == pytest.approx(target, abs=step(axis) / 2 * (1 + 1e-9))
    assert axis.position() / step(axis) == pytest.approx(
        round(axis.position() / step(axis)), abs=1e-6
    )
    axis.move_by(-0.3 * target).wait(10)
    assert axis.position() == pytest.approx(0.7 * target, abs=step(axis))


def test_array_and_sensor_keep_their_distance(bench: ConnectedBench) -> None:
    home_all(bench)
    targets = {"array_stage": 20.0, "sensor_stage": 18.85}
    for name in bench.order_moves(targets):
        bench.axes[name].move_to(targets[name]).wait(10)
    gap = bench.least_gap()
    assert gap is not None
    assert 1.1 < gap < 1.15
    for too_near in (
        lambda: bench.array_stage.move_to(20.9),
        lambda: bench.sensor_stage.move_to(19.7),
    ):
        with pytest.raises(InterlockError, match=r"at least 0\.3 mm are required"):
            too_near()
    with pytest.raises(InterlockError):
        bench.order_moves({"array_stage": 30.0, "sensor_stage": 20.0})
    assert bench.order_moves({"array_stage": 21.0, "sensor_stage": 17.0}) == (
        "sensor_stage",
        "array_stage",
    )
    bench.sensor_stage.move_to(0.0).wait(10)
    approach = bench.array_stage.move_to(30.0)
    with pytest.raises(InterlockError):
        bench.sensor_stage.move_to(12.0)
    approach.wait(10)


def go_back_and_forth(axis: Axis) -> None:
    for _ in range(4):
        axis.home().wait(20)
        axis.move_to(reading(axis, 0.8)).wait(20)


def test_a_homing_that_is_stopped_tells_no_position_that_is_counted_from_nowhere(
    root: Path, tmp_path: Path
) -> None:
    described = read_bench(write_bench_of_all(root, tmp_path / "bench.yaml", 1.0))
    with serve(described) as served:
        write_bench(described, served, tmp_path / "served.yaml")
        with drivers.connect(tmp_path / "served.yaml") as bench:
            for name in LINEAR:
                status = bench.axes[name].home()
                bench.axes[name].stop()
                with pytest.raises(
                    MotionError,
                    match=(
                        f"{name}: look for its reference: stopped on the way where nobody knows,"
                        " for it has no"
                    ),
                ):
                    status.wait(10)


@contextlib.contextmanager
def described_wrongly(wrong: dict[str, Any], root: Path, folder: Path) -> Generator[Path]:
    """The bench file of a served bench, which is wrong about where a stage homes."""
    described = read_bench(write_bench_of_all(root, folder / "bench.yaml", 50.0))
    with serve(described) as served:
        write_bench(described, served, folder / "served.yaml")
        data = yaml.safe_load((folder / "served.yaml").read_text())
        data["axes"]["main_lens_stage"] |= wrong
        (folder / "served.yaml").write_text(yaml.safe_dump(data))
        yield folder / "served.yaml"


WRONG = pytest.mark.parametrize(
    "wrong", [{"home_towards": "+z"}, {"sign": -1}], ids=["home_towards", "sign"]
)


@WRONG
def test_a_stage_that_says_where_its_reference_lies_is_not_sent_to_the_other_end(
    wrong: dict[str, Any], root: Path, tmp_path: Path
) -> None:
    counted = (
        r"main_lens_stage: the device counts its reference as 0 mm, at the low end of its travel,"
        r" where .* have the high one; correct"
    )
    with (
        described_wrongly(wrong, root, tmp_path) as file,
        pytest.raises(DeviceError, match=counted),
        drivers.connect(file),
    ):
        pass


@WRONG
def test_a_reference_that_is_found_at_the_other_end_is_told(
    wrong: dict[str, Any], root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a stage whose firmware does not know where it will count its reference."""
    monkeypatch.delitem(SETTINGS, "limit.home.preset")
    with described_wrongly(wrong, root, tmp_path) as file, drivers.connect(file) as bench:
        found = (
            r"main_lens_stage: .* found it at 0\.0+ mm, at the low end of its travel, where .* have"
            r" the high one; correct"
        )
        with pytest.raises(MotionError, match=found):
            bench.main_lens_stage.home().wait(20)
        bench.target_stage.home().wait(20)


def test_where_no_line_can_be_opened_any_more_every_axis_is_named(
    root: Path, tmp_path: Path
) -> None:
    described = read_bench(write_bench_of_all(root, tmp_path / "bench.yaml", 5.0))
    with serve(described) as served, contextlib.ExitStack() as connected:
        write_bench(described, served, tmp_path / "served.yaml")
        bench = connected.enter_context(drivers.connect(tmp_path / "served.yaml"))
        served.stop()
        for _ in range(2):  # as the lines are lost, and when they cannot be opened anew
            for name, axis in bench.axes.items():
                with pytest.raises(CommunicationError, match=rf"^{name}.*: asked .*; check"):
                    axis.position()
        with pytest.raises(DeviceError) as caught:
            bench.stop()
        sentences = str(caught.value).splitlines()
        assert [sentence.split()[0].rstrip(":") for sentence in sorted(sentences)] == sorted(
            bench.axes
        )
        assert all(
            "cannot be reached" in sentence
            and sentence.endswith("; it may still move, cut its power")
            for sentence in sentences
        )


COMMON = ("silence", "garbage", "cut", "hang-up", "stall", "reset")
FAULTS = [
    *(
        (name, fault)
        for name in ("array_stage", "rotation_stage", "goniometer")
        for fault in COMMON
    ),
    *(("array_stage", "wrong-checksum"), ("goniometer", "wrong-checksum"), ("ring", "deaf")),
]


@pytest.mark.ci
@pytest.mark.parametrize(("name", "fault"), FAULTS)
def test_a_fault_on_the_way_ends_in_one_sentence(
    name: str, fault: str, root: Path, tmp_path: Path
) -> None:
    described = read_bench(
        write_bench_of_all(
            root, tmp_path / "bench.yaml", 5.0, {"device": name, "fault": fault, "after": 40}
        )
    )
    told: list[str] = []
    begin = time.monotonic()
    with serve(described) as addresses:
        write_bench(described, addresses, tmp_path / "served.yaml")
        with (
            contextlib.suppress(DeviceError),
            drivers.connect(tmp_path / "served.yaml") as bench,
        ):  # who is silent takes no stop, either
            try:
                go_back_and_forth(bench.axes[name])
            except DeviceError as error:
                told.append(str(error))
            bench.stop()
    assert time.monotonic() - begin < 25
    (sentence,) = told
    assert name in sentence
    assert "\n" not in sentence
