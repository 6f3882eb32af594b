"""What a simulated bench remembers from one program to the next: where everything stands, and which
axes have their reference. Whatever else it was told is forgotten, as after a loss of power.
"""

import contextlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flflab.errors import InputError
from flflab.whole_file import write_whole
from sim.motion import rest
from sim.registry import Remembers
from sim.world import WHEEL, World


def remember(world: World, stages: Mapping[str, Remembers], file: Path) -> None:
    """Write where everything stands; nothing is written where the disk refuses."""
    with world.lock:
        now = world.clock.now()
        stands: dict[str, Any] = {
            "axes": {name: stage.memory() for name, stage in stages.items()},
            "iris": world.iris.at(now),
            "wheel": world.wheel.at(now),
        }
    with contextlib.suppress(InputError):
        write_whole(file, json.dumps(stands))


def recall(world: World, stages: Mapping[str, Remembers], file: Path) -> None:
    """Have everything stand where it stood; a file that is missing or spoilt changes nothing."""
    try:
        stood = json.loads(file.read_text(encoding="utf-8"))
        axes = {
            name: (float(axis["place"]), int(axis["counter"]), axis["homed"] is True)
            for name, axis in stood["axes"].items()
        }
        iris, wheel = float(stood["iris"]), round(float(stood["wheel"]))
    except (OSError, ValueError, TypeError, KeyError, AttributeError, OverflowError):
        return
    if not math.isfinite(sum(place for place, _, _ in axes.values()) + iris):
        return
    with world.lock:
        for name in set(axes) & set(stages):
            stages[name].recall(*axes[name])
        world.iris.motion = rest(iris)
        world.wheel.motion = rest(wheel % len(WHEEL))
