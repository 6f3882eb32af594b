"""Home every axis: array and sensor away from each other first, the others then; nothing else moves meanwhile."""

from collections.abc import Generator, Mapping
from typing import Any

from bluesky import Msg
from bluesky import plan_stubs as bps

from drivers.base import Axis, Status
from procedures.steps import Home


class Reference:
    """An axis's reference as something to trigger."""

    parent = None

    def __init__(self, axis: Axis) -> None:
        self.name = f"{axis.name} reference"
        self._axis = axis

    def trigger(self) -> Status:
        """Look for the reference."""
        return self._axis.home()


def home(axes: Mapping[str, Axis], step: Home) -> Generator[Msg, Any, None]:
    """Home the axes of one step, all at once, and wait for all."""
    for name in step.axes:
        yield from bps.trigger(Reference(axes[name]), group="home")
    yield from bps.wait("home")
