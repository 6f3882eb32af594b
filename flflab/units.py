"""Quantities at the borders: a number and one unit in, a plain number in mm, s, rad or cycles/mm
out.
"""

import math
import re
from typing import Literal

from flflab.errors import InputError
from flflab.printable import shortened

Dimension = Literal[
    "length", "angle", "time", "frequency", "speed", "angular speed", "acceleration", "ratio"
]

MICRO = str.maketrans("µμ", "uu")  # the micro sign and the Greek letter that Unicode prefers to it

# Factors to the unit used inside: mm, rad, s, cycles/mm, mm/s, rad/s, mm/s^2, 1.
FACTORS: dict[Dimension, dict[str, float]] = {
    "length": {
        "nm": 1e-6,
        "um": 1e-3,
        "mm": 1.0,
        "cm": 10.0,
        "m": 1e3,
        "in": 25.4,
    },
    "angle": {
        "rad": 1.0,
        "mrad": 1e-3,
        "urad": 1e-6,
        "deg": math.pi / 180,
        "arcmin": math.pi / 10800,
        "arcsec": math.pi / 648000,
    },
    "time": {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0},
    "frequency": {"cycles/mm": 1.0, "lp/mm": 1.0, "1/mm": 1.0, "cycles/um": 1e3, "cycles/m": 1e-3},
    "speed": {
        "um/h": 1e-3 / 3600,
        "mm/h": 1 / 3600,
        "um/s": 1e-3,
        "mm/s": 1.0,
        "m/s": 1e3,
    },
    "angular speed": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": math.pi / 180},
    "acceleration": {"mm/s^2": 1.0, "mm/s2": 1.0, "m/s^2": 1e3, "m/s2": 1e3},
    "ratio": {"%": 1e-2, "ppm": 1e-6},
}
EXAMPLES: dict[Dimension, str] = {
    "length": "mm",
    "angle": "deg",
    "time": "ms",
    "frequency": "cycles/mm",
    "speed": "mm/s",
    "angular speed": "deg/s",
    "acceleration": "mm/s^2",
    "ratio": "%",
}
SHOWN_UNITS: dict[Dimension, str] = {
    "length": "mm",
    "angle": "rad",
    "time": "s",
    "frequency": "cycles/mm",
    "speed": "mm/s",
    "angular speed": "rad/s",
    "acceleration": "mm/s^2",
    "ratio": "",
}
_QUANTITY = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?:\s+(\S+)|([^\s\d.eE+-]\S*))\s*"
)


def parse_quantity(given: object, dimension: Dimension) -> float:
    """Read a quantity such as ``400 um`` and return it in the unit used inside.

    Args:
        given: what stood in the file or on the command line; ``0`` needs no unit.
        dimension: what kind of quantity is due.

    Returns:
        The value in mm, rad, s, cycles/mm, mm/s, rad/s or mm/s^2; ``infinity`` is allowed for a
        length.

    Raises:
        InputError: no unit, an unknown unit or one of another kind, or not a finite number.
    """
    units = FACTORS[dimension]
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        if given == 0 or (dimension == "ratio" and math.isfinite(given)):
            return float(given)
        raise InputError(f"{shortened(given)} has no unit; {_due(dimension, f'{given:g}')}")
    if not isinstance(given, str):
        raise InputError(f"{shortened(given)} is not a quantity; {_due(dimension)}")
    if dimension == "length" and given.strip() in ("infinity", "inf"):
        return math.inf
    found = _QUANTITY.fullmatch(given)
    if not found:
        try:
            bare = float(given)
        except ValueError:
            raise InputError(f"{shortened(given)} is not a quantity; {_due(dimension)}") from None
        if bare == 0 or (dimension == "ratio" and math.isfinite(bare)):
            return bare
        raise InputError(f"{shortened(given)} has no unit; {_due(dimension, f'{bare:g}')}")
    number, unit = found[1], (found[2] or found[3]).translate(MICRO)
    if unit not in units:
        kind = next((name for name, table in FACTORS.items() if unit in table), None)
        reason = f"{unit!r} is a unit of {kind}" if kind else f"{unit!r} is not a unit known here"
        raise InputError(f"{shortened(given)}: {reason}; {_due(dimension, found[1])}")
    value = float(number) * units[unit]
    if not math.isfinite(value):
        raise InputError(f"{shortened(given)} is too large; {_due(dimension)}")
    return value


def _due(dimension: Dimension, number: str = "1") -> str:
    """What a quantity is, with an example of this number."""
    article, units = "an" if dimension[0] == "a" else "a", ", ".join(FACTORS[dimension])
    return (
        f"{article} {dimension} is a number and a unit of {units}, for instance"
        f" '{number} {EXAMPLES[dimension]}'"
    )


def show_quantity(value: float, unit: str, digits: int = 6) -> str:
    """Write a number with its unit for people, or ``none`` where there is no value."""
    if math.isinf(value):
        return "infinity" if value > 0 else "-infinity"
    return f"{value:.{digits}g} {unit}".strip()
