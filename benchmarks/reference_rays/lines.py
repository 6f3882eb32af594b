"""Straight lines of rays from one pixel through one microlens, and the light that comes along them.

A ray is a point in four dimensions, where it crosses sensor and microlens; along a line in them
both places move evenly.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.scene import Plane, Scene
from flflab.targets import Bars, Chirp, FourDot, Picture
from reference_rays.borders import crossings
from reference_rays.rays import Path, covers, landing, squared

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Lines:
    """N lines; a ray is at a fraction of its line from 0 to 1, and what thin lenses make of it
    changes evenly. Shapes (N, 2).

    Attributes:
        behind: slope between microlens and sensor where they start, and how much it changes to
            their ends.
        crossing: where the rays cross the main lens, mm, in the same way.
        before: their slopes before it.
        moved: how far the targets have moved meanwhile, mm.
    """

    behind: tuple[Array, Array]
    crossing: tuple[Array, Array]
    before: tuple[Array, Array]
    moved: Array

    def of(self, which: npt.NDArray[np.int64]) -> "Lines":
        """The lines of these indices, any number of times each."""
        behind, crossing, before = (
            (start[which], change[which])
            for start, change in (self.behind, self.crossing, self.before)
        )
        return Lines(behind, crossing, before, self.moved[which])


def lines_between(
    path: Path, start: tuple[Array, Array], end: tuple[Array, Array], moved: Array
) -> Lines:
    """Lines from rays that cross sensor and microlens at these places, each of shape (N, 2), to
    others.
    """
    starts, ends = path.slopes_and_crossing(*start), path.slopes_and_crossing(*end)
    behind, crossing, before = ((one, other - one) for one, other in zip(starts, ends, strict=True))
    return Lines(behind, crossing, before, moved)


def light_along(scene: Scene, lines: Lines) -> Array:
    """Mean light of the rays of each line: what they see on the targets, by the natural fall-off
    where the scene has it; shape (N,).
    """
    cuts = [np.broadcast_to(np.array([0.0, 1.0]), (len(lines.moved), 2))]
    cuts += [border_cuts(scene, plane, lines) for plane in scene.planes]
    edges = np.sort(np.concatenate(cuts, axis=1), axis=1)
    which, piece = np.nonzero(np.diff(edges, axis=1) > 0)
    pieces, length = lines.of(which), edges[which, piece + 1] - edges[which, piece]
    nodes, weights = np.polynomial.legendre.leggauss(_order_along(scene))
    fractions = edges[which, piece][:, None] + length[:, None] * (nodes + 1) / 2
    seen = np.zeros(fractions.shape)
    free = np.ones(fractions.shape, dtype=bool)
    for plane in scene.planes:
        place = _land(scene, plane, pieces, fractions)
        here = free & covers(plane, place)
        if not _is_a_point(plane):
            seen += np.where(here, plane.target.radiance(place[..., 0], place[..., 1]), 0.0)
        free &= ~here
    if scene.falloff is not None:
        seen /= (1 + squared(_at(pieces.behind, fractions))) ** 2
    return np.asarray(
        np.bincount(which, length * (seen @ weights) / 2, minlength=len(lines.moved)),
        dtype=np.float64,
    )


def border_cuts(scene: Scene, plane: Plane, lines: Lines) -> Array:
    """Fractions of the lines where their rays cross borders on a plane, shape (N, K) in no order; 1
    for none.
    """
    ends = np.tile(np.array([0.0, 1.0]), (len(lines.moved), 1))
    places = _land(scene, plane, lines, ends)
    if _is_a_point(plane):
        return ends[:, :0]
    start, way = places[:, 0], places[:, 1] - places[:, 0]
    wanted = crossings(plane, start, places[:, 1])
    wanted = np.where((wanted > 0) & (wanted < 1), wanted, 1.0)
    if _is_even(scene, plane):
        return wanted
    crossed = np.nonzero(wanted < 1)
    which = crossed[0]
    on_line, asked, scale = (
        lines.of(which),
        wanted[crossed],
        np.maximum(squared(way), 1e-300)[which],
    )
    fractions = asked
    for _ in range(8):
        reached = _land(scene, plane, on_line, fractions) - start[which]
        better = np.clip(
            fractions
            + asked
            - (reached[:, 0] * way[which, 0] + reached[:, 1] * way[which, 1]) / scale,
            0,
            1,
        )
        if np.abs(better - fractions).max(initial=0.0) < 1e-12:
            break
        fractions = better
    wanted[crossed] = fractions
    return wanted


def order_across(scene: Scene) -> int:
    """Points of Gauss's rule that leave less than 1e-9 between two borders, from line to line."""
    return (
        6 if any(isinstance(plane.target, Chirp) for plane in scene.planes) else _order_along(scene)
    )


def _order_along(scene: Scene) -> int:
    """The same along a line. Where rays land evenly and count the same, lines keep to one point of
    the only target.
    """
    even = (
        scene.falloff is None
        and all(_is_even(scene, plane) for plane in scene.planes)
        and len(scene.planes) == 1
    )
    return 1 if even else 4


def _is_even(scene: Scene, plane: Plane) -> bool:
    """Whether evenly spaced rays land evenly spaced on a plane."""
    return scene.distortion is None and not any(plane.tilt)


def _is_a_point(plane: Plane) -> bool:
    """Whether the target stands at infinity and has a size in mm: it is a point, and black."""
    return math.isinf(plane.distance) and isinstance(plane.target, FourDot | Bars | Picture)


def _land(scene: Scene, plane: Plane, lines: Lines, fractions: Array) -> Array:
    moved = lines.moved.reshape(len(lines.moved), *(1,) * (fractions.ndim - 1), 2)
    return landing(
        plane, scene.distortion, _at(lines.crossing, fractions), _at(lines.before, fractions), moved
    )


def _at(along: tuple[Array, Array], fractions: Array) -> Array:
    """What starts so and changes by so much, shapes (N, 2), at fractions of shape (N, ...).

    Neighbours in memory are lines, not the two coordinates: loops over many are quick, and over two
    they are not.
    """
    start, change = (
        np.asfortranarray(one).reshape(len(one), *(1,) * (fractions.ndim - 1), 2) for one in along
    )
    return start + np.asfortranarray(fractions)[..., None] * change
