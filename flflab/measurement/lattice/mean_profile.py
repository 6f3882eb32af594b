"""The light across a micro-image that all of a picture share, as the picture shows it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from flflab.measurement.lattice.kernel import LIGHT, SOFTER, WIDER, sum_profile
from flflab.measurement.lattice.pixels import Pixels, in_bands

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

FAINT = 5e-3  # of the light: where the profile has come to its end
POINTS = 2000  # of a profile's table
KNOTS_PX = 0.5  # least distance between knots of the profile
MOST_KNOTS = 160
PROFILED = 400  # micro-images that make the profile, at most
LIT = 0.3  # of the median light: darker ones would be taken for the profile's own darkness
STIFF = 1e-4  # how much a bend of the profile counts against a pixel


@dataclass(frozen=True)
class Profile:
    """The light across a micro-image, 1 in its middle, against the distance from its centre.

    Attributes:
        radius: at half light, px.
        step: between entries of the table, px.
        table: value, and slope a px, shape (n, 2).
    """

    radius: float
    step: float
    table: Array

    @property
    def end(self) -> float:
        """Distance from which on it is 0, px."""
        return (len(self.table) - 2) * self.step

    def reaches(self, share: float) -> float:
        """Distance at which it last is that share, px."""
        return float(np.flatnonzero(self.table[:, 0] >= share)[-1]) * self.step

    @property
    def softness(self) -> float:
        """Length over which the rim would fall from full light to none at its steepest, px."""
        return 1 / max(float(-self.table[:, 1].min()), 1e-9)


def soft_disc(radius: float, softness: float) -> Profile:
    """A disc with a logistic edge, px."""
    end = radius + 3.5 * softness + 1
    step = end / POINTS
    r = np.arange(POINTS + 2) * step
    value = 1 / (1 + np.exp(np.clip((r - radius) / softness, -50, 50)))
    ends = np.clip((end - r) / (softness + 1), 0, 1)
    value = value * ends * ends * (3 - 2 * ends)
    value /= value[0]
    return Profile(radius, step, np.stack([value, np.gradient(value, step)], axis=1))


def measured_profile(
    pixels: Pixels, values: Array, members: Whole, neighbours: Whole, before: Profile
) -> Profile:
    """The profile that micro-images show, by least squares on their pixels.

    Args:
        pixels: of the picture.
        values: of all micro-images.
        members: those that count, where they are not dark beside the others.
        neighbours: of all.
        before: the profile that the values belong to.
    """
    light = values[members, LIGHT]
    some = members[light > LIT * float(np.median(light))]
    some = some[:: max(1, len(some) // PROFILED)]
    spacing = max(KNOTS_PX, before.end / MOST_KNOTS)
    count = int(before.end / spacing) + 4
    every = np.full(len(values), pixels.every, dtype=np.int64)
    spline = spacing, count, before.radius, before.end
    parts = in_bands(
        lambda band: sum_profile(
            pixels.picture, band, values, neighbours, spline, every, pixels.numbers
        ),
        some,
    )
    normal, right = sum(part[0] for part in parts), sum(part[1] for part in parts)
    bend = np.diff(np.eye(count), 2, axis=0)
    weight = float(np.median(np.diag(normal)))
    system = normal + STIFF * weight * bend.T @ bend
    # it is flat in the middle, and ends at nothing
    slope = np.zeros((1, count))
    slope[0, [0, 2]] = -1, 1
    end = np.eye(count)[-3:]
    system += weight * (slope.T @ slope + end.T @ end)
    coefficients = np.linalg.solve(system, right)
    knots = (np.arange(count + 4) - 3) * spacing
    curve = BSpline(knots, coefficients, 3)
    step = spacing * (count - 3) / POINTS
    r = np.arange(POINTS + 2) * step
    inside = np.minimum(r, spacing * (count - 3) - 1e-9)
    value, fall = curve(inside), curve(inside, 1)
    top = float(value[r < 0.3 * before.radius].mean())
    table = np.stack([value, fall], axis=1) / top
    table = table[: int(np.flatnonzero(table[:, 0] > FAINT)[-1]) + int(2 * spacing / step) + 2]
    table[-2:] = 0.0
    above = np.flatnonzero(table[:, 0] >= 0.5)
    last = int(above[-1]) if len(above) else 0
    here, there = table[last, 0], table[min(last + 1, len(table) - 1), 0]
    radius = (last + (here - 0.5) / max(here - there, 1e-12)) * step
    return Profile(float(radius), step, table)


def above_ground(profile: Profile) -> Profile:
    """The profile without a level beneath all of it, where each micro-image has its own ground.

    A level is one that half of what lies between the rims shows.
    """
    r = np.arange(len(profile.table)) * profile.step
    around = (r > profile.radius) & (r < r[-1] - 3 * max(KNOTS_PX, r[-1] / MOST_KNOTS))
    light = profile.table[around, 0]
    level = float(light.min(initial=1.0))
    flat = np.count_nonzero(light < level + FAINT)
    if level < FAINT or flat < max(1, len(light)) / 2:
        return profile
    table = profile.table / (1 - level)
    table[:, 0] = np.maximum(0.0, table[:, 0] - level / (1 - level))
    last = int(np.flatnonzero(table[:, 0] > FAINT)[-1])
    table = table[: last + 2]
    table[-2:] = 0.0
    above = int(np.flatnonzero(table[:, 0] >= 0.5)[-1])
    here, there = table[above, 0], table[min(above + 1, len(table) - 1), 0]
    radius = (above + (here - 0.5) / max(here - there, 1e-12)) * profile.step
    return Profile(float(radius), profile.step, table)


def recentred(values: Array, profile: Profile, before: Profile, members: Whole) -> Array:
    """Values that belong to a new profile: as wide and soft on average as it is."""
    found = values.copy()
    found[:, WIDER] += before.radius - profile.radius
    found[:, WIDER] -= np.median(found[members, WIDER])
    found[:, SOFTER] -= np.median(found[members, SOFTER])
    return found
