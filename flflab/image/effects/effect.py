"""What every effect can say of itself in a scene's regime; the chooser asks nothing else."""

from typing import ClassVar, Protocol

from flflab.image.regime import Regime


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
