"""What a reader of a number should know beside it: a sentence, and a word for scripts."""

from typing import NamedTuple


class Remark(NamedTuple):
    """One remark.

    Attributes:
        code: a word that stays the same whatever the sentence says, such as ``gamma``.
        sentence: for an operator, without its full stop.
    """

    code: str
    sentence: str
