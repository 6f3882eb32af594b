"""What a bench file says to the drivers is refused when it is read: one stage for two axes,
addresses that are none.
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

import drivers
from drivers.connection import Connection
from drivers.described import one_instrument, require_drivable
from drivers.registry import AXES
from drivers.simulated import SimulatedOnDemand
from drivers.stopping import axes_to_stop, stop_axes
from drivers.survey import survey
from drivers.transport import serial_place
from drivers.zaber import ZaberKeys
from flflab.bench import read_bench
from flflab.errors import DeviceError, InputError
from sim.serve import serve, write_bench

Changed = Callable[..., Path]
LINE = "socket://127.0.0.1:5001"
ANGLES: dict[str, Any] = {"limits": ["-9 deg", "9 deg"], "speed": "5 deg/s", "zero": "0 deg"}
THORLABS = {"driver": "thorlabs", "moves": "array.yaw", "home_towards": "-yaw", **ANGLES}
ORIENTAL = {
    "driver": "oriental",
    "steps_per_degree": 500,
    "moves": "array.pitch",
    "home_towards": "-pitch",
    **ANGLES,
}
STANDA = {
    "driver": "standa", "step": "2.5 um", "moves": "array.z", "home_towards": "-z",
    "limits": ["0 mm", "9 mm"], "speed": "1 mm/s",
}  # fmt: skip
ZABER = {**STANDA, "driver": "zaber", "microstep": "0.5 um"}
del ZABER["step"]


@pytest.fixture
def pair(root: Path, tmp_path: Path) -> Changed:
    """A bench of two axes, the first as given, the second as given and moving what the first does
    not.
    """

    def write(first: dict[str, Any], second: dict[str, Any]) -> Path:
        bench = yaml.safe_load(
            (root / "examples" / "benches" / "simulated.yaml").read_text(encoding="utf-8")
        )
        bench["optics"] = str(root / "examples" / "cameras" / "osinski.yaml")
        other = "target.z" if second["moves"] == "array.z" else "array.roll"
        bench["axes"] = {
            "one": first,
            "two": {**second, "moves": other, "home_towards": f"-{other.partition('.')[2]}"},
        }
        (tmp_path / "pair.yaml").write_text(
            yaml.safe_dump(bench, sort_keys=False), encoding="utf-8"
        )
        return tmp_path / "pair.yaml"

    return write


@pytest.mark.parametrize(
    ("axis", "here", "there"),
    [
        (ZABER, {"address": LINE, "device": 1}, {"address": LINE, "device": 1}),
        (
            ZABER,
            {"address": LINE, "device": 1},
            {"address": "localhost:5001", "device": 1, "axis": 1},
        ),
        (THORLABS, {"address": "COM3"}, {"address": "com3"}),
        (ORIENTAL, {"address": LINE, "device": 4}, {"address": LINE, "device": 4, "parity": "N"}),
        (STANDA, {"address": "xi-net://host/123"}, {"address": "xi-net://host/123"}),
        (STANDA, {"address": "COM3"}, {"address": r"xi-com:\\.\COM3"}),
    ],
    ids=[
        "zaber",
        "zaber spelt in another way",
        "thorlabs",
        "oriental",
        "standa",
        "standa spelt in another way",
    ],
)
def test_two_axes_are_never_one_stage(
    axis: dict[str, Any], here: dict[str, Any], there: dict[str, Any], pair: Changed
) -> None:
    with pytest.raises(
        InputError,
        match=(
            r"pair\.yaml:\d+: axes\.two.*: two is the same stage as one, .*; give each axis an"
            r" address"
        ),
    ):
        require_drivable(read_bench(pair(axis | here, axis | there)))


@pytest.mark.parametrize(
    ("here", "there", "shown"),
    [
        ("/dev/ttyS0", "/dev/../dev/ttyS0", "/dev/ttyS0"),
        ("/dev/tty.usbserial-1", "/dev/cu.usbserial-1", "/dev/cu.usbserial-1"),
        ("COM3", "com3", "COM3"),
        ("localhost:5001", LINE, "127.0.0.1:5001"),
    ],
    ids=["paths", "the two files of a port on macOS", "ports", "network"],
)
@pytest.mark.skipif(sys.platform == "win32", reason="there a path is spelt with its drive")
def test_two_makers_are_never_at_one_address(
    here: str, there: str, shown: str, pair: Changed
) -> None:
    file = pair(ZABER | {"address": here, "device": 1}, ORIENTAL | {"address": there, "device": 2})
    asked = (
        rf"axes\.two\.address: two \(oriental\) shares {shown} with one \(zaber\); one line speaks"
        r" one maker's protocol, give each"
    )
    with pytest.raises(InputError, match=rf"pair\.yaml:\d+: {asked}"):
        require_drivable(read_bench(file))


@pytest.mark.parametrize("device", ["camera", "iris", "target"])
def test_no_scpi_instrument_is_at_the_address_of_a_stage(device: str, pair: Changed) -> None:
    file = pair(ZABER | {"address": LINE, "device": 1}, ZABER | {"address": LINE, "device": 2})
    bench = yaml.safe_load(file.read_text(encoding="utf-8"))
    bench[device] = {"driver": "scpi", "address": "localhost:5001"}
    file.write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    asked = (
        rf"{device}\.address: {device} \(scpi\) shares 127\.0\.0\.1:5001 with one \(zaber\); one"
        r" line speaks one maker's protocol"
    )
    with pytest.raises(InputError, match=rf"pair\.yaml:\d+: {asked}"):
        require_drivable(read_bench(file))


def test_scpi_instruments_may_share_an_address_of_their_own(pair: Changed) -> None:
    file = pair(ZABER | {"address": LINE, "device": 1}, ZABER | {"address": LINE, "device": 2})
    bench = yaml.safe_load(file.read_text(encoding="utf-8"))
    bench |= {
        device: {"driver": "scpi", "address": "localhost:5002"}
        for device in ("camera", "iris", "target")
    }
    file.write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    require_drivable(read_bench(file))


@pytest.mark.parametrize(
    ("axis", "here", "there"),
    [
        (ZABER, {"address": LINE, "device": 1}, {"address": LINE, "device": 2}),
        (ZABER, {"address": LINE, "device": 1}, {"address": LINE, "device": 1, "axis": 2}),
        (
            ZABER,
            {"address": LINE, "device": 1},
            {"address": "socket://127.0.0.1:5002", "device": 1},
        ),
        (THORLABS, {"address": "COM3"}, {"address": "COM4"}),
        (THORLABS, {"address": "simulated"}, {"address": "simulated"}),
        (ORIENTAL, {"address": LINE, "device": 4}, {"address": LINE, "device": 5}),
        ({**ZABER, "driver": "manual"}, {}, {}),
    ],
    ids=[
        "device numbers",
        "axes of one device",
        "lines",
        "ports",
        "each simulated by itself",
        "slaves of one line",
        "by hand",
    ],
)
def test_axes_that_anything_tells_apart_are_taken(
    axis: dict[str, Any], here: dict[str, Any], there: dict[str, Any], pair: Changed
) -> None:
    manual = axis["driver"] == "manual"
    first, second = (
        {key: value for key, value in (axis | own).items() if not (manual and key == "microstep")}
        for own in (here, there)
    )
    require_drivable(read_bench(pair(first, second)))


@pytest.mark.skipif(sys.platform == "win32", reason="there ports are no files")
def test_a_link_to_a_port_is_that_port(tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to(os.devnull)
    assert serial_place(str(tmp_path / "by-id")) == os.devnull


@pytest.mark.parametrize(
    "address", ["192.168.0.1", "", "ttyUSB0", "host:0", "socket://host", "127.0.0.1:70000"]
)
def test_an_address_that_is_none_is_refused_with_what_one_is(address: str, pair: Changed) -> None:
    file = pair(ZABER | {"address": address, "device": 1}, ZABER | {"address": LINE, "device": 2})
    with pytest.raises(
        InputError,
        match=r"pair\.yaml:\d+: axes\.one\.address: '.*' is not an address; give .*host:port",
    ):
        require_drivable(read_bench(file))


@pytest.mark.parametrize(("reach", "free"), [("39 mm", True), ("41 mm", False)])
def test_a_sensor_homes_towards_the_array_only_where_it_ends_clear_of_a_homed_one(
    reach: str, free: bool, root: Path, tmp_path: Path
) -> None:
    data = yaml.safe_load(
        (root / "examples" / "benches" / "simulated.yaml").read_text(encoding="utf-8")
    )
    data["optics"] = str(root / "examples" / "cameras" / "osinski.yaml")
    data["axes"]["sensor_stage"] |= {
        "home_towards": "-z",
        "limits": ["0 mm", reach],
    }  # the array's reference is at 40 mm, 80 mm - 40 mm
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    if free:
        require_drivable(read_bench(tmp_path / "bench.yaml"))
        return
    with pytest.raises(
        InputError,
        match=(
            r"sensor_stage\.home_towards: .* and could leave -1\.\d+ mm .* let it home towards \+z,"
            r" or correct"
        ),
    ):
        require_drivable(read_bench(tmp_path / "bench.yaml"))


@pytest.fixture
def reached_twice(
    root: Path, tmp_path: Path, other_address: Callable[[str], str]
) -> Iterator[Path]:
    """A served bench whose array's axis leads to the main lens's stage by another address."""
    bench = read_bench(root / "examples" / "benches" / "simulated.yaml")
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        data = yaml.safe_load((tmp_path / "served.yaml").read_text(encoding="utf-8"))
        stage = data["axes"]["main_lens_stage"]
        data["axes"]["array_stage"] |= {
            "device": stage["device"],
            "address": other_address(stage["address"]),
        }
        (tmp_path / "served.yaml").write_text(
            yaml.safe_dump(data, sort_keys=False), encoding="utf-8"
        )
        yield tmp_path / "served.yaml"


def test_one_instrument_that_answers_for_two_axes_is_refused_before_anything_can_move(
    reached_twice: Path,
) -> None:
    with pytest.raises(
        DeviceError,
        match=(
            r"^array_stage and main_lens_stage: one instrument, serial number 100001, answers for"
            r" both; "
        ),
    ):
        drivers.connect(reached_twice)
    serials = {row.name: row.serial for row in survey(read_bench(reached_twice))}
    assert serials["array_stage"] == serials["main_lens_stage"] == "100001"
    assert (serials["sensor_stage"], serials["camera"]) == ("100003", "")


def test_two_spellings_of_one_line_are_one_connection(
    pair: Changed, toy_chain: Callable[..., str], toy_stage: Callable[..., Any]
) -> None:
    here = toy_chain(toy_stage(), toy_stage())  # answers one client at a time
    there = here.replace("127.0.0.1", "localhost")
    bench = read_bench(
        pair(ZABER | {"address": here, "device": 1}, ZABER | {"address": there, "device": 2})
    )
    with ExitStack() as opened:
        connection = Connection(bench, opened, SimulatedOnDemand(bench, opened))
        assert [connection.open(name).is_moving() for name in ("one", "two")] == [False, False]
    assert stop_axes(axes_to_stop(bench.file)) == {}


def test_an_axis_that_could_not_be_set_up_is_stopped_all_the_same(
    pair: Changed, toy_chain: Callable[..., str], toy_stage: Callable[..., Any]
) -> None:
    stages = unknown, stubborn = toy_stage(speed=10.0, resolution=0), toy_stage(speed=10.0)
    stubborn.fault = lambda command, reply: (
        reply.replace(b"OK", b"RJ") if command.startswith("set maxspeed") else reply
    )
    for stage in stages:
        stage.go(stage.limit)
    address = toy_chain(*stages)
    bench = read_bench(
        pair(ZABER | {"address": address, "device": 1}, ZABER | {"address": address, "device": 2})
    )
    assert stop_axes(axes_to_stop(bench.file)) == {}
    assert not unknown.busy
    assert not stubborn.busy


def test_an_axis_whose_driver_fails_as_nobody_foresaw_keeps_the_next_of_its_line_from_no_stop(
    pair: Changed,
    toy_chain: Callable[..., str],
    toy_stage: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def stop(name: str, *_: object) -> None:
        raise ZeroDivisionError(f"{name} divided by nothing")

    careless = ModuleType("drivers.careless")
    vars(careless).update(ZaberKeys=ZaberKeys, stop_axis=stop)
    monkeypatch.setitem(sys.modules, "drivers.careless", careless)
    monkeypatch.setitem(
        vars(AXES)["_built_in"], "careless", replace(AXES["zaber"], module="careless")
    )
    stages = still_moving, stopped = toy_stage(speed=10.0), toy_stage(speed=10.0)
    for stage in stages:
        stage.go(stage.limit)
    address = toy_chain(*stages)
    bench = read_bench(
        pair(
            ZABER | {"driver": "careless", "address": address, "device": 1},
            ZABER | {"address": address, "device": 2},
        )
    )
    assert stop_axes(axes_to_stop(bench.file)) == {
        "one": "one divided by nothing; it may still move, cut its power"
    }
    assert still_moving.busy
    assert not stopped.busy


def test_two_makers_may_have_given_one_number() -> None:
    assert (
        one_instrument(
            {"one": ("zaber", "70001"), "two": ("standa", "70001"), "three": ("standa", "")}
        )
        == []
    )
    (twice,) = one_instrument({"one": ("zaber", "70001"), "two": ("zaber", "70001")})
    assert twice.startswith("two and one: one instrument, serial number 70001, answers for both; ")
