"""Straight lines of rays from one pixel through one microlens, and the light that comes along them.

A ray is a point in four dimensions, where it crosses sensor and microlens; along a line in them both places move evenly.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.scene import Plane, Scene
from flflab.image.target_borders import crossings
from flflab.image.traced_rays import Path, covers, landing
from flflab.targets import Bars, Chirp, FourDot, Picture

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Lines:
    """N lines; a ray is at a fraction of its line from 0 to 1. Places are world mm of shape (N, 2).

    Attributes:
        path: through the microlens.
        sensor: where they start on the sensor.
        to_sensor: where they end on the sensor.
        lens: where they start on the microlens.
        to_lens: where they end on the microlens.
        moved: how far the targets have moved meanwhile.
    """

    path: Path
    sensor: Array
    to_sensor: Array
    lens: Array
    to_lens: Array
    moved: Array

    def of(self, which: npt.NDArray[np.int64]) -> "Lines":
        """The lines of these indices, any number of times each."""
        return Lines(self.path, self.sensor[which], self.to_sensor[which], self.lens[which], self.to_lens[which], self.moved[which])

    def at(self, fractions: Array) -> tuple[Array, Array]:
        """Where the rays at fractions of shape (N, ...) cross sensor and microlens, shape (N, ..., 2)."""
        share = fractions[..., None]
        ends = (self.sensor, self.to_sensor, self.lens, self.to_lens)
        sensor, to_sensor, lens, to_lens = (end.reshape(len(end), *(1,) * (fractions.ndim - 1), 2) for end in ends)
        return (1 - share) * sensor + share * to_sensor, (1 - share) * lens + share * to_lens


def light_along(scene: Scene, lines: Lines) -> Array:
    """Mean light of the rays of each line: what they see on the targets, by the natural fall-off where the scene has it; shape (N,)."""
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
        seen /= (1 + np.sum(lines.path.slope_at_sensor(*pieces.at(fractions)) ** 2, axis=-1)) ** 2
    light = np.zeros(len(lines.moved))
    np.add.at(light, which, length * (seen @ weights) / 2)
    return light


def border_cuts(scene: Scene, plane: Plane, lines: Lines) -> Array:
    """Fractions of the lines where their rays cross borders on a plane, shape (N, K) in no order; 1 for none."""
    ends = np.tile(np.array([0.0, 1.0]), (len(lines.moved), 1))
    places = _land(scene, plane, lines, ends)
    if _is_a_point(plane):
        return ends[:, :0]
    start, way = places[:, 0], places[:, 1] - places[:, 0]
    wanted = crossings(plane, start, places[:, 1])
    wanted = np.where((wanted > 0) & (wanted < 1), wanted, 1.0)
    if _is_even(scene, plane):
        return wanted
    fractions = wanted
    for _ in range(8):
        reached = _land(scene, plane, lines, fractions) - start[:, None]
        share = np.sum(reached * way[:, None], axis=-1) / np.maximum(np.sum(way**2, axis=-1), 1e-300)[:, None]
        better = np.clip(fractions + wanted - share, 0, 1)
        if np.abs(better - fractions).max(initial=0.0) < 1e-12:
            break
        fractions = better
    return fractions


def order_across(scene: Scene) -> int:
    """Points of Gauss's rule that leave less than 1e-9 between two borders, from line to line."""
    return 6 if any(isinstance(plane.target, Chirp) for plane in scene.planes) else _order_along(scene)


def _order_along(scene: Scene) -> int:
    """The same along a line. Where rays land evenly and count the same, lines keep to one point of the only target."""
    even = scene.falloff is None and all(_is_even(scene, plane) for plane in scene.planes) and len(scene.planes) == 1
    return 1 if even else 4


def _is_even(scene: Scene, plane: Plane) -> bool:
    """Whether evenly spaced rays land evenly spaced on a plane."""
    return scene.distortion is None and not any(plane.tilt)


def _is_a_point(plane: Plane) -> bool:
    """Whether the target stands at infinity and has a size in mm: it is a point, and black."""
    return math.isinf(plane.distance) and isinstance(plane.target, FourDot | Bars | Picture)


def _land(scene: Scene, plane: Plane, lines: Lines, fractions: Array) -> Array:
    on_sensor, on_lens = lines.at(fractions)
    main, slope = lines.path.on_main_lens(on_sensor, on_lens), lines.path.object_slope(on_sensor, on_lens)
    moved = lines.moved.reshape(len(lines.moved), *(1,) * (fractions.ndim - 1), 2)
    return landing(plane, scene.distortion, main, slope, moved)
