"""The light across a micro-image that all of a picture share, as the picture shows it."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.spatial import KDTree

from flflab.measurement.lattice.kernel import LIGHT, SOFTER, WIDER, sum_profile
from flflab.measurement.lattice.neighbours import neighbours_within
from flflab.measurement.lattice.pixels import Pixels, in_bands

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

FAINT = 5e-3  # of the light: where the profile has come to its end
POINTS = 2000  # of a profile's table
KNOTS_PX = 0.5  # least distance between knots of the profile
MOST_KNOTS = 160
PROFILED = 400  # micro-images that make the profile, at most
LIT = 0.3  # of the median light: darker ones would be taken for the profile's own darkness
AROUND = 0.05, 2.0  # of the radius, and px: how far beyond the light the ground is looked at
NEXT = 1.2  # of the pitch: the next ones light the ground even where none touch
BEYOND = 6  # knots beyond it, that tell the level beneath all of it
MIDDLE = 0.3  # of the radius: light there is that of the micro-image
STIFF = 1e-4  # how much a bend of the profile counts against a pixel


@dataclass(frozen=True)
class Profile:
    """The light across a micro-image, 1 in its middle, against the distance from its centre.

    Attributes:
        radius: at half light, px.
        step: between entries of the table, px.
        table: value, and slope a px, shape (n, 2).
        pixel: side of the squares over which it is averaged, px.
    """

    radius: float
    step: float
    table: Array
    pixel: int = 1

    @property
    def end(self) -> float:
        """Distance from which on it is 0, px."""
        return (len(self.table) - 2) * self.step

    @property
    def places(self) -> Array:
        """Distances of the table's entries, px, shape (n,)."""
        return self.step * np.arange(len(self.table), dtype=np.float64)

    def changed(self, wider: float, softer: float) -> "Profile":
        """That of a micro-image with these values beside it."""
        radius, grown = self.radius + wider, math.exp(softer)
        step = self.step * (radius + (self.end - self.radius) * grown) / self.end
        at = self.radius + (step * np.arange(len(self.table)) - radius) / grown
        value, fall = (np.interp(at, self.places, column) for column in self.table.T)
        return Profile(radius, step, np.stack([value, fall / grown], axis=1), self.pixel)

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
    pixels: Pixels,
    values: Array,
    members: Whole,
    before: Profile,
    grounded: bool,
) -> tuple[Profile, Array]:
    """The profile that micro-images show, by least squares on their pixels, and their values
    beside it.

    Args:
        pixels: of the picture.
        values: of all micro-images.
        members: those that count, where they are not dark beside the others.
        before: the profile that the values belong to.
        grounded: whether each has a ground of its own, which the profile then leaves out.
    """
    light = values[members, LIGHT]
    some = members[light > LIT * float(np.median(light))]
    some = some[:: max(1, len(some) // PROFILED)]
    spacing = max(KNOTS_PX, before.end / MOST_KNOTS)
    # where no gap shows the ground it does not tell light that goes far from none
    length = before.end + (BEYOND * spacing if grounded else 0.0)
    count = int(length / spacing) + 4
    near = KDTree(values[members, :2]).query(values[members, :2], 2)[0][:, 1]
    pitch = float(np.median(near))
    neighbours = neighbours_within(values[:, :2], max(2 * before.end, NEXT * pitch))
    spline = spacing, count, length
    shape = before.table, before.radius, before.step
    parts = in_bands(
        lambda band: sum_profile(
            pixels.picture, band, values, neighbours, shape, spline, pixels.every, pixels.numbers
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
    curve = BSpline((np.arange(count + 4) - 3) * spacing, np.linalg.solve(system, right), 3)
    # as wide and soft as they are on average
    usual = np.median(values[members][:, [WIDER, SOFTER]], axis=0)
    shrink, last = math.exp(-usual[1]), spacing * (count - 3)
    step = (before.radius + usual[0] + (last - before.radius) / shrink) / POINTS
    r = np.arange(POINTS + 2) * step
    at = np.clip(before.radius + (r - before.radius - usual[0]) * shrink, 0.0, last - 1e-9)
    value, fall = curve(at), curve(at, 1) * shrink
    if grounded:
        tail = (at > last - BEYOND * spacing) & (at < last - 3 * spacing)
        value = np.maximum(value - max(float(value[tail].mean()), 0.0), 0.0)
    middle = r < MIDDLE * before.radius
    top = float(np.average(value[middle], weights=r[middle]))
    table = np.stack([value, fall], axis=1) / top
    above = np.flatnonzero(table[:, 0] >= 0.5)
    outer = int(above[-1]) if len(above) else 0
    # what shows again beyond darkness is no light
    faint = np.flatnonzero(table[outer:, 0] < FAINT)
    lit = (outer + int(faint[0]) if len(faint) else len(table)) + int(2 * spacing / step)
    # where neighbours leave room, the ground beyond it is looked at
    room = pitch / 2 - lit * step
    around = int(min(max(room, 0.0), max(AROUND[0] * before.radius, AROUND[1])) / step)
    table = np.concatenate([table[:lit], np.zeros((around, 2))])
    here, there = table[outer, 0], table[min(outer + 1, len(table) - 1), 0]
    radius = (outer + (here - 0.5) / max(here - there, 1e-12)) * step
    beside = values.copy()
    beside[:, [WIDER, SOFTER]] -= usual
    return Profile(float(radius), step, table), beside
