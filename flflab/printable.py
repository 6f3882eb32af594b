"""Words of others (devices, files) as text that a terminal only shows.

A terminal obeys what some characters say: escape sequences change its title, its colours, even its
clipboard, and others turn the direction of writing.
"""

import difflib
from collections.abc import Iterable


def printable(text: str) -> str:
    r"""A text whose characters that do not show are written as Python writes them, ESC as its four
    letters ``\x1b``; line ends and tabulators stay.
    """
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() or one in "\n\t" else one.encode("unicode_escape").decode("ascii")
        for one in text
    )


def shortened(value: object, most: int = 80) -> str:
    """A value as Python writes it, cut when long, for a sentence."""
    written = repr(value)
    return written if len(written) <= most else f"{written[:most]}..."


def nearest(given: str, known: Iterable[str]) -> str:
    """The known word that a misspelt one is likely to be; empty where none is near."""
    found = difflib.get_close_matches(given.lower(), list(known), n=1)
    return found[0] if found else ""
