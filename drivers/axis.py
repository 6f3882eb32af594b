# longer than 450 lines because every promise of an axis stands in one place
"""One axis, linear or rotary, of any vendor: limits, reference and guard before motion, one thread
that sees each motion to its end.
"""

import contextlib
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from typing import Any

from drivers.commands import FOLLOWING, AxisCommands, at_the_other_end
from drivers.lost import Trust
from drivers.status import Status
from flflab.bench import LENGTH, Coordinate
from flflab.errors import (
    CommunicationError,
    DeviceError,
    FlflabError,
    LimitError,
    MotionError,
    NotHomedError,
)

POLL_S = 0.02
REACTION_S = 0.25  # from a guard's look at the neighbours until the motion shows at the device
CLOSE_S = 0.003  # between looks when it is about to arrive
LEAST_PROGRESS = 1e-4  # mm or rad


@dataclass(frozen=True)
class Clearance:
    """What a motion towards a neighbour relies on, which another computer may drive.

    Args:
        check: raises InterlockError where a neighbour does not stand where it stood.
        halt: the reading to rest at and look again before the motion goes on; None where it may go
            on to its end.
    """

    check: Callable[[], None]
    halt: float | None = None


Guard = Callable[[str, float | None, float | None], Clearance | None]


def unguarded(name: str, start: float | None, end: float | None) -> None:
    """The guard of an axis that can meet nothing."""


@dataclass
class Motion:
    """A motion under way: from, to (None: not known, looking for the reference), how many stops
    came before it, what it relies on, and how it is to end if it is stopped.
    """

    start: float | None
    end: float | None
    status: Status
    stops: int = 0
    clearance: Clearance | None = None
    sent: bool = False
    stopped: bool = False
    stopped_as_planned: bool = False


class Axis:
    """An axis in mm, or in rad; satisfies bluesky's Movable, Readable, Locatable, Stoppable,
    Checkable, Configurable and HasHints.

    Nothing moves on connect. A refused motion sends nothing that moves.

    Args:
        name: the name in the bench file.
        commands: the vendor's commands.
        limits: soft limits, readings; the device's own travel is checked beside them.
        speed: mm/s or rad/s, told to readers; the vendor's file sets it.
        guard: called as ``guard(name, start, end)`` before motion, readings; raises InterlockError
            to refuse, and returns what has to hold on the way. ``end`` is None when the axis looks
            for its reference, ``start`` is None when its position is not known.
        coordinate: whether it counts lengths or angles.
        patience: how long the axis may stay busy without coming nearer to its end, s.
        homes_up: whether its reference lies at the high end of its travel; None where that is not
            known.
        trust: whether its counter can be trusted.
    """

    parent = None

    def __init__(
        self,
        name: str,
        commands: AxisCommands,
        limits: tuple[float, float],
        speed: float,
        guard: Guard = unguarded,
        *,
        coordinate: Coordinate = LENGTH,
        patience: float = 3.0,
        homes_up: bool | None = None,
        trust: Trust | None = None,
    ) -> None:
        self.name = name
        self.limits = limits
        self.speed = speed
        self.guard = guard
        self.coordinate = coordinate
        self.interrupted: Callable[[], bool] = lambda: False
        self._commands = commands
        self._trust = trust or Trust()
        self._patience = patience
        self._homes_up = homes_up
        self._starting = threading.Lock()
        self._motion: Motion | None = None
        self._watcher: threading.Thread | None = None
        self._stops = self._motions = 0
        self._closed = False

    def __repr__(self) -> str:
        low, high = (self.coordinate.show(limit, "g") for limit in self.limits)
        return f"<axis {self.name}, {low} to {high}>"

    # Motion

    def home(self) -> Status:
        """Look for the reference.

        Raises:
            InterlockError: it could come too near to a neighbour.
            DeviceError: it moves already, or refuses.
        """
        return self._begin(None)

    def move_to(self, position: float) -> Status:
        """Move to a reading, mm or rad.

        Raises:
            LimitError: outside the soft limits or the device's own, or not a finite number.
            NotHomedError: it has no reference.
            InterlockError: it could come too near to a neighbour.
            DeviceError: it moves already, or refuses.
        """
        self.check_value(position)
        return self._begin(float(position))

    def move_by(self, distance: float) -> Status:
        """Move by a distance, mm or rad, from the present reading; errors as ``move_to``."""
        return self.move_to(self.position() + distance)

    set = move_to

    def stop(self, success: bool = False) -> None:
        """Stop now, from any thread, whatever else goes on.

        Args:
            success: whether this stop is as planned (a pause); the motion under way then ends well,
                else with MotionError.

        Raises:
            CommunicationError: the device did not take the command; cut its power.
        """
        self._stops += 1
        motion = self._motion
        if motion is not None:
            motion.stopped_as_planned = success and not motion.stopped
            motion.stopped = True
        self._commands.stop()

    def check_value(self, value: float) -> None:
        """Refuse a position outside the limits without moving.

        Raises:
            LimitError: outside the soft limits or the device's own, or not a finite number.
        """
        if not isinstance(value, Real) or not math.isfinite(value):
            raise LimitError(
                f"{self.name}: {value!r} is not a position; give a finite number of"
                f" {self.coordinate.unit}"
            )
        for (low, high), whose in (
            (self.limits, "its soft limits"),
            (self._commands.travel, "the device's own limits"),
        ):
            if not low <= value <= high:
                least, most = (self.coordinate.show(limit, ".9g") for limit in (low, high))
                raise LimitError(
                    f"{self.name}: asked to go to {self.coordinate.show(float(value))}, outside"
                    f" {whose}, {least} to {most}; nothing moved, ask for a position inside"
                )

    # State

    def position(self) -> float:
        """The reading, mm or rad.

        Raises:
            NotHomedError: it has no reference, so its counter means nothing.
            CommunicationError: it does not answer.
        """
        reading = self._commands.reading()
        if reading is None or self._trust.lost:
            raise NotHomedError(f"{self.name}: asked where it is, but {self._no_reference}")
        return reading

    def count(self) -> float:
        """What the device counts, reference or not."""
        return self._commands.position()

    @property
    def _no_reference(self) -> str:
        return (
            "a motion of it failed and its counter may have lost steps; home it first"
            if self._trust.lost
            else "it has no reference; home it first"
        )

    def _reading(self) -> float | None:
        """Where it stands, None where nobody knows."""
        return None if self._trust.lost else self._commands.reading()

    def is_homed(self) -> bool:
        """Whether the reading means anything."""
        return not self._trust.lost and self._commands.is_homed()

    def is_moving(self) -> bool:
        """Whether a motion of ours is under way, or the device moves for another reason."""
        return self._present_motion() is not None or self._commands.is_busy()

    @property
    def motions(self) -> int:
        """How many motions were begun here."""
        return self._motions

    def is_under_way(self) -> bool:
        """Whether a motion that was begun here is under way, or failed and was not seen to rest;
        nothing is asked.
        """
        return self._motion is not None

    def _present_motion(self) -> Motion | None:
        """The motion under way; one that failed counts until the device says it rests."""
        motion = self._motion
        if motion is not None and motion.status.done and not self._commands.is_busy():
            self._motion = None
        return self._motion

    def reach(self) -> tuple[float, float] | None:
        """Between which readings the axis is now and will be until it rests; None where that is not
        known.

        Raises:
            CommunicationError: the device does not answer.
        """
        motion = self._present_motion()
        if self._trust.lost:
            return None
        if motion is not None:
            return (
                None
                if motion.start is None or motion.end is None
                else (min(motion.start, motion.end), max(motion.start, motion.end))
            )
        before = self._reading()
        if self._commands.is_busy():
            return None
        reading = self._reading()  # the same again: it did not move in between
        still = FOLLOWING[self.coordinate.unit]
        if before is None or reading is None or abs(reading - before) > still:
            return None
        return reading, reading

    def identity(self) -> str:
        """Maker, model, serial number and firmware as far as the device tells."""
        return self._commands.identity()

    def serial(self) -> str:
        """What no other axis of its maker answers: serial number, and which axis of its instrument;
        empty where it tells none.
        """
        return self._commands.serial()

    def warnings(self) -> tuple[str, ...]:
        """Everything the device wants to be known, one phrase each."""
        return self._commands.warnings()

    @property
    def resolution(self) -> float:
        """How near to where it is sent it comes to rest, mm or rad."""
        return self._commands.resolution

    @property
    def travel(self) -> tuple[float, float]:
        """The device's own limits, readings."""
        return self._commands.travel

    def close(self) -> None:
        """Stop a motion under way, end its thread and let go of the device."""
        self._closed = True
        watcher, motion = self._watcher, self._motion
        if motion is not None and not motion.status.done:
            try:
                self.stop()
            except DeviceError as error:
                motion.status.complete(error)
        if watcher is not None and watcher is not threading.current_thread():
            watcher.join()
        self._commands.close()

    # bluesky

    def read(self) -> dict[str, Any]:
        """The reading, mm or rad: ``describe`` says which."""
        return {self.name: {"value": self.position(), "timestamp": time.time()}}

    def describe(self) -> dict[str, Any]:
        """What ``read`` returns."""
        return {self.name: self._describe_number(self.coordinate.unit)}

    def read_configuration(self) -> dict[str, Any]:
        """Speed in mm/s or rad/s."""
        return {self._speed_column: {"value": self.speed, "timestamp": time.time()}}

    def describe_configuration(self) -> dict[str, Any]:
        """What ``read_configuration`` returns."""
        return {self._speed_column: self._describe_number(f"{self.coordinate.unit}/s")}

    @property
    def _speed_column(self) -> str:
        return f"{self.name}_speed_{self.coordinate.unit}_per_s"

    def _describe_number(self, units: str) -> dict[str, Any]:
        return {"source": f"axis {self.name}", "dtype": "number", "shape": [], "units": units}

    @property
    def hints(self) -> dict[str, Any]:
        """The reading is what plots and tables show, by the axis's name."""
        return {"fields": [self.name]}

    def locate(self) -> dict[str, float]:
        """Where it was asked to go and where it is."""
        readback = self.position()
        motion = self._motion
        return {
            "setpoint": readback if motion is None or motion.end is None else motion.end,
            "readback": readback,
        }

    # How a motion starts and ends

    def _begin(self, end: float | None) -> Status:
        task = f"{self.name}: " + (
            "look for its reference" if end is None else f"move to {self.coordinate.show(end)}"
        )
        with self._starting:
            stops = self._stops
            if self._closed:
                raise DeviceError(
                    f"{self.name}: asked to move after the bench was closed; connect again"
                )
            if self.is_moving():
                raise DeviceError(
                    f"{self.name}: asked to move while it moves; wait for it or stop it first"
                )
            start = self._reading()
            if end is not None and start is None:
                raise NotHomedError(
                    f"{self.name}: asked to go to {self.coordinate.show(end)}, but"
                    f" {self._no_reference}, nothing moved"
                )
            motion = Motion(start, end, Status(task), stops)
            # Seen by the neighbours' guards before our own guard looks at them: of two that start
            # at once, one sees the other.
            self._motion = motion
            looked = time.monotonic()
            try:
                motion.clearance = self.guard(self.name, motion.start, end)
                halt = motion.clearance.halt if motion.clearance else None
                self._start(motion, end if halt is None else halt)
                if motion.clearance and time.monotonic() - looked > REACTION_S:
                    motion.clearance.check()
            except BaseException as fault:
                refused = isinstance(fault, FlflabError) and not isinstance(
                    fault, CommunicationError
                )
                if refused and not motion.sent:
                    self._motion = None
                else:  # the command may have arrived: never repeated, and stopped
                    self._stop_quietly()
                    motion.status.complete()
                raise
            self._watcher = threading.Thread(
                target=self._watch, args=(motion,), name=f"watch {self.name}", daemon=True
            )
            self._watcher.start()
        return motion.status

    def _watch(self, motion: Motion) -> None:
        """See a motion to its end."""
        try:
            error = self._see_through(motion)
        except Exception as fault:
            # Nobody knows what it does: stopped if it still listens, and held for moving until it
            # says it rests.
            self._stop_quietly()
            if isinstance(fault, MotionError):
                self._lose_place()
            if isinstance(fault, FlflabError) and self.interrupted():
                fault = MotionError(  # two programs on one line garble each other's replies
                    f"{motion.status.task}: another program had this bench stopped; {fault}"
                )
            motion.status.complete(fault)
            return
        if error is None:
            if motion.end is None and not motion.stopped:
                self._trust.find()
        elif not motion.stopped:  # whatever ended it, it may go on
            self._stop_quietly()
            self._lose_place()
        self._motion = None
        motion.status.complete(error)

    def _start(self, motion: Motion, end: float | None) -> None:
        """Have the device start; stopped again where a stop came while it was sent."""
        self._motions += 1
        if end is None:
            self._commands.start_home()
        else:
            self._commands.start_move(end)
        motion.sent = True
        if self._stops != motion.stops:
            motion.stopped = True
            self._commands.stop()

    def _see_through(self, motion: Motion) -> MotionError | None:
        """See a motion to its end, over the halt where its neighbours are looked at again; what to
        say of it.
        """
        halt = motion.clearance.halt if motion.clearance else None
        if motion.clearance and halt is not None:
            begun = time.monotonic()
            self._until_idle(motion, halt)
            error = self._judge(motion, halt)
            while not motion.stopped and time.monotonic() < begun + REACTION_S:
                time.sleep(CLOSE_S)
            if error or motion.stopped:
                return error or self._judge(motion, halt)
            motion.clearance.check()
            self._start(motion, motion.end)
        self._until_idle(motion, motion.end)
        return self._judge(motion, motion.end)

    def _lose_place(self) -> None:
        """After a motion that failed a counter of steps says nothing any more; one that measures
        does.
        """
        if not self._commands.measured:
            self._trust.lose()

    def _until_idle(self, motion: Motion, end: float | None) -> None:
        nearest, began = math.inf, time.monotonic()
        whole = self.travel[1] - self.travel[0]
        longest_search = self._patience * (
            10
            + 10 * (min(whole, math.tau) if self.coordinate.unit == "rad" else whole) / self.speed
        )
        moved, last, look, wait = began, None, began, POLL_S
        while self._commands.is_busy():
            if time.monotonic() < look:  # about to arrive: only whether it still moves
                time.sleep(wait)
                continue
            if motion.clearance:
                motion.clearance.check()
            look, position = time.monotonic() + 0.8 * POLL_S, self._commands.position()
            if end is None or motion.stopped:
                progress = last is None or abs(position - last) >= LEAST_PROGRESS
            else:
                progress = abs(position - end) <= nearest - LEAST_PROGRESS
            if progress:
                moved, last, nearest = (
                    time.monotonic(),
                    position,
                    abs(position - (end or 0.0)),
                )
            if end is None and time.monotonic() - began > longest_search:
                raise MotionError(
                    f"{motion.status.task}: still moving long after a whole travel; stopped, look"
                    " at its home sensor"
                )
            if time.monotonic() - moved > self._patience:
                where = (
                    f"at {self.coordinate.show(position)}"
                    if motion.start is not None
                    else "before it found its reference"
                )
                raise MotionError(
                    f"{motion.status.task}: no progress for {self._patience:g} s, {where}; stopped,"
                    " look what holds it"
                )
            left = POLL_S if end is None else abs(position - end) / self.speed / 2
            wait = min(max(left, CLOSE_S), POLL_S)
            time.sleep(wait)

    def _judge(self, motion: Motion, end: float | None) -> MotionError | None:
        """What to say of a motion after it ended."""
        position = self._commands.position()
        homed = self._commands.is_homed()
        task = motion.status.task
        motion.stopped = motion.stopped or self.interrupted()
        if motion.stopped:
            where = (
                f"at {self.coordinate.show(position)}"
                if homed
                else "where nobody knows, for it has no reference"
            )
            return (
                None
                if motion.stopped_as_planned
                else MotionError(f"{task}: stopped on the way {where}, as commanded")
            )
        faults = "; ".join(self._commands.faults())
        if not homed:
            lost = "did not find it" if end is None else "lost its reference on the way"
            return MotionError(
                f"{task}: {lost} ({faults or 'was it switched off?'}); look what holds it, then"
                " home it again"
            )
        if faults:
            return MotionError(
                f"{task}: ended at {self.coordinate.show(position)} ({faults}); look what holds it,"
                " then home it again"
            )
        told = end is None and self.coordinate is LENGTH
        if (
            told
            and self._homes_up is not None
            and at_the_other_end(position, self.travel, self._homes_up)
        ):
            found, due = ("low", "high") if self._homes_up else ("high", "low")
            return MotionError(
                f"{task}: found it at {self.coordinate.show(position)}, at the {found} end of its"
                f" travel, where `home_towards` and `sign` of the bench file have the {due} one;"
                " correct them before anything else moves, the rule of the gap relies on them"
            )
        if end is not None and abs(position - end) > 1.01 * self._commands.resolution:
            return MotionError(
                f"{task}: ended at {self.coordinate.show(position)} instead; look what holds it,"
                " then home it again"
            )
        return None

    def _stop_quietly(self) -> None:
        with contextlib.suppress(
            Exception
        ):  # whatever it is, who waits for the motion is told why it ended
            self._commands.stop()
