"""Every error this project raises on purpose; each message is one sentence for an operator."""

import re

_NUMBERED = re.compile(r"\[(?:Errno|WinError) -?\d+\] ([^:\n]+)|\(-?\d+, '([^']*)'\)")


def reason(error: BaseException) -> str:
    """Why something could not be done, in words, once and in one line: without the number and the
    path that the system and the libraries around it say several times.
    """
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    found = _NUMBERED.search(said)
    words = (found[1] or found[2]) if found else said
    return " ".join(words.split()) or type(error).__name__


class FlflabError(Exception):
    """Base of all deliberate errors: the message says who, what was asked, what is allowed and what
    to do.
    """


class InputError(FlflabError):
    """A file, field, quantity or argument is missing, misspelt, without a unit, or impossible."""


class MeasurementError(FlflabError):
    """A picture does not hold what was to be measured in it."""


class RecordError(FlflabError):
    """A run's folder cannot be written or read."""


class DeviceError(FlflabError):
    """An instrument cannot do what it was asked."""


class LimitError(DeviceError):
    """A position outside the soft limits was asked for; nothing moved."""


class NotHomedError(DeviceError):
    """An axis without a reference was asked to move to a position; nothing moved."""


class InterlockError(DeviceError):
    """A move would break a rule across axes (the minimum gap); nothing moved."""


class CommunicationError(DeviceError):
    """An instrument did not answer, or answered something that is not its language."""


class MotionError(DeviceError):
    """A motion started and did not end where it should: stalled, interrupted, or timed out."""
