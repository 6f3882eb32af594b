"""What an effect is: its parameters and what is allowed of them, and what it can say of itself in a
scene's regime; the chooser asks nothing else.
"""

import math
from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.regime import Regime
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]
Record = Any  # a microlens: numba reads its fields as attributes, which numpy's types do not know


def parameter(
    default: Any = MISSING,
    *,
    unit: str = "",
    least: float = 0.0,
    most: float = math.inf,
    above: float = -math.inf,
) -> Any:
    """A number of an effect, or a tuple of them: ``unit`` is mm, s, of what, or none; all that lies
    from ``least`` to ``most`` and ``above`` a number is allowed.
    """
    allowed = "a finite number is due"
    if math.isfinite(least):
        allowed = f"a finite number from {least:g} up is due"
    if math.isfinite(above):
        allowed = f"a finite number above {above:g} is due"
    if math.isfinite(most):
        allowed = f"from {least:g} to {most:g} is allowed"
    limits = {"unit": unit, "least": least, "most": most, "above": above, "allowed": allowed}
    return field(default=default, metadata=limits)


@dataclass(frozen=True)
class Effect:
    """A frozen description of one effect; ``pixel_ns`` and ``lit_ns`` are what it was measured to
    take of a pixel, and of one that light reaches.
    """

    name: ClassVar[str]
    unit: ClassVar[str]
    pixel_ns: ClassVar[float] = 0.0
    lit_ns: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        """Refuse parameters outside of what is allowed.

        Raises:
            InputError: one is; with what is allowed.
        """
        for one in fields(self):
            given, limits = getattr(self, one.name), one.metadata
            for value in given if isinstance(given, tuple) else (given,):
                if not limits or (
                    math.isfinite(value)
                    and limits["least"] <= value <= limits["most"]
                    and value > limits["above"]
                ):
                    continue
                told = f"{one.name} is {value:g} {limits['unit']}".rstrip()
                effect = self.name.replace("-", " ")
                raise InputError(f"{effect}: {told}; {limits['allowed']}")

    def size(self, regime: Regime) -> float:
        """How large the effect is, in ``unit``: its first parameter where it says nothing else."""
        return getattr(self, fields(self)[0].name)

    def bound(self, regime: Regime) -> float:
        """Most that leaving it out can change on any pixel, of white, whichever of the others are
        left out too: its size as a share of the brightest light where it says nothing else.
        """
        return self.size(regime) * regime.brightest

    def why(self, regime: Regime) -> str:
        """One sentence: what its size comes from."""
        raise NotImplementedError

    def cost(self, regime: Regime) -> float:
        """Milliseconds it takes on one core."""
        return 1e-6 * regime.pixels * (self.pixel_ns + self.lit_ns * regime.lit)


@dataclass(frozen=True)
class Formed:
    """What an effect that changes a finished picture may ask for.

    Attributes:
        camera: that takes the picture.
        white: forms the picture of a white target, changed by the effects before this one.
        lenses: ``MICROLENS`` records of the microlenses that light the sensor.
    """

    camera: Camera
    white: Callable[[], Array]
    lenses: Callable[[], npt.NDArray[np.void]]


@dataclass(frozen=True)
class Finishing(Effect):
    """An effect that changes a finished picture."""

    def apply(self, image: Array, formed: Formed) -> None:
        """Change the picture, in place."""
        raise NotImplementedError
