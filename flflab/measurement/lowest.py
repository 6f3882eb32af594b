"""Where chi squared is least along one number, by parabolas."""

import math
from collections.abc import Callable, Sequence

LEAST = 1e-5  # of chi squared above its least: a three-hundredth of a standard uncertainty
MOST_PARABOLAS = 8


def lowest(value: Callable[[float], float], places: Sequence[float], floor: float) -> float:
    """Place not below a floor where a function is least, or above its least by LEAST, by parabolas
    through its three lowest points.
    """
    points = sorted((value(place), place) for place in places)[:3]
    for _ in range(MOST_PARABOLAS):
        (best, at), (second, left), (third, right) = points
        slopes = (second - best) / (left - at), (third - best) / (right - at)
        bend = (slopes[1] - slopes[0]) / (right - left)  # half the second derivative
        reach = 2 * max(abs(left - at), abs(right - at))
        lower = (
            at - (slopes[0] - bend * (left - at)) / (2 * bend)
            if bend > 0
            else at - math.copysign(reach, slopes[0])
        )
        there = min(max(lower, at - reach, floor), at + reach)
        if there == at == floor and lower > 2 * floor - min(
            left, right
        ):  # too far apart to say that it is least at the floor
            there = (min(left, right) + 3 * floor) / 4
        if there in (at, left, right):
            return at
        if bend > 0 and abs(bend * (there - at) * (there + at - 2 * lower)) < LEAST:
            return there
        points = sorted([*points, (value(there), there)])[:3]
    return points[0][1]
