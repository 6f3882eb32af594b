"""The measurement area: points that enough micro-images of a row see, each of them sharply;
polygons with exact corners.

In the plane of (V, w), vergence and height times vergence, every ray is a straight line w = m V +
(m c - q/L): so are the edges of all fields, and the same corners joined by straight lines are the
area in (z, y) = (-1/V, w/V). V = 0 is infinity, V < 0 is cut off. Source: paper, "Stereo and
multistereovision" and "Depth of field", Figs. 5 and 6. Lengths in mm.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from flflab.optics.boundary import useful_rays
from flflab.optics.camera import Camera
from flflab.optics.focus import Interval, depth_of_field, merge_intervals
from flflab.optics.smms import Smms
from flflab.optics.useful import row_fields, select

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Rule = Literal["total", "chief"]
# A target touches no lens: nearer than a millionth of the focal length nothing is looked at.
NEAREST = 1e-6


@dataclass(frozen=True)
class MeasurementArea:
    """Where enough micro-images of the row see a point sharply.

    Attributes:
        polygons: corners (V, w) of disjoint polygons, each of shape (K, 2): vergence in 1/mm,
            height times vergence.
        reason: why there is none; empty where there is one.
    """

    polygons: tuple[Array, ...]
    reason: str

    def corners(self) -> tuple[Array, ...]:
        """The same corners as (z, y) in mm, the target in front of the main lens at z < 0; infinite
        where V = 0.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return tuple(np.stack([-1 / part[:, 0],
            np.nan_to_num(part[:, 1] / part[:, 0], nan=0.0, posinf=np.inf, neginf=-np.inf)], axis=1)
                         for part in self.polygons)  # fmt: skip

    def size(self) -> float:
        """The area in mm^2; infinite where it reaches infinity."""
        total = 0.0
        for part in self.polygons:
            if np.any(part[:, 0] == 0):
                return math.inf
            z, y = -1 / part[:, 0], part[:, 1] / part[:, 0]
            z = z - z.mean()
            total += abs(float(np.sum(z * np.roll(y, -1) - np.roll(z, -1) * y))) / 2
        return total


@dataclass(frozen=True)
class _Edges:
    """Lower and upper edge of what each system sees as lines slope * V + height; all of shape
    (n,).
    """

    low_slope: Array
    low: Array
    high_slope: Array
    high: Array
    active: Flags


def sharp_ranges(smms: Smms, circle: float, nearest: float) -> list[list[Interval]]:
    """Depth of field of each system (fields of shape (n,)) as vergence intervals, from infinity to
    ``nearest`` mm.
    """
    known: dict[tuple[float, ...], list[Interval]] = {}
    found: list[list[Interval]] = []
    for index in range(len(smms.focal)):
        one = select(smms, np.asarray(index))
        key = tuple(float(part) for part in (one.focal, one.distance, one.gap, one.aperture))
        if key not in known:
            known[key] = [
                (low, min(high, 1 / nearest))
                for low, high in depth_of_field(one, circle)
                if low < 1 / nearest
            ]
        found.append(known[key])
    return found


def measurement_area(
    camera: Camera,
    by: Rule = "total",
    views: int = 2,
    circle: float | None = None,
    *,
    anywhere: bool = False,
) -> MeasurementArea:
    """Points of the plane of the row (nearest the axis) that at least ``views`` of its micro-images
    see inside their depths of field.

    Args:
        camera: the camera.
        by: "total", some useful ray (the paper's, by useful chief rays), or "chief", the ray
            through the limiting stop's centre.
        views: least number of micro-images.
        circle: permitted blur on the sensor, mm; one pixel unless told.
        anywhere: leave depth of field out (the paper's Fig. 5).
    """
    row = row_fields(camera)
    lit = np.flatnonzero(~np.isnan(row.useful[:, 0]))
    if len(lit) < views:
        return MeasurementArea(
            (), f"fewer than {views} micro-images of the row have a useful interval"
        )
    smms, useful = select(row.smms, lit), row.useful[lit]
    nearest = NEAREST * camera.main_lens.focal_length
    everywhere: list[Interval] = [(0.0, 1 / nearest)]
    ranges = (
        [everywhere] * len(lit)
        if anywhere
        else sharp_ranges(smms, circle or camera.sensor.pixel, nearest)
    )
    lines = _total_lines(smms, useful) if by == "total" else None
    chains = _Chains()
    for first, last in _slabs(smms, ranges, lines):
        middle = (first + last) / 2
        sharp = np.array([any(low <= middle <= high for low, high in one) for one in ranges])
        edges = (
            _outermost(lines, middle) if lines is not None else _chief_edges(smms, useful, middle)
        )
        _cover(edges, edges.active & sharp, first, last, views, chains)
    polygons = chains.finished()
    reason = ""
    if not polygons:
        blind = (
            "no micro-image is sharp at a real distance"
            if not any(ranges)
            else f"no sharp point is seen by {views} micro-images"
        )
        reason = f"{blind} of the row"
    return MeasurementArea(polygons, reason)


def _total_lines(smms: Smms, useful: Array) -> tuple[Array, Array, Flags]:
    """Slopes, heights and existence of the lines of all vertices of the useful light, shape (n,
    12).
    """
    rays = useful_rays(smms, useful)
    return rays.main_lens, rays.object_slope, rays.exists


def _outermost(lines: tuple[Array, Array, Flags], vergence: float) -> _Edges:
    slope, height, exists = lines
    at = slope * vergence + height
    each = np.arange(len(slope))
    low, high = (
        np.where(exists, at, np.inf).argmin(axis=1),
        np.where(exists, at, -np.inf).argmax(axis=1),
    )
    return _Edges(
        slope[each, low],
        height[each, low],
        slope[each, high],
        height[each, high],
        np.count_nonzero(exists, axis=1) > 0,
    )


def _chief_edges(smms: Smms, useful: Array, vergence: float) -> _Edges:
    """The object points whose chief rays land in the useful interval; see ``views`` for the chief
    ray.
    """
    bend = 1 / smms.distance - 1 / smms.lens_focal
    x = smms.distance * (vergence + bend)
    by_microlens = smms.aperture < smms.lens_aperture * np.abs(x)
    centre = smms.centre_x * smms.image_scale
    half = smms.lens_aperture / 2
    m = np.clip(
        (centre[:, None] - useful) * (smms.distance / smms.gap)[:, None],
        -half[:, None],
        half[:, None],
    )
    kappa = smms.kappa[:, None]
    q = (useful - (smms.gap / smms.focal * smms.centre_x)[:, None]) / np.where(
        kappa == 0, 1.0, kappa
    )
    edge = smms.centre_x[:, None] + smms.aperture[:, None] / 2 * np.array([-1.0, 1.0])
    q = np.where(kappa == 0, edge, np.clip(np.sort(q, axis=1), edge[:, :1], edge[:, 1:]))
    slope = np.where(by_microlens[:, None], m, 0.0)
    height = np.where(
        by_microlens[:, None],
        m * bend[:, None] - (smms.centre_x / smms.distance)[:, None],
        -q / smms.distance[:, None],
    )
    order = np.argsort(slope * vergence + height, axis=1)
    slope, height = (
        np.take_along_axis(slope, order, axis=1),
        np.take_along_axis(height, order, axis=1),
    )
    return _Edges(
        slope[:, 0], height[:, 0], slope[:, 1], height[:, 1], np.ones(len(slope), dtype=np.bool_)
    )


def _slabs(
    smms: Smms, ranges: list[list[Interval]], lines: tuple[Array, Array, Flags] | None
) -> list[Interval]:
    """Vergence ranges in which every system's edges are one line each and its depth of field is on
    or off throughout.
    """
    whole = merge_intervals([part for one in ranges for part in one])
    if lines is None:
        bend = 1 / smms.lens_focal - 1 / smms.distance
        turn = smms.aperture / smms.lens_aperture / smms.distance
        kinks = np.concatenate([bend - turn, bend, bend + turn])
    else:
        slope, height, _ = lines
        a, b = np.triu_indices(slope.shape[1], 1)
        kinks = _crossings(slope[:, a] - slope[:, b], height[:, b] - height[:, a])
    ends = np.array([end for one in ranges for part in one for end in part])
    cuts = _distinct(np.concatenate([kinks, ends]))
    slabs: list[Interval] = []
    for low, high in whole:
        inner = cuts[(cuts > low) & (cuts < high)]
        marks = [low, *inner.tolist(), high]
        slabs += [(first, last) for first, last in itertools.pairwise(marks) if last > first]
    return slabs


def _crossings(slope: Array, height: Array) -> Array:
    """Where slope * V = height for lines that are not parallel, flat."""
    steep = slope != 0
    return height[steep] / slope[steep]


def _distinct(values: Array) -> Array:
    """Rising values, those within roundoff of one another once."""
    values = np.unique(values[np.isfinite(values)])
    if len(values) == 0:
        return values
    return values[np.concatenate([[True], np.diff(values) > 1e-12 * np.abs(values[1:])])]


class _Chains:
    """Trapezoids between parallel lines of constant V, joined where one continues another."""

    def __init__(self) -> None:
        self._open: list[tuple[list[tuple[float, float]], list[tuple[float, float]]]] = []
        self._done: list[Array] = []

    def add(
        self, first: float, last: float, pieces: list[tuple[float, float, float, float]]
    ) -> None:
        """Add the pieces (low and high at ``first``, low and high at ``last``) of one slab."""
        carried: list[tuple[list[tuple[float, float]], list[tuple[float, float]]]] = []
        for low0, high0, low1, high1 in pieces:
            near = 1e-9 * (abs(low0) + abs(high0)) + 1e-15
            for chain in self._open:
                (v, low), (_, high) = chain[0][-1], chain[1][-1]
                if v == first and abs(low - low0) <= near and abs(high - high0) <= near:
                    self._open.remove(chain)
                    break
            else:
                chain = ([(first, low0)], [(first, high0)])
            chain[0].append((last, low1))
            chain[1].append((last, high1))
            carried.append(chain)
        self._close()
        self._open = carried

    def _close(self) -> None:
        self._done += [_polygon(low, high) for low, high in self._open]
        self._open = []

    def finished(self) -> tuple[Array, ...]:
        """All polygons."""
        self._close()
        return tuple(self._done)


def _polygon(low: list[tuple[float, float]], high: list[tuple[float, float]]) -> Array:
    """One polygon from its lower and upper edge, without the corners that lie on a straight
    line.
    """
    sides = []
    for side in (low, high):
        points = np.array(side)
        keep = np.ones(len(points), dtype=np.bool_)
        for i in range(1, len(points) - 1):
            before, here, after = points[i - 1], points[i], points[i + 1]
            share = (here[0] - before[0]) / (after[0] - before[0])
            keep[i] = abs(before[1] + share * (after[1] - before[1]) - here[1]) > 1e-12 * (
                np.abs(points[:, 1]).max() + 1e-300
            )
        sides.append(points[keep])
    corners = np.concatenate([sides[0], sides[1][::-1]])
    same = np.all(np.isclose(corners, np.roll(corners, 1, axis=0), rtol=1e-12, atol=1e-15), axis=1)
    return corners[~same]


def _cover(
    edges: _Edges, active: Flags, first: float, last: float, views: int, chains: _Chains
) -> None:
    """Add what at least ``views`` of the active systems see between two vergences, cut wherever two
    edges cross.
    """
    slope = np.concatenate([edges.low_slope[active], edges.high_slope[active]])
    height = np.concatenate([edges.low[active], edges.high[active]])
    step = np.repeat([1, -1], int(active.sum()))
    if int(active.sum()) < views:
        return
    a, b = np.triu_indices(len(slope), 1)
    cuts = _distinct(_crossings(slope[a] - slope[b], height[b] - height[a]))
    marks = [
        first,
        *cuts[(cuts > first * (1 + 1e-12)) & (cuts < last * (1 - 1e-12))].tolist(),
        last,
    ]
    for low, high in itertools.pairwise(marks):
        order = np.argsort(slope * ((low + high) / 2) + height, kind="stable")
        depth = np.cumsum(step[order])
        starts = order[np.flatnonzero((depth >= views) & (depth - step[order] < views))]
        ends = order[np.flatnonzero((depth < views) & (depth - step[order] >= views))]
        chains.add(low, high, [
            (float(slope[i] * low + height[i]), float(slope[j] * low + height[j]),
             float(slope[i] * high + height[i]), float(slope[j] * high + height[j]))
            for i, j in zip(starts, ends, strict=True)
        ])  # fmt: skip
