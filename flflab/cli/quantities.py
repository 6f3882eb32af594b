"""A quantity given to an option: a refusal names the option, for a command line may hold several."""

from flflab.errors import InputError
from flflab.units import Dimension, parse_quantity


def option_quantity(option: str, given: str, dimension: Dimension) -> float:
    """What an option was given, in the unit used inside.

    Raises:
        InputError: it is no such quantity; the option is named.
    """
    try:
        return parse_quantity(given, dimension)
    except InputError as error:
        raise InputError(f"{option} {error}") from error
