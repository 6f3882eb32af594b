"""Numbers for people: an uncertainty with two significant digits, its value to the same place."""

import math


def decimals(uncertainty: float) -> int | None:
    """Decimals of an uncertainty's second digit, at most 9; None where there is no uncertainty."""
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return None
    return min(max(0, 1 - math.floor(math.log10(float(f"{uncertainty:.1e}")))), 9)


def two_digits(uncertainty: float) -> str:
    """An uncertainty alone, or a signed contribution to one: ``0.020``, ``1.2e-06``, ``-340``."""
    if uncertainty < 0:
        return f"-{two_digits(-uncertainty)}"
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return f"{uncertainty:g}"
    places = 1 - math.floor(math.log10(float(f"{uncertainty:.1e}")))
    if places > 6:
        return f"{uncertainty:.1e}"
    return f"{round(uncertainty, places):.{max(places, 0)}f}"


def plus_minus(value: float, uncertainty: float, sign: str = "") -> str:
    """A value with its standard uncertainty: ``1.850 ± 0.020``; six digits where there is none."""
    places = decimals(uncertainty)
    if places is None or not math.isfinite(value):
        return f"{value:{sign}.6g}"
    place = 1 - math.floor(math.log10(float(f"{uncertainty:.1e}")))
    if place > 9:
        return f"{value:{sign}.10g} ± {uncertainty:.1e}"
    shown = f"{uncertainty:.{places}f}" if place > 0 else two_digits(uncertainty)
    return f"{round(value, place) + 0.0:{sign}.{places}f} ± {shown}"
