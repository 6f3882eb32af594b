"""How fast stages of the simulated bench move by themselves."""

from typing import get_args

from flflab.bench import Bench, Element
from flflab.errors import InputError
from flflab.units import parse_quantity


def drifts(bench: Bench) -> dict[str, float]:
    """How fast the elements of some axes move along z by themselves, mm/s, by the axes' names.

    Raises:
        InputError: there is no such axis, it turns the array, or no speed is given.
    """
    elements = [
        name for name, axis in bench.description.axes.items() if axis.moves in get_args(Element)
    ]
    found: dict[str, float] = {}
    for name, given in bench.description.simulated.drift.items():
        where = bench.where("simulated", "drift", name)
        if name not in elements:
            raise InputError(f"{where}: nothing drifts there; allowed: {', '.join(elements)}")
        try:
            found[name] = parse_quantity(given, "speed")
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
    return found
