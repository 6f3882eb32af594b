"""What a vendor's file provides: the few commands that ``Axis`` and ``Setting`` are made from."""

import math
from typing import Protocol, TypeVar

FOLLOWING = {"mm": 0.01, "rad": 2e-4}  # how far an axis may be from where it counts
Value = TypeVar("Value", float, str)


def at_the_other_end(reference: float, travel: tuple[float, float], homes_up: bool) -> bool:
    """Whether a reference lies in the quarter of the travel that is farthest from where it should
    be; never of one without ends.
    """
    low, high = travel
    return (
        math.isfinite(high - low)
        and (reference - low if homes_up else high - reference) < (high - low) / 4
    )


class AxisCommands(Protocol):
    """One axis as its vendor's protocol has it, in mm, or in rad for one that turns; every method
    talks to the device at once and is brief.

    Every method may raise CommunicationError; the two that start motion may raise DeviceError where
    the device refuses.
    """

    @property
    def measured(self) -> bool:
        """Whether its reading is measured by an encoder, not counted from the steps it was sent."""
        ...

    @property
    def travel(self) -> tuple[float, float]:
        """The device's own limits, readings."""
        ...

    @property
    def resolution(self) -> float:
        """The smallest difference between two positions; a motion may end this far from where it
        was asked to.
        """
        ...

    def start_home(self) -> None:
        """Start to look for the reference."""
        ...

    def start_move(self, position: float) -> None:
        """Start towards a reading."""
        ...

    def position(self) -> float:
        """What it counts, reference or not: how a motion is seen to make progress."""
        ...

    def reading(self) -> float | None:
        """What it counts where that is counted from its reference, else None; true whatever happens
        to the device meanwhile.
        """
        ...

    def is_busy(self) -> bool:
        """Whether it moves."""
        ...

    def is_homed(self) -> bool:
        """Whether its reading means anything."""
        ...

    def stop(self) -> None:
        """Stop now; never waits behind another thread's exchange."""
        ...

    def faults(self) -> tuple[str, ...]:
        """Why the last motion did not end as asked, one phrase each; empty where it did."""
        ...

    def warnings(self) -> tuple[str, ...]:
        """Everything the device wants to be known, one phrase each."""
        ...

    def identity(self) -> str:
        """Maker, model, serial number and firmware as far as the device tells."""
        ...

    def serial(self) -> str:
        """What no other axis of its maker answers: serial number, and which axis of its instrument;
        empty where it tells none.
        """
        ...

    def close(self) -> None:
        """Let go of the device; stops nothing, raises nothing."""
        ...


class SettingCommands(Protocol[Value]):
    """One setting as its instrument has it: an f-number, the name of a target."""

    @property
    def allowed(self) -> tuple[Value, ...]:
        """Every name allowed, or the least and the largest number."""
        ...

    def start(self, value: Value) -> None:
        """Start to change the setting."""
        ...

    def is_busy(self) -> bool:
        """Whether it changes."""
        ...

    def value(self) -> Value:
        """What it is now."""
        ...

    def fault(self) -> str:
        """Why the last change did not end as asked; empty where it did."""
        ...

    def stop(self) -> None:
        """Give up the change under way where the instrument can."""
        ...

    def identity(self) -> str:
        """Maker, model, serial number and firmware as far as the device tells."""
        ...

    def close(self) -> None:
        """Let go of the device; raises nothing."""
        ...
