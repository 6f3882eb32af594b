"""The simulated iris and target wheel: slow settings that change the world."""

import math
import threading
from collections.abc import Mapping, Sequence

from sim.faults import JAM, Faults
from sim.motion import move, rest
from sim.scpi import Handler, limits_or, name_among, no_parameters, number_within
from sim.world import WHEEL, Carriage, World


class Drive:
    """A motor that takes one coordinate of the world to a place at constant speed, and may jam."""

    def __init__(self, carriage: Carriage, speed: float, name: str, faults: Faults) -> None:
        """Stand where the world has it."""
        self._carriage, self._speed, self._name = carriage, speed, name
        self._missed: float | None = None
        self.faults = faults
        self._failures: list[str] = []

    @property
    def failures(self) -> list[str]:
        """Sentences for every motion that ended without arriving."""
        if self._missed is not None and not self.moving():
            self._failures.append(
                f"{self._name} stalled at {self.place():g} on the way to {self._missed:g}"
            )
            self._missed = None
        return self._failures

    def go(self, place: float) -> None:
        """Leave for a place."""
        now, here = self._carriage.clock.now(), self.place()
        stuck = abs(place - here) > JAM and self.faults.obstacle() != ""
        self._missed = place if stuck else None
        end = here + math.copysign(JAM, place - here) if stuck else place
        self._carriage.motion = move(self._carriage.motion, now, end, self._speed, math.inf)

    def place(self) -> float:
        """Where it is."""
        return self._carriage.at(self._carriage.clock.now())

    def moving(self) -> bool:
        """Whether it is on its way."""
        return self._carriage.moving(self._carriage.clock.now())

    def idle_at(self) -> float:
        """When it arrives."""
        return self._carriage.motion.end

    def reset(self) -> None:
        """``*RST`` moves nothing."""

    def power_up(self) -> None:
        """Stop where it is."""
        self._carriage.motion = rest(self.place())


class Iris(Drive):
    """A motorised iris."""

    LIMITS = (1.0, 32.0)
    SPEED = 8.0  # f-numbers a second

    def __init__(self, world: World, faults: Faults) -> None:
        """The world's iris."""
        super().__init__(world.iris, self.SPEED, "iris", faults)
        self._lock = world.lock

    @property
    def commands(self) -> Mapping[str, Handler]:
        """See docs/scpi-camera.md."""
        return {"LENS:FNUMber": self._set, "LENS:FNUMber?": self._read, "LENS:BUSY?": self._busy}

    def _set(self, parameters: Sequence[str], ended: threading.Event) -> str:
        with self._lock:
            self.go(number_within(parameters, "LENS:FNUM", *self.LIMITS))
        return ""

    def _read(self, parameters: Sequence[str], ended: threading.Event) -> str:
        return limits_or(parameters, self.place(), *self.LIMITS)

    def _busy(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        return str(int(self.moving()))


class Wheel(Drive):
    """A wheel of targets."""

    SPEED = 2.0  # places a second

    def __init__(self, world: World, faults: Faults) -> None:
        """The world's wheel."""
        super().__init__(world.wheel, self.SPEED, "target wheel", faults)
        self._world = world

    @property
    def commands(self) -> Mapping[str, Handler]:
        """See docs/scpi-camera.md."""
        return {
            "TARGet:CATalog?": self._catalogue, "TARGet:KIND": self._set,
            "TARGet:KIND?": self._read, "TARGet:BUSY?": self._busy,
        }  # fmt: skip

    def _catalogue(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        return ",".join(f'"{name}"' for name in WHEEL)

    def _set(self, parameters: Sequence[str], ended: threading.Event) -> str:
        with self._world.lock:
            self.go(WHEEL.index(name_among(parameters, "TARG:KIND", WHEEL)))
        return ""

    def _read(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        name = "" if self.moving() else self._world.target_name(self._world.clock.now())
        return f'"{name}"'

    def _busy(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        return str(int(self.moving()))
