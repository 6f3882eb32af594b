"""All rays from one pixel through one microlens, cut into slices, each summed exactly but for
Gauss's rule.

Four coordinates say where a ray crosses sensor and microlens: two along a direction u, two across
it. A slice keeps the latter; what is left of pixel, microlens and main-lens stop in it is a polygon
of the former. Lines through the polygon sum it: between the corners and the places where borders of
the targets cross its sides, their light changes smoothly from line to line.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.scene import Scene
from reference_rays.lines import (
    Lines,
    border_cuts,
    light_along,
    lines_between,
    order_across,
)
from reference_rays.rays import Bundle, Path, landing

Array = npt.NDArray[np.float64]
Interval = tuple[Array, Array]

# rad; u lies under this angle to the target's axes, so that none of its borders lies along it
OBLIQUE = 0.6


@dataclass(frozen=True)
class Slices:
    """N slices; in each a ray is at (sigma, rho) from -1 to 1, shares of half the chord of the
    pixel and of the microlens.

    Attributes:
        bundle: what is sliced.
        aside: where the slices lie across u on the sensor from the pixel's centre, mm.
        middle: middle of the pixel's chord along u.
        half: half of it.
        lens_aside: where the slices lie across u on the microlens from its centre.
        lens_middle: middle of the microlens's chord along u, or of what the stop can leave of it.
        lens_half: half of that.
        crossing: where (0, 0) crosses the main lens along u.
        stop: half the chord of the main lens's stop.
        weight: what a slice's area in (sigma, rho) counts, mm^4.
        moved: how far the targets have moved, world mm, shape (N, 2).
    """

    bundle: Bundle
    aside: Array
    middle: Array
    half: Array
    lens_aside: Array
    lens_middle: Array
    lens_half: Array
    crossing: Array
    stop: Array
    weight: Array
    moved: Array

    @property
    def by_sigma(self) -> Array:
        """How far a ray moves on the main lens per unit of sigma, mm."""
        return self.bundle.by_sensor * self.half

    @property
    def by_rho(self) -> Array:
        """The same per unit of rho."""
        return self.bundle.by_lens * self.lens_half

    def lines(
        self, which: npt.NDArray[np.int64], start: tuple[Array, Array], end: tuple[Array, Array]
    ) -> Lines:
        """Lines from one (sigma, rho) to another in slices of these indices."""
        along, across = (
            self.bundle.along[:, None],
            np.array([[-self.bundle.along[1]], [self.bundle.along[0]]]),
        )

        def places(at: tuple[Array, Array]) -> tuple[Array, Array]:
            sensor, lens = (
                self.middle[which] + self.half[which] * at[0],
                self.lens_middle[which] + self.lens_half[which] * at[1],
            )
            return (
                (self.bundle.place[:, None] + along * sensor + across * self.aside[which]).T,
                (
                    self.bundle.path.centre[:, None]
                    + along * lens
                    + across * self.lens_aside[which]
                ).T,
            )

        return lines_between(self.bundle.path, places(start), places(end), self.moved[which])


def bundle_of(scene: Scene, path: Path, place: Array) -> Bundle:
    """The rays from a pixel through a microlens, with a direction u that suits the scene's nearest
    target.
    """
    angle = scene.planes[0].roll + OBLIQUE
    return Bundle(scene.camera, path, place, np.array([math.cos(angle), math.sin(angle)]))


def slices_of(bundle: Bundle, points: Array, moved: Array) -> Slices:
    """Slices that together stand for the bundle: the mean of their sums is its sum.

    Args:
        bundle: the rays.
        points: which slices, from the unit square, shape (N, 2).
        moved: how far the targets have moved for each, world mm, shape (N, 2).
    """
    along, across = bundle.along, np.array([-bundle.along[1], bundle.along[0]])
    pixel, stop = (
        np.full(len(points), bundle.camera.sensor.pixel / 2),
        np.full(len(points), bundle.camera.main_lens.aperture / 2),
    )
    lens = np.full(len(points), bundle.camera.array.aperture / 2)
    aside = pixel * _through_square(along, points[:, 0])
    middle, half = _common(
        _within(aside * across[0], along[0], pixel), _within(aside * across[1], along[1], pixel)
    )
    stop_aside = bundle.crossing @ across + bundle.by_sensor * aside
    lens_middle, lens_half = _common((-lens, lens), _within(stop_aside, bundle.by_lens, stop))
    lens_aside = np.clip(lens_middle - lens_half * np.cos(np.pi * points[:, 1]), -lens, lens)
    density = lens_half * np.pi * np.sin(np.pi * points[:, 1])
    chord = np.sqrt(lens**2 - lens_aside**2)
    stop_chord = np.sqrt(np.maximum(stop**2 - (stop_aside + bundle.by_lens * lens_aside) ** 2, 0))
    crossing = bundle.crossing @ along + bundle.by_sensor * middle
    shadow = _within(crossing, bundle.by_lens, stop_chord + abs(bundle.by_sensor) * half)
    lens_middle, lens_half = _common((-chord, chord), shadow)
    return Slices(
        bundle=bundle,
        aside=aside,
        middle=middle,
        half=half,
        lens_aside=lens_aside,
        lens_middle=lens_middle,
        lens_half=lens_half,
        crossing=crossing + bundle.by_lens * lens_middle,
        stop=stop_chord,
        weight=2 * pixel**2 * density * lens_half,
        moved=moved,
    )


def sums_of(scene: Scene, slices: Slices) -> Array:
    """Sum of the light of all rays in each slice, mm^4, shape (N,)."""
    towards = _stay(scene, slices)
    every = np.arange(len(slices.aside))
    offsets = np.zeros((len(every), 0))
    for start, end in _sides(slices):
        side = slices.lines(every, start, end)
        shares = [
            np.tile(np.array([0.0, 1.0]), (len(every), 1)),
            *(border_cuts(scene, plane, side) for plane in scene.planes),
        ]
        share = np.concatenate(shares, axis=1)
        sigma, rho = (
            (1 - share) * one[:, None] + share * other[:, None]
            for one, other in zip(start, end, strict=True)
        )
        offsets = np.concatenate(
            [offsets, towards[0][:, None] * rho - towards[1][:, None] * sigma], axis=1
        )
    offsets = np.sort(offsets, axis=1)
    which, piece = np.nonzero(np.diff(offsets, axis=1) > 1e-13)
    low, width = offsets[which, piece], np.diff(offsets, axis=1)[which, piece]
    nodes, weights = np.polynomial.legendre.leggauss(order_across(scene))
    offset = (low[:, None] + width[:, None] * (nodes + 1) / 2).ravel()
    share = (width[:, None] * weights / 2).ravel()
    which = np.repeat(which, len(nodes))
    sigma, rho = -towards[1][which] * offset, towards[0][which] * offset
    start, end = _inside(
        slices, which, (sigma, rho), (towards[0][which], towards[1][which]), stopped=True
    )
    light = light_along(scene, slices.lines(which, start, end))
    length = np.hypot(end[0] - start[0], end[1] - start[1])
    return slices.weight * np.bincount(which, share * length * light, minlength=len(every))


def _stay(scene: Scene, slices: Slices) -> tuple[Array, Array]:
    """The direction in (sigma, rho), of length 1, in which the nearest target's point that a ray
    sees stays the same.
    """
    bundle, path = slices.bundle, slices.bundle.path

    def seen(place: Array, lens: Array) -> Array:
        _, crossing, slope = path.slopes_and_crossing(place, lens)
        return landing(scene.planes[0], None, crossing, slope, np.zeros(2))

    here = seen(bundle.place, path.centre)
    by_sensor = seen(bundle.place + 1e-3 * bundle.along, path.centre) - here
    by_lens = seen(bundle.place, path.centre + 1e-3 * bundle.along) - here
    larger = by_sensor if np.abs(by_sensor).max() > np.abs(by_lens).max() else by_lens
    sigma, rho = (
        float(by_lens @ larger) * slices.lens_half,
        -float(by_sensor @ larger) * slices.half,
    )
    length = np.hypot(sigma, rho)
    return np.where(length > 0, sigma, 1.0) / np.where(length > 0, length, 1.0), rho / np.where(
        length > 0, length, 1.0
    )


def _sides(slices: Slices) -> list[tuple[tuple[Array, Array], tuple[Array, Array]]]:
    """The sides of the polygons, each from one (sigma, rho) to another; both the same where a
    polygon lacks this side.
    """
    every = np.arange(len(slices.aside))
    one, zero = np.ones(len(every)), np.zeros(len(every))
    sides = [
        _inside(slices, every, (sign * one, zero), (zero, one), stopped=True) for sign in (-1, 1)
    ]
    sides += [
        _inside(slices, every, (zero, sign * one), (one, zero), stopped=True) for sign in (-1, 1)
    ]
    steep = np.hypot(slices.by_sigma, slices.by_rho)
    steep = np.where(steep > 0, steep, 1.0)
    sigma, rho = slices.by_sigma / steep, slices.by_rho / steep
    for sign in (-1, 1):
        away = (sign * slices.stop - slices.crossing) / steep
        sides.append(
            _inside(slices, every, (away * sigma, away * rho), (-rho, sigma), stopped=False)
        )
    return sides


def _inside(
    slices: Slices,
    which: npt.NDArray[np.int64],
    origin: tuple[Array, Array],
    direction: tuple[Array, Array],
    *,
    stopped: bool,
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """The part of lines in slices of these indices that lies in the square and, where ``stopped``,
    passes the stop.
    """
    one = np.ones(len(which))
    low, high = _both(_within(origin[0], direction[0], one), _within(origin[1], direction[1], one))
    if stopped:
        value = (
            slices.crossing[which]
            + slices.by_sigma[which] * origin[0]
            + slices.by_rho[which] * origin[1]
        )
        slope = slices.by_sigma[which] * direction[0] + slices.by_rho[which] * direction[1]
        low, high = _both((low, high), _within(value, slope, slices.stop[which]))
    middle, half = _common((low, high), (low, high))
    ends = [
        tuple(start + at * step for start, step in zip(origin, direction, strict=True))
        for at in (middle - half, middle + half)
    ]
    return (ends[0][0], ends[0][1]), (ends[1][0], ends[1][1])


def _through_square(direction: Array, points: Array) -> Array:
    """How far beside the middle of the square from -1 to 1 lines of a direction lie that all stand
    for the same area of it.
    """
    narrow, wide = np.sort(np.abs(direction))
    from_middle = np.abs(2 * points - 1)
    flank = wide + narrow - np.sqrt(4 * (1 - from_middle) * wide * narrow)
    return np.where(from_middle * wide <= wide - narrow, from_middle * wide, flank) * np.sign(
        2 * points - 1
    )


def _within(value: Array, slope: float | Array, limit: Array) -> Interval:
    """The interval of t in which |value + slope t| <= limit; from inf to -inf where there is
    none.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        one, other = (-limit - value) / slope, (limit - value) / slope
    even = np.broadcast_to(np.asarray(slope) == 0, value.shape)
    inside = np.abs(value) <= limit
    low = np.where(even, np.where(inside, -np.inf, np.inf), np.minimum(one, other))
    high = np.where(even, np.where(inside, np.inf, -np.inf), np.maximum(one, other))
    return low, high


def _both(one: Interval, other: Interval) -> Interval:
    return np.maximum(one[0], other[0]), np.minimum(one[1], other[1])


def _common(one: Interval, other: Interval) -> Interval:
    """Middle and half the length of what two intervals have in common; 0 and 0 where that is
    nothing.
    """
    low, high = _both(one, other)
    some = (low < high) & np.isfinite(low) & np.isfinite(high)
    low, high = np.where(some, low, 0.0), np.where(some, high, 0.0)
    return (low + high) / 2, (high - low) / 2
