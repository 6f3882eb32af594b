"""Lost, doubled, late and flipped answers of each maker's instruments: a recovery or one sentence,
and never a wrong position.
"""

import contextlib
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.base import Axis
from drivers.bench import connect
from flflab.bench import Bench
from flflab.errors import DeviceError
from sim.serve import serve, write_bench
from sim.world import World

WriteBench = Callable[..., Bench]
STEPS = {"array_stage": 0.0005, "rotation_stage": 1e-5, "goniometer": 4e-5}  # mm or rad
EARLY = ("drop", "double", "late", "flip", "wrong-checksum", "garbage", "cut")
LATER = ("double", "late", "hang-up", "stall", "reset")
UNKNOWN = {
    ("rotation_stage", "flip"),
    ("rotation_stage", "wrong-checksum"),
}  # its protocol has no checksum: nothing could tell
CASES = [
    (name, fault, after)
    for after, faults in ((25, EARLY), (60, LATER))
    for name in STEPS
    for fault in faults
]


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "fault", "after"), [case for case in CASES if case[:2] not in UNKNOWN]
)
def test_no_position_is_told_that_the_axis_is_not_at(
    name: str, fault: str, after: int, write_bench_file: WriteBench, tmp_path: Path
) -> None:
    bench = write_bench_file(
        "full", faults=[{"device": name, "fault": fault, "after": after}], clock=200
    )
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        told: list[str] = []
        try:
            with connect(tmp_path / "served.yaml") as connected:
                go_to_and_fro(connected.axes[name], served.world)
        except DeviceError as error:
            told.append(str(error).partition("; and not every axis stopped")[0])
        assert all(name in sentence and "\n" not in sentence for sentence in told)


def go_to_and_fro(axis: Axis, world: World) -> None:
    axis.home().wait(10)
    for share in (0.2, 0.1, 0.3, 0.15):
        axis.move_to(share * axis.limits[1]).wait(10)
        told = [axis.position() for _ in range(4)]
        true = world.carriages[axis.name].at(world.clock.now())
        assert told == pytest.approx([true] * 4, abs=STEPS[axis.name])


@pytest.mark.parametrize("after", range(10))
def test_whichever_message_is_lost_no_thorlabs_controller_that_is_connected_overshoots(
    after: int, write_bench_file: WriteBench, tmp_path: Path
) -> None:
    bench = write_bench_file(
        "full", faults=[{"device": "rotation_stage", "fault": "unheard", "after": after}], clock=200
    )
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        with contextlib.suppress(DeviceError), connect(tmp_path / "served.yaml"):
            host, port = served.addresses["axes"]["rotation_stage"]["address"].split(":")
            with socket.create_connection((host, int(port))) as client:
                client.settimeout(5)
                client.sendall(
                    bytes.fromhex("3b0401005001")
                )  # asks for the backlash distance, after 6 bytes and the channel
                answer = client.recv(12, socket.MSG_WAITALL)
            assert answer[8:] == bytes(4)
