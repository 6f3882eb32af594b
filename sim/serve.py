"""Serves every instrument of a bench file on the loopback, all looking at one world, and dies with
its parent.
"""

import contextlib
import json
import os
import signal
import stat
import sys
import threading
from collections.abc import Callable, Collection, Generator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from flflab.bench import Bench, DeviceDescription, fields_of
from flflab.errors import InputError, reason
from flflab.image.bands import GivenUpError, given_up_when
from sim.camera import SimulatedCamera
from sim.clock import Clock, RunningClock
from sim.faults import Faults
from sim.folder_camera import FolderLine
from sim.memory import recall, remember
from sim.registry import AXES, MOTOR_FAULTS, Remembers, faults_of
from sim.scpi import Address, Instrument
from sim.server import Open, PtyLine, TcpLine
from sim.settings import Iris, Wheel
from sim.world import World

CAMERA_FAULTS = {
    "scpi": ("silence", "drop", "late", "garbage", "cut", "hang-up", "reset", "lost-frame"),
    "folder": ("silence", "drop", "late", "double", "garbage", "cut", "hang-up", "lost-frame"),
}
BESIDES_AXES = ("scpi", "folder")  # drivers of what is no axis that have a simulator here
# an address at which a maker's library emulates its device, which this world does not see
EMULATED = "xi-emu:"
POLL = 0.2  # s between looks for the end
GRACE = 5.0  # s that a parent has after a Ctrl-C


@dataclass(frozen=True)
class Served:
    """A bench being served: the world behind it, where each instrument answers, what goes wrong
    with the axes, and which of them remember where they stood.
    """

    world: World
    addresses: dict[str, Any]
    lines: tuple[TcpLine | PtyLine | FolderLine, ...]
    scpi: tuple[Address, ...]
    faults: Mapping[str, Faults]
    stages: Mapping[str, Remembers]
    ended: threading.Event = field(default_factory=threading.Event)

    def stop(self) -> None:
        """Close every line; no thread is left, and what is being drawn is given up."""
        self.ended.set()
        for address in self.scpi:
            address.ended.set()
        for line in self.lines:
            line.stop()

    def __enter__(self) -> "Served":
        return self

    def __exit__(self, *problem: object) -> None:
        self.stop()


def require_simulable(bench: Bench) -> None:
    """Refuse what cannot be simulated, without serving it.

    Raises:
        InputError: no instrument of a driver can be simulated, or a number, fault, truth or target
            has no meaning here.
    """
    world = World(bench, RunningClock(bench.description.simulated.clock))
    _check_faults(bench)
    for driver, names in _lines(bench):
        AXES[driver].line(bench, world, names)
    _sharing(_besides_axes(bench), BESIDES_AXES)


def serve(bench: Bench, port: int = 0, *, pty: bool = False, clock: Clock | None = None) -> Served:
    """Serve every instrument of a bench on the loopback, whatever its addresses; instruments that
    share an address share a line.

    Args:
        bench: the bench as read.
        port: of the first line, the next ones count up; 0 takes free ones.
        pty: serial instruments on pseudo terminals instead of TCP.
        clock: simulated time; by default real time at the bench file's rate.

    Raises:
        InputError: no instrument of that driver can be simulated, or a fault or truth has no
            meaning here.
        OSError: a port is taken, or there are no pseudo terminals.
    """
    world = World(bench, clock or RunningClock(bench.description.simulated.clock))
    _check_faults(bench)
    lines: list[TcpLine | PtyLine | FolderLine] = []
    addresses: dict[str, Any] = {"axes": {}}
    faults: dict[str, Faults] = {}
    stages: dict[str, Remembers] = {}

    def listen(open_session: Open, serial: bool) -> str:
        lines.append(
            PtyLine(open_session)
            if pty and serial
            else TcpLine(open_session, port + len(lines) if port else 0)
        )
        return lines[-1].address

    scpi: list[Address] = []
    try:
        for driver, names in _lines(bench):
            line = AXES[driver].line(bench, world, names)
            where = listen(line.open_session, serial=True)
            faults |= line.faults
            stages |= line.stages
            addresses["axes"] |= {
                name: {"driver": driver, "address": where, **place}
                for name, place in line.places.items()
            }
        for driver, shared in _sharing(_besides_axes(bench), BESIDES_AXES):
            if driver == "folder":
                lines.append(_folder(bench, world, shared))
                addresses["camera"] = {"driver": driver, "address": lines[-1].address}
                continue
            address = Address([_instrument(bench, world, name) for name in shared], world.clock)
            scpi.append(address)
            where = listen(address.open_session, serial=False)
            addresses |= {name: {"driver": "scpi", "address": where} for name in shared}
    except BaseException:
        Served(world, addresses, tuple(lines), tuple(scpi), faults, stages).stop()
        raise
    return Served(world, addresses, tuple(lines), tuple(scpi), faults, stages)


def _lines(bench: Bench) -> list[tuple[str, list[str]]]:
    """The axes of each line."""
    return _sharing(
        bench.description.axes,
        AXES,
        [driver for driver, kind in AXES.items() if not kind.share_a_line],
    )


def _besides_axes(bench: Bench) -> dict[str, DeviceDescription]:
    """What is no axis."""
    return {
        "camera": bench.description.camera,
        "iris": bench.description.iris,
        "target": bench.description.target,
    }


def _sharing(
    devices: Mapping[str, DeviceDescription], drivers: Collection[str], alone: Collection[str] = ()
) -> list[tuple[str, list[str]]]:
    """Drivers and names of the devices that share one address, those of some drivers each alone.

    Raises:
        InputError: a device has a driver that nothing here can simulate.
    """
    shared: dict[tuple[str, str, str], list[str]] = {}
    for name, device in devices.items():
        if device.driver in drivers:
            shared.setdefault(
                (device.driver, device.address, name if device.driver in alone else ""), []
            ).append(name)
        elif device.driver != "manual" and not device.address.startswith(EMULATED):
            known = ", ".join((*drivers, "manual"))
            raise InputError(
                f"{name}: there is no simulator for driver '{device.driver}'; drivers with one"
                f" here: {known}, and standa's own library emulates a stage at {EMULATED}///FILE"
            )
    return [(driver, names) for (driver, _, _), names in shared.items()]


def _folder(bench: Bench, world: World, names: list[str]) -> FolderLine:
    if names != ["camera"]:
        raise InputError(
            f"{bench.file}: {', '.join(names)}: only a camera can stand behind a folder; give the"
            " others their own drivers"
        )
    return FolderLine(SimulatedCamera(world, faults_of(bench, "camera")))


def _instrument(bench: Bench, world: World, name: str) -> Instrument:
    faults = faults_of(bench, name)
    if name == "camera":
        return SimulatedCamera(world, faults)
    return Iris(world, faults) if name == "iris" else Wheel(world, faults)


def _check_faults(bench: Bench) -> None:
    """Refuse faults of devices that are not there, and faults that a device cannot have."""
    allowed = {
        name: AXES[axis.driver].faults
        for name, axis in bench.description.axes.items()
        if axis.driver in AXES
    }
    allowed |= {
        "camera": CAMERA_FAULTS.get(bench.description.camera.driver, ()),
        "iris": MOTOR_FAULTS,
        "target": MOTOR_FAULTS,
    }
    for place, fault in enumerate(bench.description.simulated.faults):
        where = bench.where("simulated", "faults", place)
        if fault.device not in allowed:
            raise InputError(
                f"{where}: there is no device '{fault.device}'; allowed: {', '.join(allowed)}"
            )
        known = allowed[fault.device]
        if fault.fault not in known:
            raise InputError(
                f"{where}: '{fault.fault}' is no fault of {fault.device}; allowed:"
                f" {', '.join(known)}"
            )


def warm_up(served: Served, then: Callable[[], object] = lambda: None) -> threading.Thread:
    """Compile what drawing needs, in a thread of its own, while the client homes the stages;
    ``then`` is called at the end.
    """
    cameras = [
        instrument
        for address in served.scpi
        for instrument in address.instruments
        if isinstance(instrument, SimulatedCamera)
    ]
    cameras += [line.camera for line in served.lines if isinstance(line, FolderLine)]

    def draw() -> None:
        # Pools take no work once the interpreter ends; what else fails, fails again when a frame is
        # asked for.
        with (
            contextlib.suppress(RuntimeError, GivenUpError),
            given_up_when(served.ended.is_set),
        ):
            try:
                for camera in cameras:
                    camera.warm_up()
            finally:
                then()

    thread = threading.Thread(target=draw, name="warm-up", daemon=True)
    thread.start()
    return thread


def write_bench(bench: Bench, served: Served, file: Path) -> None:
    """Write a copy of the bench file whose addresses are those served; its camera file is named
    from where the copy lies.

    Raises:
        InputError: the file cannot be written.
    """
    data = fields_of(bench)
    for name, where in served.addresses["axes"].items():
        data["axes"][name]["address"] = _as_written(where["address"])
    for name in ("camera", "iris", "target"):
        if name in served.addresses:
            data[name]["address"] = _as_written(served.addresses[name]["address"])
    data["optics"] = os.path.relpath(
        bench.file.parent.resolve() / data["optics"], file.parent.resolve()
    )
    try:
        file.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True), encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"{file}: cannot be written ({error.strerror or error}); name a file in a folder that"
            " exists"
        ) from error


def _as_written(address: str) -> str:
    return f"socket://{address}" if address.startswith("127.0.0.1:") else address


def main(
    bench: Bench,
    port: int = 0,
    *,
    pty: bool = False,
    json_line: bool = False,
    write_bench_file: Path | None = None,
    memory: Path | None = None,
) -> None:
    """Serve a bench until SIGINT, SIGTERM or, where standard input is a pipe, its end: simulators
    die with their parent.

    Prints one flushed line of JSON with all addresses and, once all that a first frame needs is
    compiled, another; or lines for people.

    Raises:
        InputError: the bench cannot be simulated or written.
    """
    try:
        served = serve(bench, port, pty=pty)
    except OSError as error:
        raise InputError(
            f"the simulated bench cannot listen ({reason(error)}); try another --port"
        ) from error
    begun = threading.Event()

    def draw() -> None:
        if not begun.is_set():
            begun.set()
            warm_up(served, lambda: _say_ready(json_line=json_line))

    with listening_for_the_end(draw) as wait_for_the_end, served:
        if memory is not None:
            recall(served.world, served.stages, memory)
        if write_bench_file:
            write_bench(bench, served, write_bench_file)
        print(json.dumps(served.addresses) if json_line else _for_people(served), flush=True)
        if memory is None or not _tells_of_a_parent(0):  # a command by hand asks before a frame
            draw()
        wait_for_the_end()
        if memory is not None:
            remember(served.world, served.stages, memory)


def _say_ready(*, json_line: bool) -> None:
    with contextlib.suppress(OSError):  # nobody listens any more
        print(
            (
                json.dumps({"ready": True})
                if json_line
                else "Everything is compiled: frames come at their usual pace."
            ),
            flush=True,
        )


def _for_people(served: Served) -> str:
    numbers = {
        name: f", device {where['device']}" if "device" in where else ""
        for name, where in served.addresses["axes"].items()
    }
    devices = [
        (f"axis {name}{numbers[name]}", where) for name, where in served.addresses["axes"].items()
    ]
    devices += [
        (name, served.addresses[name])
        for name in ("camera", "iris", "target")
        if name in served.addresses
    ]
    return "\n".join(
        [
            *(f"{where['address']}  {where['driver']}  {what}" for what, where in devices),
            "Ctrl-C ends the simulation.",
        ]
    )


@contextlib.contextmanager
def listening_for_the_end(
    asked: Callable[[], object] = lambda: None,
) -> Generator[Callable[[], None]]:
    """Gives a function that returns after SIGINT or SIGTERM, or once standard input ends where it
    is a pipe; for the main thread. ``asked`` is called when anything comes over that pipe.

    A Ctrl-C reaches a parent and its children alike: where there is a parent it gets some time to
    stop the axes first.
    """
    ended, interrupted = threading.Event(), threading.Event()
    parent = _tells_of_a_parent(0)
    ends = {signal.SIGTERM: ended, signal.SIGINT: interrupted if parent else ended}

    def end(number: int, frame: object) -> None:
        ends[signal.Signals(number)].set()

    def wait() -> None:
        while not ended.wait(POLL):
            if interrupted.is_set():
                ended.wait(GRACE)
                return

    previous = {number: signal.signal(number, end) for number in ends}
    if parent:
        threading.Thread(
            target=_read_to_end, args=(ended.set, asked), name="parent", daemon=True
        ).start()
    try:
        yield wait
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _tells_of_a_parent(descriptor: int) -> bool:
    """Whether a descriptor ends when the process at its other end does: a pipe or socket, not a
    terminal nor the null device.
    """
    try:
        return not stat.S_ISCHR(os.fstat(descriptor).st_mode)
    except OSError:
        return False


def _read_to_end(then: Callable[[], None], asked: Callable[[], object]) -> None:
    try:
        while os.read(0, 4096):
            asked()
    except OSError:
        sys.stderr.write("standard input cannot be read; the simulation ends\n")
    then()
