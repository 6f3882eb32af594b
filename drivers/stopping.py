"""Every axis of a bench stopped from outside, whatever else goes wrong: who drives it is asked, and
its lines are opened, all at the same time.
"""

import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from drivers import locks
from drivers.owner import ask_owners_to_stop
from drivers.places import spelt
from drivers.registry import AXES
from flflab.bench import AxisDescription
from flflab.description import read_yaml
from flflab.errors import CommunicationError, DeviceError, InputError

PATIENCE_S = 5.0
REST_S = 4.0  # for braking, and for answers that whoever drives the axis takes from the line
LOOK_S = 0.005


class Stopped(NamedTuple):
    """What became of a stop.

    Args:
        faults: a sentence for each axis that does not read at rest.
        remarks: what else an operator should know.
    """

    faults: list[str]
    remarks: list[str]


def stop_bench(bench_file: Path) -> Stopped:
    """Stop every axis of a bench file and wait until each reads at rest.

    What stands in the file besides the axes' drivers, addresses and numbers need not be right. An
    axis whose line cannot be opened counts as at rest where its owner, a program of this user's,
    says so.

    Raises:
        InputError: the file cannot be read, and nobody who drives a bench began with it.
    """
    answers: dict[str, str | None] = {}
    unreadable: list[InputError] = []

    def ask() -> None:
        try:
            answers.update(ask_owners_to_stop(bench_file))
        except InputError as error:
            unreadable.append(error)

    asking = threading.Thread(target=ask, name="ask owners", daemon=True)
    asking.start()
    try:
        axes = axes_to_stop(bench_file)
    except InputError:
        axes = {}  # ``ask`` meets the same and says whether an owner knew more
    missed = stop_axes(axes)
    asking.join()
    if unreadable:
        raise unreadable[0]
    faults = [
        "\n".join(filter(None, (fault, answers.get(name))))
        for name, fault in missed.items()
        if answers.get(name) != ""
    ]
    # what an owner drives that this file does not name: only he can tell
    unknown = [answer for name, answer in answers.items() if answer and name not in axes]
    if axes and not missed:
        remarks = list(dict.fromkeys(answer for answer in answers.values() if answer))
        return Stopped([], remarks + ["past it every axis was stopped"] * bool(remarks))
    return Stopped(list(dict.fromkeys(faults + unknown)), [])


def axes_to_stop(bench_file: Path) -> dict[str, AxisDescription]:
    """The axes of a bench file that another program could reach, each as far as it can be read.

    Raises:
        InputError: the file is no YAML of fields.
    """
    data, _ = read_yaml(bench_file)
    found: dict[str, AxisDescription] = {}
    axes = {str(name): axis for name, axis in (data.get("axes") or {}).items()}
    for name, (driver, address) in locks.reached(data).items():
        try:
            found[name] = AxisDescription.model_validate(axes[name])
        except ValidationError:
            known: dict[str, Any] = {str(key): value for key, value in axes[name].items()}
            known |= {"driver": driver, "address": address}
            found[name] = AxisDescription.model_construct(**known)
    return found


def stop_axes(axes: Mapping[str, AxisDescription]) -> dict[str, str]:
    """Stop axes beside whoever drives them, all at once, and wait until each reads at rest; none is
    opened first, since what it refuses must not stand in the way of a stop.

    Args:
        axes: by name, each with the address where it really is.

    Returns:
        A sentence for each axis that does not read at rest.
    """
    faults = {
        name: f"{name}: no answer to the stop; {axis.cut_its_power}" for name, axis in axes.items()
    }
    lines: dict[str, _Line] = {}
    threads: list[threading.Thread] = []
    for name, axis in axes.items():
        place = spelt(axis.driver, axis.address)
        line = lines.setdefault(place, _Line())

        def stop(name: str = name, axis: AxisDescription = axis, line: _Line = line) -> None:
            try:
                _stop_axis(name, axis, line)
            except Exception as error:  # whatever it is, who asked is to hear of every axis
                why = str(error) if name in str(error) else f"{name}: {error}"
                faults[name] = f"{why}; {axis.cut_its_power}"
            else:
                del faults[name]

        threads.append(threading.Thread(target=stop, name=f"stop {name}", daemon=True))
    for thread in threads:
        thread.start()
    deadline = time.monotonic() + PATIENCE_S
    for thread in threads:
        thread.join(max(0.0, deadline - time.monotonic()))
    for line in lines.values():
        line.close()
    return dict(faults)


class _Line:
    """One line, opened once by whichever of its axes comes first."""

    def __init__(self) -> None:
        self._opening = threading.Lock()
        self._opened: Any = None
        self._over = False

    def share(self, address: str, opener: Callable[[], Any], /) -> Any:
        """What the line was opened as."""
        with self._opening:
            if self._opened is None:
                self._opened = opener()
            if self._over:  # meanwhile: nobody else would close what was just opened
                self._opened.close()
            return self._opened

    @property
    def is_open(self) -> bool:
        """Whether it was opened."""
        return self._opened is not None

    def close(self) -> None:
        """Let go of it; one that still waits to be opened is closed as soon as it is open."""
        self._over = True
        if self._opened is not None:
            self._opened.close()


def _stop_axis(name: str, axis: AxisDescription, line: _Line) -> None:
    """Stop one axis and wait until it rests.

    Raises:
        DeviceError: it does not read at rest in time, or cannot be reached.
    """
    driver = AXES.get(axis.driver)
    if driver is None:
        raise InputError(f"there is no driver {axis.driver!r} here; there are {', '.join(AXES)}")
    own = dict(axis.model_extra or {})
    try:
        keys = driver.keys.model_validate(own)
    except ValidationError:
        keys = driver.keys.model_construct(**own)
    deadline, moves = time.monotonic() + REST_S, None
    while True:
        try:
            moves = moves or driver.stop(name, axis, keys, line.share)
            if not moves():
                return
        except CommunicationError:
            # its owner may have taken the answer; a line that could not be opened stays so
            if not line.is_open or time.monotonic() > deadline:
                raise
            moves = None
        if time.monotonic() > deadline:
            raise DeviceError(f"{name}: still moves {REST_S:g} s after the stop")
        time.sleep(LOOK_S)
