"""Instruments of a bench, each behind the same few promises.

``with drivers.connect("bench.yaml") as bench: bench.array_stage.move_to(12.5).wait()``
"""

from drivers.bench import ConnectedBench, connect

__all__ = ["ConnectedBench", "connect"]
