"""Motion with limited speed and acceleration as a pure function of time.

Time-optimal trapezoids from any position and velocity to rest: x(t) = p + v (t - s) + a (t - s)^2 /
2 on each segment. Any unit of length; an acceleration of infinity means steps in velocity.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Segment:
    """A stretch of constant acceleration from ``start`` for ``duration`` seconds."""

    start: float
    duration: float
    position: float
    velocity: float
    acceleration: float


@dataclass(frozen=True)
class Motion:
    """Segments one after the other; before the first one at its beginning, after the last one at
    rest at ``target``.
    """

    segments: tuple[Segment, ...]
    target: float

    @property
    def end(self) -> float:
        """When it comes to rest, s; minus infinity for what never moved."""
        return self.segments[-1].start + self.segments[-1].duration if self.segments else -math.inf

    def at(self, instant: float) -> tuple[float, float]:
        """(position, velocity) at an instant."""
        if instant >= self.end:
            return self.target, 0.0
        current = next(
            segment
            for segment in reversed(self.segments)
            if instant >= segment.start or segment is self.segments[0]
        )
        elapsed = max(instant - current.start, 0.0)
        velocity = current.velocity + current.acceleration * elapsed
        return current.position + (current.velocity + velocity) / 2 * elapsed, velocity

    def moving(self, instant: float) -> bool:
        """Whether it has not come to rest yet."""
        return instant < self.end


def rest(position: float) -> Motion:
    """Standing still."""
    return Motion((), position)


def move(before: Motion, now: float, target: float, speed: float, acceleration: float) -> Motion:
    """Leave ``before`` at ``now`` for ``target``: the fastest way within speed and acceleration,
    turning round where need be.
    """
    position, velocity = before.at(now)
    reach = position + (
        velocity * abs(velocity) / (2 * acceleration) if math.isfinite(acceleration) else 0.0
    )
    sign = math.copysign(1.0, target - reach)
    distance, entry = sign * (target - position), sign * velocity
    if not math.isfinite(acceleration):
        return _chain(
            now, position, sign, [(distance / speed, speed, 0.0)] if distance else [], target
        )
    peak = min(speed, math.sqrt(max(acceleration * distance + entry**2 / 2, 0.0)))
    change = math.copysign(acceleration, peak - entry)
    cruise = distance - (peak**2 - entry**2) / (2 * change) - peak**2 / (2 * acceleration)
    stretches = [
        (abs(peak - entry) / acceleration, entry, change),
        (max(cruise, 0.0) / peak if peak > 0 else 0.0, peak, 0.0),
        (peak / acceleration, peak, -acceleration),
    ]
    return _chain(now, position, sign, stretches, target)


def stop(before: Motion, now: float, acceleration: float) -> Motion:
    """Slow down to rest from ``now`` on; at once with an infinite acceleration."""
    position, velocity = before.at(now)
    sign, speed = math.copysign(1.0, velocity), abs(velocity)
    if speed == 0 or not math.isfinite(acceleration):
        return rest(position)
    target = position + sign * speed**2 / (2 * acceleration)
    return _chain(now, position, sign, [(speed / acceleration, speed, -acceleration)], target)


def _chain(
    now: float,
    position: float,
    sign: float,
    stretches: list[tuple[float, float, float]],
    target: float,
) -> Motion:
    """Put stretches (duration, entry velocity, acceleration), counted along ``sign``, one after the
    other.
    """
    segments: list[Segment] = []
    for duration, velocity, acceleration in stretches:
        if duration > 0:
            segments.append(Segment(now, duration, position, sign * velocity, sign * acceleration))
            position += sign * (velocity * duration + acceleration * duration**2 / 2)
            now += duration
    return Motion(tuple(segments), target)
