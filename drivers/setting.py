"""One setting of the bench (the f-number of the iris, the target in place): allowed values, one
thread that sees a change to its end.
"""

import contextlib
import math
import threading
import time
from numbers import Real
from typing import Any, Generic

from drivers.commands import SettingCommands, Value
from drivers.status import Status
from flflab.errors import DeviceError, LimitError, MotionError

POLL_S = 0.02


class Setting(Generic[Value]):
    """A setting; satisfies bluesky's Movable, Readable, Locatable, Stoppable, Checkable and
    HasHints.

    Args:
        name: the name on the bench: ``iris``, ``target``.
        commands: what turns it.
        timeout: how long a change may take, s; infinite where a person does it.
        closeness: by which share a number may end away from the one asked for.
    """

    parent = None

    def __init__(
        self,
        name: str,
        commands: SettingCommands[Value],
        *,
        timeout: float = 60.0,
        closeness: float = 0.005,
    ) -> None:
        self.name = name
        self._commands = commands
        self._timeout = timeout
        self._closeness = closeness
        self._change: Status | None = None
        self._asked: Value | None = None
        self._watcher: threading.Thread | None = None
        self._stopped: bool | None = None
        self._starting = threading.Lock()

    @property
    def allowed(self) -> tuple[Value, ...]:
        """Every name allowed, or the least and the largest number."""
        return self._commands.allowed

    def check_value(self, value: Value) -> None:
        """Refuse a value that is not allowed, without changing anything.

        Raises:
            LimitError: it is not allowed.
        """
        allowed = self.allowed
        if isinstance(allowed[0], str):
            if value not in allowed:
                raise LimitError(
                    f"{self.name}: there is no {value!r} here; allowed are"
                    f" {', '.join(map(str, allowed))}"
                )
        elif (
            not isinstance(value, Real)
            or not math.isfinite(value)
            or not allowed[0] <= value <= allowed[1]
        ):
            raise LimitError(
                f"{self.name}: asked for {value!r}; allowed is a number from {allowed[0]:g} to"
                f" {allowed[1]:g}"
            )

    def set(self, value: Value) -> Status:
        """Start to change the setting.

        Raises:
            LimitError: the value is not allowed.
            DeviceError: a change is under way, or it is refused.
        """
        self.check_value(value)
        with self._starting:
            if self._change is not None and not self._change.done:
                raise DeviceError(
                    f"{self.name}: asked for {value} while it changes to {self._asked}; wait for it"
                    " or stop it first"
                )
            change = Status(f"{self.name}: set to {value}")
            self._stopped = None
            self._commands.start(value)
            self._change, self._asked = change, value
            self._watcher = threading.Thread(
                target=self._watch, args=(change, value), name=f"watch {self.name}", daemon=True
            )
            self._watcher.start()
        return change

    def value(self) -> Value:
        """What it is now.

        Raises:
            DeviceError: nobody knows.
        """
        return self._commands.value()

    def stop(self, success: bool = False) -> None:
        """Give up a change under way.

        Args:
            success: whether that is as planned (a pause); the change then ends well, else with
                MotionError.
        """
        if self._change is not None and not self._change.done:
            self._stopped = success
            self._commands.stop()

    def identity(self) -> str:
        """Maker, model, serial number and firmware as far as the device tells."""
        return self._commands.identity()

    def close(self) -> None:
        """Give up a change under way, end its thread and let go of the device."""
        with contextlib.suppress(DeviceError):
            self.stop()
        if self._watcher is not None:
            self._watcher.join()
        self._commands.close()

    def read(self) -> dict[str, Any]:
        """The present value.

        Raises:
            MotionError: it is another than it was set to.
        """
        value = self.value()
        settled = self._change is not None and self._change.success
        if settled and self._asked is not None and not self._equal(value, self._asked):
            raise MotionError(
                f"{self.name}: set to {self._asked}, it now is {value}; see what changed it and"
                " go on"
            )
        return {self.name: {"value": value, "timestamp": time.time()}}

    def describe(self) -> dict[str, Any]:
        """What ``read`` returns."""
        kind = "string" if isinstance(self.allowed[0], str) else "number"
        return {self.name: {"source": f"setting {self.name}", "dtype": kind, "shape": []}}

    @property
    def hints(self) -> dict[str, Any]:
        """The value is what plots and tables show."""
        return {"fields": [self.name]}

    def locate(self) -> dict[str, Value]:
        """What was asked for and what is."""
        readback = self.value()
        return {"setpoint": readback if self._asked is None else self._asked, "readback": readback}

    def _watch(self, change: Status, value: Value) -> None:
        try:
            change.complete(self._follow(change, value))
        except Exception as error:
            change.complete(error)

    def _follow(self, change: Status, value: Value) -> MotionError | None:
        deadline = time.monotonic() + self._timeout
        while self._commands.is_busy():
            if self._stopped is not None:
                break
            if time.monotonic() > deadline:
                raise MotionError(
                    f"{change.task}: not there after {self._timeout:g} s; look what holds it"
                )
            time.sleep(POLL_S)
        if self._stopped is not None:
            return (
                None
                if self._stopped
                else MotionError(f"{change.task}: given up on the way, as commanded")
            )
        reached = self._commands.value()
        if self._equal(reached, value):
            return None
        fault = self._commands.fault()
        return MotionError(
            f"{change.task}: ended at {reached or 'no known value'}"
            f" instead{fault and f' ({fault})'}; look what holds it"
        )

    def _equal(self, reached: Value, value: Value) -> bool:
        """Whether what it is is what was asked for."""
        if isinstance(value, str) or isinstance(reached, str):
            return reached == value
        return math.isclose(reached, value, rel_tol=self._closeness)
