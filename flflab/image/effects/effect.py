"""What every effect can say of itself in a scene's regime; the chooser asks nothing else."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.regime import Regime
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]
Record = Any  # a microlens: numba reads its fields as attributes, which numpy's types do not know


class Effect(Protocol):
    """A frozen description of one effect."""

    name: ClassVar[str]
    unit: ClassVar[str]

    def size(self, regime: Regime) -> float:
        """How large the effect is, in ``unit``."""
        ...

    def bound(self, regime: Regime) -> float:
        """Most that leaving it out can change on any pixel, of white, whichever of the others are
        left out too.
        """
        ...

    def cost(self, regime: Regime) -> float:
        """Milliseconds it takes on one core: counts times what each was measured to take."""
        ...

    def why(self, regime: Regime) -> str:
        """One sentence: what its size comes from."""
        ...


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


class Finishing(Effect, Protocol):
    """An effect that changes a finished picture."""

    def apply(self, image: Array, formed: Formed) -> None:
        """Change the picture, in place."""
        ...


def require(
    effect: str, name: str, value: float, least: float = 0.0, most: float = math.inf, of: str = ""
) -> None:
    """Refuse a number of an effect that is not finite or outside a range; ``of``: its unit.

    Raises:
        InputError: it is; with what is allowed.
    """
    if math.isfinite(value) and least <= value <= most:
        return
    allowed = "a finite number is due"
    if math.isfinite(least):
        allowed = f"a finite number from {least:g} up is due"
    if math.isfinite(most):
        allowed = f"from {least:g} to {most:g} is allowed"
    raise InputError(f"{effect.replace('-', ' ')}: {name} is {value:g}{of}; {allowed}")
