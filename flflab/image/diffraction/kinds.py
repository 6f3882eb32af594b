"""Microlenses sorted into a few kinds, each with one pupil and one map to the target, so that what
diffraction does is tabulated once.

What varies over the sensor, rims, blur, map and motion, varies together, nearly along a line or
over a plane: light is interpolated between a few kinds. When the logarithm of its blur or of the
pattern's size changes by 1, an edge changes by at most 1/pi of white, lines by what a blurred sine
does, a dot as large as its blur by twice its light; second derivatives, of which linear
interpolation is off, are of the same size, but larger by the square root of a wide blur, at whose
ends an edge turns sharply.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.diffraction.smear import Smear
from flflab.image.effects.motion import Motion
from flflab.image.geometry.setup import Setup
from flflab.optics.discs import two_disc_areas
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, Target

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

BLURRED = 300.0  # pixels; a blur beyond is left to rays
BLURRED_OUT = 1e6  # pixels; no matter which: the target's image lies on the array
NO_RIM = 1e-6  # of the micro-image: a rim so narrow is none
FLAT = 0.96  # of the tolerance: what a kind's microlenses may change by; they are off by half of it
CHANGES: dict[type[Target], float] = {
    Edge: 1 / math.pi,
    Bars: 0.62,
    Chirp: 0.49,
    FourDot: 2.0,
    Picture: 2.0,
}  # of white, see above
LARGE = 2.0  # times the pattern's radius, from which on fewer ends of a target lie within it
FEW_CORNERS = 0.64  # of white, by which texels so large change
AIRY = 1.22  # over the cutoff: radius of the first dark ring
# the second derivative of an edge through a blur of so many pixels over the square root of them
BEND = 0.45


@dataclass(frozen=True)
class Kind:
    """Microlenses with nearly one kind of pupil and nearly one map to the target; lengths in pixels
    on the sensor.

    Attributes:
        entries: which entries of the setup, shape (n,).
        weights: part of each entry's light that this kind forms; other kinds form the rest.
        slope: shift of the clipping disc, |slope| of ``Pupils``.
        reach: its radius on the sensor.
        blur: radius of the geometric blur, signed.
        cutoff: where the whole pupil's transfer ends, cycles/pixel.
        by_sensor: target mm per pixel on the sensor, shape (2, 2).
        rims: of each entry's micro-image: distance from the centre up to which nothing is clipped,
            slope, reach, radius; (n, 4).
        smear: the target's motion.
    """

    entries: Whole
    weights: Array
    slope: float
    reach: float
    blur: float
    cutoff: float
    by_sensor: Array
    rims: Array
    smear: Smear

    @property
    def pupil(self) -> tuple[float, float, float, float]:
        """All that its transfer functions depend on."""
        return self.slope, self.reach, self.blur, self.cutoff

    @property
    def extent(self) -> float:
        """How far blur and motion carry light."""
        return abs(self.blur) + self.smear.extent

    @property
    def inner(self) -> float:
        """Distance from the micro-image's centre up to which nothing is clipped."""
        return max(0.0, self.reach - self.slope)

    @property
    def outer(self) -> float:
        """Radius of the largest micro-image."""
        return float(self.rims[:, 3].max())


def find_kinds(
    setup: Setup, target: Target, wavelength: float, seen: Whole, pixels: Array, cost: float
) -> list[Kind]:
    """Sort the entries ``seen`` into kinds whose pictures, interpolated, differ from each entry's
    own by less than the tolerance.

    The geometric blur is by_pupil over by_sensor: a number, but for what a target's tilt does to
    it, of which the mean is taken. Only the size, the shape and the turn of the pattern are a
    kind's: positions are always an entry's own.

    Args:
        setup: what is formed.
        target: what is looked at, which tells how much its light changes with the pattern.
        wavelength: of the light, mm.
        seen: the entries.
        pixels: how many pixels each lights, shape (N,).
        cost: how many pixels cost as much as the tables of one more kind.
    """
    pixel, pupils = setup.sensor.pixel, setup.pupils
    by_sensor, by_pupil = setup.by_sensor[seen] * pixel, setup.by_pupil[seen]
    along_pupil, size = (
        np.linalg.norm(by_pupil, axis=(1, 2)),
        np.linalg.norm(by_sensor, axis=(1, 2)),
    )
    on_array = size * BLURRED_OUT <= along_pupil
    inverse = np.linalg.inv(np.where(on_array[:, None, None], np.eye(2), by_sensor))
    blur = np.where(on_array, BLURRED_OUT, np.trace(inverse @ by_pupil, axis1=1, axis2=2) / 2)
    blur = np.where(pupils.slope[seen] < 0, -blur, blur)
    cutoff = 2 * np.abs(pupils.slant_spread[seen]) * pixel / wavelength
    slope, reach = (
        np.abs(pupils.slope[seen]) / pixel,
        np.maximum(pupils.reach[seen] / pixel, 1e-300),
    )
    rims = np.column_stack([np.maximum(reach - slope, 0.0), slope, reach, reach + slope])
    moved = (
        np.zeros((len(seen), 2, 2))
        if setup.motion is None
        else _movements(setup.motion, setup.by_motion[seen])
    )
    far = np.abs(blur) > BLURRED / 2
    kinds: list[Kind] = []
    if far.any():
        still = Smear(np.zeros(2), np.zeros(2))
        sizes = (
            float(slope[far].mean()),
            float(reach[far].mean()),
            BLURRED_OUT,
            float(cutoff[far].mean()),
        )
        kinds.append(
            Kind(
                seen[far],
                np.ones(int(far.sum())),
                *sizes,
                by_sensor[far].mean(axis=0),
                rims[far],
                still,
            )
        )
    near = np.flatnonzero(~far)
    if not len(near):
        return kinds
    unit, wide = float(size[near].mean()), float(reach[near].mean())
    moved_unit = max(unit, float(np.linalg.norm(moved[near], axis=(1, 2)).mean()))
    steep = np.maximum(slope / reach, NO_RIM)
    rim = np.column_stack(
        [rim_light(1 / steep), np.log(steep) / 10]
    )  # what it lets through, and how narrow it is
    maps, movements = by_sensor.reshape(-1, 4) / unit, moved.reshape(-1, 4) / moved_unit
    described = np.column_stack(
        [np.arcsinh(blur), np.log(np.maximum(cutoff, 1e-300)), rim, maps, movements]
    )[near]
    bend = max(1.0, BEND * math.sqrt(float(np.abs(blur[near]).max())))
    pattern = math.hypot(float(np.abs(blur[near]).max()), AIRY / float(cutoff[near].min()))
    allowed = setup.tolerance / largest_change(target, pattern * unit / math.sqrt(2))
    flat, cell = FLAT * allowed, math.sqrt(allowed / (math.pi * bend))
    for node, weights in kind_nodes(described, 4, flat, cell, pixels[near], cost):
        lit = near[weights != 0]
        to_target = node[4:8].reshape(2, 2) * unit
        smear = Smear(*np.linalg.solve(to_target, node[8:].reshape(2, 2).T * moved_unit).T)
        sizes = wide * math.exp(10 * node[3]), wide, math.sinh(node[0]), math.exp(node[1])
        kinds.append(Kind(seen[lit], weights[weights != 0], *sizes, to_target, rims[lit], smear))
    return kinds


def largest_change(target: Target, radius: float) -> float:
    """By how much of white a target's light changes at most, when the logarithm of the pattern's
    size does by 1.

    A disc of light changes by twice the difference of its rim's share on white and its area's. On
    round dots R times as large as it that is at most 1/pi + 0.22 / R from R = 2 on, on black and
    white texels as wide as it or wider 0.64, with the worst at a corner.

    Args:
        target: the target.
        radius: of the pattern, target mm.
    """
    if (
        isinstance(target, FourDot)
        and min(target.diameter / 2, target.spacing - target.diameter) >= LARGE * radius
    ):  # one within it
        return 1 / math.pi + 0.22 * radius / (target.diameter / 2)
    if isinstance(target, Picture) and target.texel >= LARGE * radius:
        return FEW_CORNERS
    return CHANGES[type(target)]


def rim_light(radius: Array) -> Array:
    """Share of a pupil's light, times pi, where the edge of a clipping disc goes through its
    middle; radii count in the pupil's.

    It says how the light of rims of unlike shape differs: from 0 for a small disc to pi/2 for a
    straight edge.
    """
    return np.asarray(two_disc_areas(1.0, radius, radius))


def _movements(motion: Motion, by_motion: Array) -> Array:
    """The whole drift and the vibration's amplitude on the target, mm, shape (N, 2, 2): by row."""
    return np.asarray(np.array([motion.drift, motion.vibration]) @ by_motion.swapaxes(1, 2))


Nodes = list[tuple[Array, Array]]  # points, shape (n,), and everyone's weights for each, (N,)


def kind_nodes(
    described: Array, shared: int, flat: float, cell: float, costs: Array, cost: float
) -> Nodes:
    """Few points between which what is described may be interpolated, and everyone's weights for
    them.

    Args:
        described: numbers that describe each, shape (N, n).
        shared: points may differ in the others and share a table that depends on the first so many.
        flat: numbers that vary by less are taken to be the same for all.
        cell: half the way over which a function of these numbers is straight enough.
        costs: of each at a point for which it has a weight, shape (N,).
        cost: of a point, in the same unit.
    """
    low, high = described.min(axis=0), described.max(axis=0)
    varied = high - low > flat
    found: Nodes = []
    for place, weights in _nodes(
        described[:, varied], int(varied[:shared].sum()), flat, cell, costs, cost
    ):
        point = 0.5 * (low + high)
        point[varied] = place
        found.append((point, weights))
    return found


def _nodes(
    places: Array, shared: int, flat: float, cell: float, costs: Array, cost: float
) -> Nodes:
    """Points for places (N, n): the cheaper of groups of their own, and of interpolation.

    It goes along the longest axis from cell to cell while that is longer than one, and then from
    the middle along every axis.
    """
    if places.shape[1] == 0:
        return [(np.zeros(0), np.ones(len(places)))]
    mean = places.mean(axis=0)
    axes = np.linalg.svd(places - mean, full_matrices=False)[2]
    along = (places - mean) @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    middle, half = mean + 0.5 * (low + high) @ axes, 0.5 * (high - low)
    longest = int(np.argmax(half))
    found: Nodes = []
    if half[longest] > cell:
        for node, share in _hats(along[:, longest], flat, 2 * cell):
            lit = share > 0
            shifted = places[lit] + (node - along[lit, longest])[:, None] * axes[longest]
            for place, weights in _nodes(shifted, shared, flat, cell, costs[lit], cost):
                of_all = np.zeros(len(places))
                of_all[lit] = share[lit] * weights
                found.append((place, of_all))
    else:
        ways = [
            (way, (along[:, way] - 0.5 * (low + high)[way]) / half[way])
            for way in np.flatnonzero(2 * half > flat)
        ]
        rest = 1.0 - sum((weights for _, weights in ways), np.zeros(len(places)))
        found = [
            (middle, rest),
            *((middle + half[way] * axes[way], weights) for way, weights in ways),
        ]
    if len(found) == 1:
        return found
    steps = np.round(
        (places - places.min(axis=0)) / (2 * flat) - 0.25
    )  # what is equal but for rounding stays together
    group = _numbers(steps)
    spent = sum(cost + float(costs[weights != 0].sum()) for _, weights in found)
    if cost * (int(group.max()) + 1) + float(costs.sum()) > spent:
        return found
    means = np.column_stack(
        [_means(places[:, :shared], _numbers(steps[:, :shared])), _means(places[:, shared:], group)]
    )
    members = [group == index for index in range(int(group.max()) + 1)]
    return [(means[int(np.argmax(some))], some.astype(np.float64)) for some in members]


def _numbers(steps: Array) -> Whole:
    """The number of the group of equal rows that each of some is in."""
    return np.asarray(np.unique(steps, axis=0, return_inverse=True)[1].reshape(-1), dtype=np.int64)


def _means(places: Array, group: Whole) -> Array:
    """Each place's group's mean; the same number, to the last digit, for all of a group."""
    sums = np.zeros((int(group.max()) + 1, places.shape[1]))
    np.add.at(sums, group, places)
    return np.asarray((sums / np.bincount(group)[:, None])[group])


def _hats(places: Array, flat: float, cell: float) -> list[tuple[float, Array]]:
    """Nodes along a line, no more than a cell apart where there are places between them, and the
    weights of each for the places (N,).
    """
    order = np.argsort(places, kind="stable")
    found: list[tuple[float, Array]] = []
    for members in np.split(order, np.flatnonzero(np.diff(places[order]) > cell) + 1):
        low, high = float(places[members[0]]), float(places[members[-1]])
        count = math.ceil((high - low) / cell) + 1 if high - low > flat else 1
        nodes = np.linspace(low, high, count) if count > 1 else np.array([0.5 * (low + high)])
        apart = (
            np.abs(places[members, None] - nodes) / (nodes[1] - nodes[0])
            if count > 1
            else np.zeros((len(members), 1))
        )
        for index, node in enumerate(nodes):
            weights = np.zeros(len(places))
            weights[members] = np.maximum(1 - apart[:, index], 0.0)
            weights[weights < 1e-9] = 0.0
            if weights.any():
                found.append((float(node), weights))
    return found
