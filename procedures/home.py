"""Home every axis: array and sensor away from each other first, the others then; nothing else moves
meanwhile.
"""

from collections.abc import Generator, Mapping
from typing import Any

from bluesky import Msg
from bluesky import plan_stubs as bps

from drivers.base import Axis
from procedures.devices import Triggered
from procedures.steps import Home


def home(axes: Mapping[str, Axis], step: Home) -> Generator[Msg, Any, None]:
    """Home the axes of one step, all at once, and wait for all."""
    for name in step.axes:
        yield from bps.trigger(Triggered(f"{name} reference", axes[name].home), group="home")
    yield from bps.wait("home")
