"""A motor behind a controller: where its carriage is, what its counter says, what it warns of. No
grammar here.
"""

import math
from collections.abc import Callable
from typing import Any, Literal, Protocol

from sim.clock import Clock
from sim.motion import Motion, move, rest, stop

Reference = Literal["none", "set", "homed"]


class Carriage(Protocol):
    """The carriage of one axis in the world: its motion in mm of travel, or in rad where it
    turns.
    """

    @property
    def clock(self) -> Clock:
        """The world's clock."""
        ...

    @property
    def motion(self) -> Motion:
        """How it moves."""
        ...

    @motion.setter
    def motion(self, motion: Motion) -> None: ...


class RefusedError(Exception):
    """A command the controller will not do; the reason is one of the controller's words."""


class Stage:
    """One axis: a counter of microsteps, which follows the carriage, and which is worth nothing
    before homing.

    A stage powers up without a reference: its counter starts at 0 wherever the carriage stands, so
    a move in good faith may run into the end of travel, where it stalls. Calls are not locked
    against each other: the chain does that.
    """

    def __init__(self, carriage: Carriage, travel: tuple[float, float], microstep: float,
    speed: float, acceleration: float,
                 home: float | None = None) -> None:  # fmt: skip
        """Power up.

        Args:
            carriage: the axis in the world.
            travel: ends of the carriage's travel, mm or rad.
            microstep: mm or rad of travel a microstep (or whatever the controller counts).
            speed: top speed at start-up, microsteps/s.
            acceleration: at start-up, microsteps/s^2.
            home: where on the travel the home sensor stands; by default at its lower end.
        """
        self._carriage, self._travel, self.microstep = carriage, travel, microstep
        self._start_up = (speed, acceleration)
        self._home = travel[0] if home is None else home
        self._obstacle: Callable[[], str] = str
        self._before_it = math.inf
        self.power_up()

    @property
    def preset(self) -> int:
        """What the counter says at the home sensor."""
        return round(self._home / self.microstep)

    def power_up(self) -> None:
        """Start-up settings, no reference; a carriage under way stops dead."""
        where = self._carriage.motion.at(self._now)[0]
        self._carriage.motion = rest(where)
        self.speed, self.acceleration = self._start_up
        self.lower, self.upper = (round(end / self.microstep) for end in self._travel)
        self.reference: Reference = "none"
        self.parked, self.enabled = False, True
        self.raised: set[str] = set()
        self._zero = round(where / self.microstep)
        self._homing = self._stopping = False
        self._flag_at_end = ""

    @property
    def _now(self) -> float:
        return self._carriage.clock.now()

    def position(self) -> int:
        """The counter, microsteps."""
        self._settle()
        return round(self._carriage.motion.at(self._now)[0] / self.microstep) - self._zero

    def velocity(self) -> float:
        """Microsteps/s."""
        return self._carriage.motion.at(self._now)[1] / self.microstep

    def busy(self) -> bool:
        """Whether it moves."""
        self._settle()
        return self._carriage.motion.moving(self._now)

    def homing(self) -> bool:
        """Whether it runs to its home sensor."""
        return self.busy() and self._homing

    def flags(self) -> set[str]:
        """Everything it warns of now: what was raised, and what lasts (no reference, not homed,
        driver disabled).
        """
        self._settle()
        lasting = {"none": {"WR"}, "set": {"WH"}, "homed": set[str]()}[self.reference]
        return self.raised | lasting | (set() if self.enabled else {"FO"})

    def home(self) -> None:
        """Run to the home sensor; the counter becomes true on arrival."""
        self._start(self._home, self.speed, self.acceleration)
        self._homing = True

    def move_to(
        self, target: int, speed: float | None = None, acceleration: float | None = None
    ) -> None:
        """Move the counter to ``target`` microsteps.

        Raises:
            RefusedError: the target is outside the limits (BADDATA), or the stage is parked or
                disabled.
        """
        if not self.lower <= target <= self.upper:
            raise RefusedError("BADDATA")
        self._start(
            (target + self._zero) * self.microstep,
            speed or self.speed,
            acceleration or self.acceleration,
        )

    def run(self, velocity: float, acceleration: float | None = None) -> None:
        """Run at a velocity in microsteps/s up to the limit it leads to; 0 slows down and stops."""
        if velocity == 0:
            self._start_allowed()
            self.stop()
        else:
            self.move_to(self.upper if velocity > 0 else self.lower, abs(velocity), acceleration)

    def stop(self) -> None:
        """Slow down and stop; a second stop while slowing down stops at once."""
        if self.busy():
            at_once = self._stopping
            self._interrupted()
            self._carriage.motion = stop(
                self._carriage.motion,
                self._now,
                math.inf if at_once else self._mm(self.acceleration),
            )
            self._stopping = not at_once

    def halt(self) -> None:
        """Stop at once."""
        if self.busy():
            self._interrupted()
            self._carriage.motion = rest(self._carriage.motion.at(self._now)[0])

    def set_position(self, counter: int) -> None:
        """Declare where it is.

        Raises:
            RefusedError: it moves (STATUSBUSY).
        """
        if self.busy():
            raise RefusedError("STATUSBUSY")
        self._zero = round(self._carriage.motion.at(self._now)[0] / self.microstep) - counter
        self.reference = "set"

    def memory(self) -> dict[str, Any]:
        """Where it stands (mm, rad), what it counts, and whether it has its reference."""
        return {
            "place": self._carriage.motion.at(self._now)[0],
            "counter": self.position(),
            "homed": self.reference == "homed",
        }

    def recall(self, place: float, counter: int, homed: bool) -> None:
        """Stand where it stood, as ``memory`` has it; on its travel at least."""
        place = min(max(place, self._travel[0]), self._travel[1])
        self._carriage.motion = rest(place)
        self._zero = round(place / self.microstep) - counter
        self.reference = "homed" if homed else "none"

    def obstruct(self, obstacle: Callable[[], str], after_travel: float) -> None:
        """What may stand in the way of motions.

        Args:
            obstacle: asked when a longer motion starts; the flag it will end with, FS stalled or WL
                on a limit switch; empty for none.
            after_travel: how far it then gets, mm or rad.
        """
        self._obstacle, self._before_it = obstacle, after_travel

    def _start_allowed(self) -> None:
        if self.parked:
            raise RefusedError("PARKED")
        if not self.enabled:
            raise RefusedError("DRIVERDISABLED")

    def _start(self, target: float, speed: float, acceleration: float) -> None:
        self._start_allowed()
        if self.busy():
            self._interrupted()
        now, here = self._now, self._carriage.motion.at(self._now)[0]
        reachable = min(max(target, self._travel[0]), self._travel[1])
        # A target that rounds to the end of travel is on it, not beyond it.
        self._flag_at_end = "FS" if abs(target - reachable) > self.microstep else ""
        if abs(reachable - here) > self._before_it and (flag := self._obstacle()):
            reachable, self._flag_at_end = (
                here + math.copysign(self._before_it, reachable - here),
                flag,
            )
        self._carriage.motion = move(
            self._carriage.motion, now, reachable, speed * self.microstep, self._mm(acceleration)
        )
        self._stopping = False

    def _mm(self, acceleration: float) -> float:
        return acceleration * self.microstep if acceleration else math.inf

    def _interrupted(self) -> None:
        self.raised.add("NI")
        self._homing, self._flag_at_end = False, ""

    def _settle(self) -> None:
        """Draw the consequences of a motion that has ended since."""
        if self._carriage.motion.moving(self._now):
            return
        if self._flag_at_end:
            self.raised.add(self._flag_at_end)
            self.reference = "none" if self._flag_at_end == "FS" or self._homing else self.reference
        elif self._homing:
            self._zero, self.reference = 0, "homed"
            self._carriage.motion = rest(self._home)
        self._homing = self._stopping = False
        self._flag_at_end = ""
