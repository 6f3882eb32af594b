"""Instruments of a bench, each behind the same few promises.

``with drivers.connect("bench.yaml") as bench: bench.array_stage.move_to(12.5).wait()``
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.bench import ConnectedBench, connect

__all__ = ["ConnectedBench", "connect"]


def __getattr__(name: str) -> Any:
    """Loaded when it is asked for: a stop waits for nothing that it does not need."""
    if name not in __all__:
        raise AttributeError(f"module 'drivers' has no attribute {name!r}")
    return getattr(import_module("drivers.bench"), name)
