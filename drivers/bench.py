"""A bench as connected: every device of a bench file behind its promise, all faults at once, one
stop for all.
"""

import os
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

from drivers.answers import answers
from drivers.axis import Axis, Clearance
from drivers.camera import CameraDevice
from drivers.commands import FOLLOWING
from drivers.connection import Connection, can_outlive
from drivers.described import device_of, one_instrument, require_drivable
from drivers.detector import Detector
from drivers.interlocks import (
    check_motion,
    gap_rules,
    half_way,
    homing_groups,
    order_moves,
    retreats,
)
from drivers.locks import folder
from drivers.owner import Owner
from drivers.sentinel import Sentinel
from drivers.setting import Setting
from drivers.simulated import SimulatedOnDemand
from drivers.status import wait_all
from drivers.survey import Identity, look
from flflab.bench import Bench, Moved, read_bench
from flflab.errors import CommunicationError, DeviceError, InputError, InterlockError

STOP_TIMEOUT_S = 5.0
REST_S = 3.0  # for braking
LOOK_S = 0.005


class ConnectedBench:
    """The devices of a bench; a context manager. Axes are attributes too:
    ``bench.array_stage.move_to(12.5).wait()``.

    Leaving it after an error stops every axis first.
    """

    def __init__(
        self,
        described: Bench,
        axes: Mapping[str, Axis],
        camera: CameraDevice,
        iris: Setting[float],
        target: Setting[str],
        addresses: Mapping[str, str],
        owner: Owner | None,
        sentinels: ExitStack,
        resources: ExitStack,
    ) -> None:
        self.described = described
        self.axes = dict(axes)
        self.camera = camera
        self.detector = Detector(camera)
        self.iris = iris
        self.target = target
        self.gaps = gap_rules(described, {name: axis.travel for name, axis in self.axes.items()})
        self._addresses = addresses
        self._process = os.getpid()
        self._owner = owner
        self._sentinels = sentinels
        self._resources = resources
        self.doing = ""  # what a procedure does now, for who asks
        self._told_to_stop = False
        self._watching = threading.Lock()
        self._sentinel: Sentinel | None = None
        self._moved: set[str] = set()
        self._outliving = {
            name: axis.model_copy(update={"address": addresses[name]})
            for name, axis in described.description.axes.items()
            if can_outlive(axis)
        }
        for axis in self.axes.values():
            axis.guard = self._guard
            axis.interrupted = self.told_to_stop

    def __getattr__(self, name: str) -> Axis:
        try:
            return self.__dict__["axes"][name]
        except KeyError:
            raise AttributeError(
                f"the bench has no {name}; its axes are {', '.join(self.__dict__.get('axes', ()))}"
            ) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if os.getpid() != self._process:
            return  # a forked child: what moves is its parent's
        try:
            if error is not None:
                self.stop_what_moves()
        except DeviceError as not_stopped:
            raise DeviceError(
                f"{error or 'interrupted'}; and not every axis stopped: {not_stopped}"
            ) from error
        finally:
            self.close()

    def stop(self) -> None:
        """Stop every axis now, from any thread; one that fails keeps no other from stopping.

        Raises:
            DeviceError: at least one axis did not take the command; each is named.
        """
        self._stop(self.axes.values())

    def stop_what_moves(self) -> None:
        """Stop every axis whose motion was begun here and not seen to end; errors as ``stop``."""
        self._stop([axis for axis in self.axes.values() if axis.is_under_way()])

    def home(self, *names: str) -> None:
        """Look for the reference of every axis, or of the ones named, and wait: array and sensor
        away from each other, each while its neighbours are out of its way.

        Raises:
            InputError: there is no axis of a name.
            InterlockError: an axis could come too near to a neighbour.
            DeviceError: an axis failed, or moves already.
        """
        if unknown := [name for name in names if name not in self.axes]:
            raise InputError(
                f"there is no axis {unknown[0]} on this bench; its axes are {', '.join(self.axes)}"
            )
        for group in homing_groups(self.described):
            wait_all(*[self.axes[name].home() for name in group if name in (names or self.axes)])

    def _stop(self, axes: Collection[Axis]) -> None:
        described = self.described.description.axes
        faults: dict[str, str] = {
            axis.name: f"{axis.name}: no answer to the stop within {STOP_TIMEOUT_S:g} s;"
            f" {described[axis.name].cut_its_power}"
            for axis in axes
        }

        def stop(axis: Axis) -> None:
            try:
                axis.stop()
            except Exception as error:
                faults[axis.name] = f"{error}; {described[axis.name].cut_its_power}"
            else:
                del faults[axis.name]

        threads = [
            threading.Thread(target=stop, args=(axis,), name=f"stop {axis.name}", daemon=True)
            for axis in axes
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(STOP_TIMEOUT_S)
        if faults:
            raise DeviceError("\n".join(faults.values()))

    def stop_for_good(self) -> None:
        """Stop every axis as ``stop`` does, for somebody else, and see that it rests: no axis moves
        over this connection any more, also where all stood just then.

        Raises:
            DeviceError: at least one axis did not take the command, or does not come to rest; each
                is named.
        """
        self._told_to_stop = True
        self.stop()
        deadline = time.monotonic() + REST_S
        moving = list(self.axes.values())
        while moving := [axis for axis in moving if axis.is_moving()]:
            if time.monotonic() > deadline:
                raise DeviceError(
                    "\n".join(
                        f"{axis.name}: still moves after the stop; cut its power" for axis in moving
                    )
                )
            time.sleep(LOOK_S)

    def told_to_stop(self) -> bool:
        """Whether somebody else had this bench stopped since it was connected."""
        if not self._told_to_stop and self._owner is not None:
            self._told_to_stop = self._owner.told_to_stop()
        return self._told_to_stop

    def close(self) -> None:
        """Let go of everything, in the reverse order of opening; may be called again. In a child
        that this process forked it does nothing.
        """
        if os.getpid() != self._process:
            return
        self.detector.close()
        self._resources.close()

    def axis_of(self, element: Moved) -> Axis | None:
        """The axis that moves an element or turns the array, None where nothing does."""
        found = self.described.description.axis_of(element)
        return None if found is None else self.axes[found[0]]

    def world(self, moved: Moved) -> float:
        """Where an element stands by its axis's reading, world z in mm, or how the array is turned,
        rad.

        Raises:
            InputError: nothing moves it.
            CommunicationError: the axis does not answer.
        """
        found = self.described.description.axis_of(moved)
        if found is None:
            raise InputError(f"{self.described.file}: no axis moves {moved}; give one in `axes`")
        name, axis = found
        return axis.world(self.axes[name].position())

    def order_moves(self, targets: Mapping[str, float]) -> tuple[str, ...]:
        """In which order axes can go to these readings from where they are, so that the minimum gap
        holds on the way.

        Raises:
            LimitError: a target is outside its axis's limits.
            InterlockError: there is no such order.
        """
        for name, target in targets.items():
            self.axes[name].check_value(target)
        return order_moves(
            self.gaps, {name: axis.reach() for name, axis in self.axes.items()}, targets
        )

    def check_way(self, name: str, readings: Sequence[float]) -> None:
        """Refuse a way of an axis through several readings, from where it is, before it moves.

        Raises:
            LimitError: a reading is outside its limits.
            NotHomedError: it has no reference.
            InterlockError: a stretch of the way comes too near to a neighbour.
            CommunicationError: an axis does not answer.
        """
        axis = self.axes[name]
        for reading in readings:
            axis.check_value(reading)
        start, others = axis.position(), self._reaches(besides=name)
        for reading in readings:
            check_motion(self.gaps, name, start, reading, others)
            start = reading

    def least_gap(self) -> float | None:
        """The smallest gap possible now between array and sensor, mm, uncertainties counted; None
        where no axis moves either.

        Raises:
            CommunicationError: an axis does not answer.
        """
        gaps = [gap for gap in self.gaps if gap.names == ("array", "sensor")]
        reaches = self._reaches()
        return min((gap.smallest(reaches) for gap in gaps), default=None)

    def identities(self) -> list[Identity]:
        """What stands on the bench, one line a device; a device that fails says so in its line."""
        instruments = {**self.axes, "camera": self.camera, "iris": self.iris, "target": self.target}
        return [
            look(name, device_of(self.described, name), instrument, self._addresses[name])
            for name, instrument in instruments.items()
        ]

    def _guard(self, name: str, start: float | None, end: float | None) -> Clearance | None:
        if os.getpid() != self._process:
            raise DeviceError(
                f"{name}: asked to move, nothing moved: the process that connected the bench moves"
                " it, not one that it forked"
            )
        if self.told_to_stop():
            raise DeviceError(
                f"{name}: asked to move, nothing moved: another program had this bench stopped;"
                " connect again when it may move"
            )
        if self._owner is not None and not self._owner.owns():
            raise DeviceError(
                f"{name}: asked to move, nothing moved: the files in {folder()} that say who drives"
                " this bench were taken away, so another program may drive it; connect again"
            )
        self._have_sentinel(name)
        if retreats(self.gaps, name, start, end):
            return None
        begun = {other: axis.motions for other, axis in self.axes.items()}
        try:
            others = self._reaches(besides=name)
        except CommunicationError as error:
            raise DeviceError(
                f"{name}: asked to move, nothing moved, its neighbour does not answer: {error}"
            ) from error
        check_motion(self.gaps, name, start, end, others)
        stood = {
            other: reach[0]
            for other, reach in others.items()
            if reach and reach[0] == reach[1] and other in self._outliving
        }
        if not stood:
            return None
        halt = None if start is None else half_way(self.gaps, name, start, end, others)
        return Clearance(lambda: self._require_standing(name, stood, begun), halt)

    def _require_standing(
        self, name: str, stood: Mapping[str, float], begun: Mapping[str, int]
    ) -> None:
        """Refuse to go on where a neighbour is not where it stood and was not moved from here: no
        lock reaches another computer.

        Raises:
            InterlockError: it moved.
            DeviceError: it does not answer.
        """
        for other, reading in stood.items():
            axis = self.axes[other]
            if axis.motions != begun[other]:
                continue  # its own guard counted this motion
            try:
                now = axis.count()
            except CommunicationError as error:
                raise DeviceError(
                    f"{name}: asked to move, stopped on the way, its neighbour does not answer:"
                    f" {error}"
                ) from error
            moved = abs(now - reading) > FOLLOWING[axis.coordinate.unit]
            if moved and axis.motions == begun[other]:
                raise InterlockError(
                    f"{name}: asked to move, stopped on the way, for its neighbour {other} moved"
                    f" meanwhile, from {axis.coordinate.show(reading)} to"
                    f" {axis.coordinate.show(now)}, and not from here; end whatever else drives it,"
                    " perhaps on another computer, or look whether it lost its power"
                )

    def _have_sentinel(self, name: str) -> None:
        """Before a motion a sentinel begins to watch over the axes that could outlive this process,
        unless one does, and hears which one is to move.
        """
        with self._watching:
            if name not in self._outliving:
                return
            if self._sentinel is None or not self._sentinel.watches():
                self._sentinel = Sentinel(self.described.file, self._outliving)
                self._sentinels.callback(self._sentinel.close)
            self._moved.add(name)
            for moved in self._moved:
                self._sentinel.starts(moved)

    def _reaches(self, besides: str = "") -> dict[str, tuple[float, float] | None]:
        """Between which readings the axes that the gaps depend on are until they rest."""
        movers = {name for gap in self.gaps for name in gap.movers}
        return {name: self.axes[name].reach() for name in movers if name != besides}


Connected = TypeVar("Connected", bound=ConnectedBench)


def connect(bench_file: str | Path) -> ConnectedBench:
    """Connect to every device of a bench file; nothing moves.

    Raises:
        InputError: the bench file is wrong; every fault with file, line and field.
        DeviceError: another program drives the bench, or devices are missing or wrong: every fault
            in one message; nothing stays open.
    """
    return connect_described(read_bench(Path(bench_file)))


def connect_described(described: Bench, memory: Path | None = None) -> ConnectedBench:
    """Connect to every device of a bench as read; nothing moves. Errors as ``connect``.

    Args:
        described: the bench as read.
        memory: file in which what is simulated keeps where it stands.
    """
    return connect_as(ConnectedBench, described, memory)


def connect_as(kind: type[Connected], described: Bench, memory: Path | None = None) -> Connected:
    """Connect to every device of a bench as a kind of connected bench. Errors as ``connect``."""
    description = described.description
    require_drivable(described)
    with ExitStack() as resources:
        owner = (
            Owner(described.file)
            if any(can_outlive(axis) for axis in description.axes.values())
            else None
        )
        if owner is not None:
            resources.callback(owner.close)
        sentinels = resources.enter_context(
            ExitStack()
        )  # let go after every axis was stopped, before the bench is another program's
        connection = Connection(
            described, resources, SimulatedOnDemand(described, resources, memory)
        )
        axes: dict[str, Axis] = {
            name: device
            for name in description.axes
            if (device := connection.open(name)) is not None
        }
        camera, iris, target = (connection.open(name) for name in ("camera", "iris", "target"))
        connection.raise_faults()
        if twice := one_instrument(
            {name: (description.axes[name].driver, axis.serial()) for name, axis in axes.items()}
        ):
            raise DeviceError("\n".join(twice))
        bench = kind(
            described,
            axes,
            camera,
            iris,
            target,
            connection.addresses,
            owner,
            sentinels,
            resources.pop_all(),
        )
    if owner is not None:
        owner.stops_with(bench.stop_for_good, answers(bench))
    return bench
