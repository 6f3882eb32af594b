"""One spelling for each address, so that two names of one line are one line: by driver of an axis.

Loads nothing that is not of Python: a stop waits for what it loads.
"""

import re
from collections.abc import Callable, Mapping

from drivers.transport import one_host, serial_place
from flflab.errors import InputError


def ximc_place(address: str) -> str:
    """An address of a Standa controller: the library's own with their host's number, or a port.

    Raises:
        InputError: it is neither a port nor one of the library's.
    """
    port = address.removeprefix("xi-com:")
    if remote := re.match(r"(xi-(?:net|tcp|udp)://)([^/:]+)", port):
        return f"{remote[1]}{one_host(remote[2])}{port[remote.end() :]}"
    return port if re.match(r"xi-(emu|net|tcp|udp):", port) else serial_place(port)


PLACES: Mapping[str, Callable[[str], str]] = {
    "zaber": serial_place,
    "thorlabs": serial_place,
    "oriental": serial_place,
    "standa": ximc_place,
    "manual": str,
}


def spelt(driver: str, address: str) -> str:
    """The address of an axis spelt one way; as it is where it, or its driver, is none."""
    try:
        if driver in PLACES:
            return PLACES[driver](address)
        from drivers.registry import AXES  # another package's: only who has one loads it

        return AXES[driver].place(address)
    except (KeyError, InputError):
        return address
