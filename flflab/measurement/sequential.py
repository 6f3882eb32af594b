"""How many frames an accuracy takes: a rule that looks at the uncertainty alone, never at the
value.

The uncertainty of a mean of n frames follows u(n)^2 = a / n + c, with a from light and read noise
and c what no number of frames takes away (the fit's own error). A first look at few frames tells
how many are due; a second, where it still is not enough, tells a and c. The value measured has no
say in when to stop, and where u is computed from the noise of a known sensor over thousands of
pixels it hardly depends on the value: the mean at the end is as free of bias as one of a fixed
number of frames (tests/measurement/test_sequential.py holds the bias below a twentieth of the
uncertainty asked for).
"""

import math
from dataclasses import dataclass

SLACK = 1e-9


@dataclass(frozen=True)
class Look:
    """What a number of frames gave: the standard uncertainty of their mean."""

    frames: int
    uncertainty: float


def frames_due(looks: tuple[Look, ...], wanted: float, most: int) -> int:
    """How many frames there should be before the next look; no more than there are where it is
    over.

    Args:
        looks: so far, at least one, each with more frames than the one before.
        wanted: standard uncertainty asked for, in the units of the looks.
        most: largest number of frames.

    Returns:
        The number in all: that of the last look where it is sure enough or ``most`` is reached.
    """
    last = looks[-1]
    if last.uncertainty <= wanted or last.frames >= most:
        return last.frames
    per_frame, lasting = split_up(looks)
    if wanted**2 <= lasting:
        return most
    needed = math.ceil(per_frame / (wanted**2 - lasting) * (1 - SLACK))
    return min(max(needed, last.frames + 1), most)


def split_up(looks: tuple[Look, ...]) -> tuple[float, float]:
    """a and c of u(n)^2 = a / n + c from the last two looks, neither below 0; c is 0 with one
    look.
    """
    last = looks[-1]
    if len(looks) == 1:
        return last.frames * last.uncertainty**2, 0.0
    before = looks[-2]
    per_frame = max(before.uncertainty**2 - last.uncertainty**2, 0.0) / (
        1 / before.frames - 1 / last.frames
    )
    return per_frame, max(last.uncertainty**2 - per_frame / last.frames, 0.0)
