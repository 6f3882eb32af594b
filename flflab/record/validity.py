"""Whether a recorded frame may be judged: admitted, diagnostic (a check failed), or unvalidated (a
check could not be made), each with its reason.

Judged from the record alone whenever a run is read, so that old runs are judged by the same rules.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from flflab.record.frame_record import ADMITTED, FrameRecord, Validity

RECORD_SCHEMA = 2  # of the start document; without one it is 1, before motion was looked at
TEMPERATURES = "temperature_range_degc"  # of the start document, as the bench file states it
MOST_SATURATED = 0.01  # of a frame's pixels; fewer are left out of every fit
MOST_MOVED = 3.0  # resolutions of an axis between before and after the exposure: a servo hunts
OLDEST_WHITE_S = 12 * 3600.0  # before a frame that is measured with it


def validities(
    frames: Sequence[FrameRecord], start: Mapping[str, Any], pixels: int | None
) -> tuple[Validity, ...]:
    """The validity of every frame of a run.

    Args:
        frames: as recorded.
        start: the run's start document.
        pixels: of a frame; None where the file of frames cannot be read.
    """
    whites: dict[int | None, float] = {}
    for frame in frames:
        if frame.target == "white":
            whites.setdefault(frame.configuration, frame.time)
    looked = int(start.get("record_schema", 1)) >= RECORD_SCHEMA
    low, high = start.get(TEMPERATURES) or (-math.inf, math.inf)

    def of(frame: FrameRecord) -> Validity:
        old = frame.time - whites.get(frame.configuration, frame.time)
        if pixels is not None and frame.saturated > MOST_SATURATED * pixels:
            return _failed(
                f"saturated ({100 * frame.saturated / pixels:.2g} % of its pixels,"
                f" {100 * MOST_SATURATED:g} % are allowed)"
            )
        if frame.moved is not None and frame.moved > MOST_MOVED:
            return _failed(
                f"moved during exposure (an axis by {frame.moved:.1f} of its steps,"
                f" {MOST_MOVED:g} are allowed)"
            )
        if frame.configuration is not None and old > OLDEST_WHITE_S:
            return _failed(
                f"white picture out of date (taken {old / 3600:.1f} h before,"
                f" {OLDEST_WHITE_S / 3600:g} h are allowed)"
            )
        if frame.temperature is not None and not low <= frame.temperature <= high:
            return _failed(
                f"temperature {frame.temperature:g} degC outside the stated range, {low:g} to"
                f" {high:g} degC"
            )
        if pixels is None:
            return Validity("unvalidated", "nobody knows how many pixels a frame has")
        if looked and frame.moved is None:
            return Validity("unvalidated", "nobody looked whether an axis moved")
        return ADMITTED

    return tuple(of(frame) for frame in frames)


def _failed(why: str) -> Validity:
    return Validity("diagnostic", why)


def not_used(frames: Sequence[FrameRecord]) -> dict[str, list[str]]:
    """The points of the frames that are not admitted, by status and reason."""
    found: dict[str, list[str]] = {}
    for frame in frames:
        if not frame.validity.admitted:
            why = f"{frame.validity.status}: {frame.validity.reason}"
            found.setdefault(why, []).append(frame.key)
    return found


def frames_said(frames: Sequence[FrameRecord]) -> str:
    """How many frames a verdict uses, and how many not and why, in a sentence."""
    used = sum(frame.validity.admitted for frame in frames)
    if used == len(frames):
        return f"All {used} frames are admitted."
    reasons = "; ".join(
        f"{len(points)} {why} ({', '.join(points[:3])}{', ...' if len(points) > 3 else ''})"
        for why, points in not_used(frames).items()
    )
    return f"{used} of {len(frames)} frames are admitted and used; not used: {reasons}."
