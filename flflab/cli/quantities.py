"""A quantity given to an option: a refusal names the option, for a command line may hold several,
and says where quotes are missing.
"""

import re
from collections.abc import Sequence

from flflab.errors import InputError
from flflab.units import FACTORS, MICRO, SHOWN_UNITS, Dimension, parse_quantity

_NUMBER = re.compile(
    r"(?P<option>--?[a-z][\w-]*=)?(?P<number>[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?)"
)


def option_quantity(option: str, given: str, dimension: Dimension) -> float:
    """What an option was given, in the unit used inside.

    Raises:
        InputError: it is no such quantity; the option is named.
    """
    try:
        return parse_quantity(given, dimension)
    except InputError as error:
        quotes = (
            f'; a space before the unit wants quotes: {option} "{given} {SHOWN_UNITS[dimension]}"'
            if _NUMBER.fullmatch(given)
            else ""
        )
        raise InputError(f"{option} {error}{quotes}") from error


def where_quotes_are_missing(given: Sequence[str]) -> str:
    """How the first quantity that was given as two words, ``507 mm``, is given as one; empty where
    none was.

    Args:
        given: the words of a command line.
    """
    units = {unit for table in FACTORS.values() for unit in table}
    for before, word, unit in zip(("", *given), given, given[1:], strict=False):
        if unit.translate(MICRO) in units and (found := _NUMBER.fullmatch(word)):
            option = found["option"] or (
                f"{before} " if re.fullmatch(r"--?[a-z][\w-]*", before) else ""
            )
            return f'{option}"{found["number"]} {unit}"'
    return ""
