"""A bench as connected: every device of a bench file behind its promise, all faults at once, one stop for all."""

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, TypeVar

from drivers.axis import Axis
from drivers.camera import Camera, CameraDevice, Detector
from drivers.interlocks import check_motion, gap_rule, least_gap, order_moves, retreats
from drivers.owner import Owner
from drivers.registry import AXES, CAMERAS, IRISES, TARGETS
from drivers.sentinel import Sentinel
from drivers.setting import Setting
from drivers.simulated import SimulatedBench
from flflab.bench import AxisDescription, Bench, DeviceDescription, Moved, read_bench
from flflab.errors import CommunicationError, DeviceError, FlflabError, InputError

Opened = TypeVar("Opened")
Driver = TypeVar("Driver")
STOP_TIMEOUT_S = 5.0


class Identity(NamedTuple):
    """One line of the table of devices: texts; position in mm is None or rad is None where there is none or its reference is missing."""

    name: str
    driver: str
    address: str
    identity: str
    position: float | None
    state: str


class ConnectedBench:
    """The devices of a bench; a context manager. Axes are attributes too: ``bench.array_stage.move_to(12.5).wait()``.

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
        resources: ExitStack,
    ) -> None:
        self.described = described
        self.axes = dict(axes)
        self.camera = camera
        self.detector = Detector(camera)
        self.iris = iris
        self.target = target
        self.gap_rule = gap_rule(described, {name: axis.travel for name, axis in self.axes.items()})
        self._addresses = addresses
        self._resources = resources
        self._watching = threading.Lock()
        self._sentinel: Sentinel | None = None
        self._outliving = {name: addresses[name] for name, axis in described.description.axes.items() if _can_outlive(axis)}
        for axis in self.axes.values():
            axis.guard = self._guard

    def __getattr__(self, name: str) -> Axis:
        try:
            return self.__dict__["axes"][name]
        except KeyError:
            raise AttributeError(f"the bench has no {name}; its axes are {', '.join(self.__dict__.get('axes', ()))}") from None

    def __enter__(self) -> "ConnectedBench":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if error is not None:
                self.stop()
        except DeviceError as not_stopped:
            raise DeviceError(f"{error or 'interrupted'}; and then not every axis took the stop: {not_stopped}") from error
        finally:
            self.close()

    def stop(self) -> None:
        """Stop every axis now, from any thread; one that fails keeps no other from stopping.

        Raises:
            DeviceError: at least one axis did not take the command; each is named.
        """
        faults: dict[str, str] = {name: f"{name}: no answer to the stop within {STOP_TIMEOUT_S:g} s; cut its power" for name in self.axes}

        def stop(axis: Axis) -> None:
            try:
                axis.stop()
            except Exception as error:
                faults[axis.name] = f"{error}; it may still move, cut its power"
            else:
                del faults[axis.name]

        threads = [threading.Thread(target=stop, args=(axis,), name=f"stop {axis.name}", daemon=True) for axis in self.axes.values()]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(STOP_TIMEOUT_S)
        if faults:
            raise DeviceError("\n".join(faults.values()))

    def close(self) -> None:
        """Let go of everything, in the reverse order of opening; may be called again."""
        self._resources.close()

    def axis_of(self, element: Moved) -> Axis | None:
        """The axis that moves an element or turns the array, None where nothing does."""
        found = self.described.description.axis_of(element)
        return None if found is None else self.axes[found[0]]

    def world(self, moved: Moved) -> float:
        """Where an element stands by its axis's reading, world z in mm, or how the array is turned, rad.

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
        """In which order axes can go to these readings from where they are, so that the minimum gap holds on the way.

        Raises:
            LimitError: a target is outside its axis's limits.
            InterlockError: there is no such order.
        """
        for name, target in targets.items():
            self.axes[name].check_value(target)
        return order_moves(self.gap_rule, {name: axis.reach() for name, axis in self.axes.items()}, targets)

    def least_gap(self) -> float | None:
        """The smallest gap possible now between array and sensor, mm, uncertainties counted; None where no axis moves either.

        Raises:
            CommunicationError: an axis does not answer.
        """
        return None if self.gap_rule is None else least_gap(self.gap_rule, self._reaches())

    def identities(self) -> list[Identity]:
        """What stands on the bench, one line a device; a device that fails says so in its line."""
        rows = [self._row(name, device, axis) for name, axis in self.axes.items() if (device := self.described.description.axes[name])]
        for name, instrument in (("camera", self.camera), ("iris", self.iris), ("target", self.target)):
            rows.append(self._row(name, getattr(self.described.description, name), instrument))
        return rows

    def _row(self, name: str, device: DeviceDescription, instrument: Any) -> Identity:
        position, state = None, ""
        try:
            identity = instrument.identity()
            if isinstance(instrument, Axis):
                position = instrument.position() if instrument.is_homed() else None
                state = "; ".join(("moving",) * instrument.is_moving() + instrument.warnings())
            elif isinstance(instrument, Setting):
                state = str(instrument.value())
        except FlflabError as error:
            identity, state = "does not answer", str(error)
        return Identity(name, device.driver, self._addresses[name], identity, position, state)

    def _guard(self, name: str, start: float | None, end: float | None) -> None:
        self._have_sentinel()
        rule = self.gap_rule
        if rule is not None and name in rule.movers and not retreats(rule, name, start, end):
            try:
                others = self._reaches(besides=name)
            except CommunicationError as error:
                raise DeviceError(f"{name}: asked to move, nothing moved, its neighbour does not answer: {error}") from error
            check_motion(rule, name, start, end, others)

    def _have_sentinel(self) -> None:
        """Before the first motion a sentinel begins to watch over the axes that could outlive this process."""
        with self._watching:
            if self._outliving and self._sentinel is None:
                self._sentinel = Sentinel(self.described.file, self._outliving)
                self._resources.callback(self._sentinel.close)

    def _reaches(self, besides: str = "") -> dict[str, tuple[float, float] | None]:
        """Between which readings the axes of the gap rule are until they rest."""
        movers = self.gap_rule.movers if self.gap_rule else {}
        return {name: self.axes[name].reach() for name in movers if name != besides}


def connect(bench_file: str | Path) -> ConnectedBench:
    """Connect to every device of a bench file; nothing moves.

    Raises:
        InputError: the bench file is wrong; every fault with file, line and field.
        DeviceError: another program drives the bench, or devices are missing or wrong: every fault in one message; nothing stays open.
    """
    described = read_bench(Path(bench_file))
    description = described.description
    with ExitStack() as resources:
        owner = Owner(described.file) if any(_can_outlive(axis) for axis in description.axes.values()) else None
        if owner is not None:
            resources.callback(owner.close)
        connection = _Connection(described, resources)
        axes: dict[str, Axis] = {}
        for name, axis in description.axes.items():
            if (device := connection.open(AXES, axis, "axes", name)) is not None:
                axes[name] = device
        camera = connection.open(CAMERAS, description.camera, "camera")
        iris = connection.open(IRISES, description.iris, "iris")
        target = connection.open(TARGETS, description.target, "target")
        connection.raise_faults()
        bench = ConnectedBench(described, axes, camera, iris, target, connection.addresses, resources.pop_all())
    if owner is not None:
        owner.stops_with(bench.stop)
    return bench


def _can_outlive(axis: AxisDescription) -> bool:
    """Whether an axis could go on moving after this process: what it simulates dies with it, a person knows to stop."""
    return axis.address != "simulated" and axis.driver != "manual"


class _Connection:
    """Opening one device after another: what was opened, at which addresses, and every fault so far."""

    def __init__(self, described: Bench, resources: ExitStack) -> None:
        self.addresses: dict[str, str] = {}
        self._described = described
        self._resources = resources
        self._shared: dict[str, Any] = {}
        self._faults: list[FlflabError] = []
        self._simulated: SimulatedBench | CommunicationError | None = None

    def open(self, drivers: Mapping[str, Any], device: Any, *path: str) -> Any:
        """Open one device of the bench file, None where that failed."""
        try:
            driver = drivers.get(device.driver)
            if driver is None:
                where = f"{self._described.file}:{self._described.lines.get((*path, 'driver'), 1)}: {'.'.join((*path, 'driver'))}"
                raise InputError(f"{where}: there is no driver {device.driver!r} here; there are {', '.join(drivers)}")
            if drivers is AXES and driver.counts not in (None, device.coordinate):
                raise InputError(
                    f"{path[-1]}: driver {device.driver} counts {driver.counts.dimension}s, but this axis moves {device.moves}; "
                    "give what it moves, or another driver"
                )
            keys = self._described.own_keys(driver.keys, *path)
            if device.address == "simulated":
                device = device.model_copy(update={"address": self._simulator().address(*path)})
            opened = self._open(drivers, driver, path[-1], device, keys)
            self._resources.callback(opened.close)
            self.addresses[path[-1]] = device.address
            return opened
        except FlflabError as fault:
            name = path[-1]
            self._faults.append(fault if name in str(fault) else type(fault)(f"{name}: {fault}"))
            return None

    def raise_faults(self) -> None:
        """Raise all faults as one error.

        Raises:
            InputError: only the bench file is wrong.
            CommunicationError: at least one device does not answer.
            DeviceError: the other cases.
        """
        if self._faults:
            kinds = {type(fault) for fault in self._faults}
            kind = InputError if kinds == {InputError} else CommunicationError if CommunicationError in kinds else DeviceError
            raise kind("\n".join(dict.fromkeys(str(fault) for fault in self._faults)))

    def _open(self, drivers: Mapping[str, Any], driver: Any, name: str, device: Any, keys: Any) -> Any:
        if drivers is AXES:
            commands = driver.open(name, device, keys, self._share)
            return Axis(name, commands, device.limits, device.speed, coordinate=device.coordinate, patience=driver.patience)
        opened = driver.open(device.address, keys, self._share)
        return Camera(name, opened) if drivers is CAMERAS else Setting[Any](name, opened, timeout=driver.timeout)

    def _share(self, address: str, opener: Callable[[], Opened], /) -> Opened:
        if address not in self._shared:
            self._shared[address] = opener()
            self._resources.callback(self._shared[address].close)
        return self._shared[address]

    def _simulator(self) -> SimulatedBench:
        """The child process, started for the first device that needs it and tried once only.

        Raises:
            CommunicationError: it does not start.
        """
        if self._simulated is None:
            try:
                self._simulated = SimulatedBench(self._described.file)
                self._resources.callback(self._simulated.close)
            except CommunicationError as fault:
                self._simulated = fault
        if isinstance(self._simulated, CommunicationError):
            raise self._simulated
        return self._simulated
