"""Boundary chief rays and useful chief rays: the edges of what one SMMS sees, on the sensor and on
the object side.

A ray is (m, q), where it crosses the main lens and the microlens plane. All light of an SMMS is the
rectangle |m| <= A/2,
|q - y| <= d/2; its corners are the boundary rays, and the strip of rays that land in the useful interval cuts it. On the object
side a ray is the straight line o = m + D (m c - q/L) with c = 1/L - 1/F, or o V = m W - q/L: finite
at infinity too. Lengths in mm. Source: paper, "Chief rays and useful chief rays", Figs. 2 to 4.
"""  # noqa: E501

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.optics.smms import Smms, array_vergence, object_crossing, sensor_crossing

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

BOUNDARY_NAMES = ("parallel upper", "parallel lower", "diagonal upper", "diagonal lower")
_LENS = np.array([1.0, -1.0, 1.0, -1.0])
_MICROLENS = np.array([1.0, -1.0, -1.0, 1.0])
_SLACK = 64 * np.finfo(np.float64).eps


@dataclass(frozen=True)
class Rays:
    """Rays of SMMSs of shape (...); every field has shape (..., K).

    Attributes:
        main_lens: where they cross the main lens, mm.
        microlens: where they cross the microlens plane, mm.
        sensor: where they land, mm.
        object_slope: slope of the object-side line, o = main_lens + distance * object_slope.
        exists: whether the ray is one; a useful ray is not where the edge of the useful interval
            does not cut that stop's edge.
    """

    main_lens: Array
    microlens: Array
    sensor: Array
    object_slope: Array
    exists: Flags


@dataclass(frozen=True)
class ObjectFields:
    """What SMMSs see in an object plane, as intervals of o V (height times vergence; the angle at
    infinity), shape (..., 2).

    Attributes:
        bright: between the inside boundary rays: the full cone passes.
        total: between the outside boundary rays: some light passes.
        useful_bright: the full cone passes and lands in the useful interval; nan where nothing
            does.
        useful_total: some light lands in the useful interval; nan where there is no such interval.
    """

    bright: Array
    total: Array
    useful_bright: Array
    useful_total: Array


def _as_column(smms: Smms) -> Smms:
    return Smms(
        **{name: np.asarray(getattr(smms, name))[..., None] for name in Smms.__dataclass_fields__}
    )


def _rays(smms: Smms, m: Array, q: Array, exists: Flags) -> Rays:
    """Rays from their crossings; ``smms`` has the same leading shape and a last axis of 1."""
    m, q = np.broadcast_arrays(m, q)
    slope = m * (1 / smms.distance - 1 / smms.lens_focal) - q / smms.distance
    return Rays(m, q, sensor_crossing(smms, m, q, smms.centre_x), slope, exists)


def boundary_rays(smms: Smms) -> Rays:
    """The four boundary chief rays of each SMMS along x, in the order of ``BOUNDARY_NAMES`` (upper
    and lower edge of the main lens).

    Parallel rays pass edges on the same side of main lens and microlens, diagonal ones on opposite
    sides.

    Args:
        smms: systems, fields of shape (...).

    Returns:
        Rays of shape (..., 4).
    """
    column = _as_column(smms)
    m = column.lens_aperture / 2 * _LENS
    q = column.centre_x + column.aperture / 2 * _MICROLENS
    return _rays(column, m, q, np.ones(np.broadcast_shapes(m.shape, q.shape), dtype=np.bool_))


def parallel_are_inside(smms: Smms, vergence: Array | float | None = None) -> Flags:
    """Whether the parallel rays are the inside ones: on the sensor iff kappa > 0, in the object
    plane of ``vergence`` iff W > 0.
    """
    return smms.kappa > 0 if vergence is None else array_vergence(smms, vergence) > 0


def useful_rays(smms: Smms, useful: Array) -> Rays:
    """Vertices of the light that lands in the useful interval: 4 boundary rays, then 4 useful rays
    on its low edge, 4 on its high one.

    Useful chief rays pass an edge of the useful interval and an edge of the main lens (upper,
    lower) or of the microlens (upper, lower). Where the strip touches only a corner of the
    rectangle, that boundary ray is it.

    Args:
        smms: systems, fields of shape (...).
        useful: (low, high) on the sensor, shape (..., 2), mm; nan where there is none.

    Returns:
        Rays of shape (..., 12); all absent where there is no useful interval.
    """
    column = _as_column(smms)
    slope, power = column.gap / column.distance, column.gap / column.focal
    kappa, y = column.kappa, column.centre_x
    half_lens, half_microlens = column.lens_aperture / 2, column.aperture / 2
    corner = boundary_rays(smms)
    width = column.lens_width + column.microlens_width
    slack = _SLACK * (width + np.abs(power * y) + np.abs(kappa * y))
    low, high = np.asarray(useful)[..., :1], np.asarray(useful)[..., 1:]
    ms, qs = [corner.main_lens], [corner.microlens]
    exist = [(corner.sensor >= low - slack) & (corner.sensor <= high + slack)]
    edges = half_lens * np.array([1.0, -1.0])
    sides = y + half_microlens * np.array([1.0, -1.0])
    for edge in (low, high):
        # Edge of the main lens: q from the landing point; a kappa of 0 moves no landing point.
        steep = kappa != 0
        q = (edge + slope * edges - power * y) / np.where(steep, kappa, 1.0)
        m = (kappa * sides + power * y - edge) / slope
        ms += [edges + 0 * q, np.clip(m, -half_lens, half_lens)]
        qs += [np.clip(q, y - half_microlens, y + half_microlens), sides + 0 * m]
        exist += [
            steep & (np.abs(q - y) * np.abs(kappa) <= half_microlens * np.abs(kappa) + slack),
            np.abs(m) * slope <= half_lens * slope + slack,
        ]
    return _rays(
        column,
        np.concatenate(ms, axis=-1),
        np.concatenate(qs, axis=-1),
        np.concatenate(exist, axis=-1),
    )


def object_fields(smms: Smms, useful: Array, vergence: float) -> ObjectFields:
    """Bright and total field of each SMMS in an object plane, by boundary rays and by useful chief
    rays.

    Inside useful rays alone do not mark the bright field (paper, Fig. 4): it lies between the
    inside boundary rays, cut by the inner ones of the useful rays.

    Args:
        smms: systems, fields of shape (...).
        useful: (low, high) on the sensor, shape (..., 2), mm; nan where there is none.
        vergence: V = 1/D of the plane, 1/mm.
    """
    column = _as_column(smms)
    corner = boundary_rays(smms)
    ordered = np.sort(
        object_crossing(column, corner.main_lens, corner.microlens, np.asarray(vergence)), axis=-1
    )
    bright, total = ordered[..., 1:3], ordered[..., [0, 3]]
    rays = useful_rays(smms, useful)
    height = object_crossing(column, rays.main_lens, rays.microlens, np.asarray(vergence))

    def spread(part: slice) -> tuple[Array, Array]:
        exists = rays.exists[..., part]
        return (
            np.where(exists, height[..., part], np.inf).min(axis=-1),
            np.where(exists, height[..., part], -np.inf).max(axis=-1),
        )

    lowest, highest = spread(slice(0, 12))
    some = lowest <= highest
    useful_total = np.where(some[..., None], np.stack([lowest, highest], axis=-1), np.nan)
    # Points that send a ray onto an edge of the useful interval lie between that edge's rays: none
    # of them is wholly inside.
    low_first, low_last = spread(slice(4, 8))
    high_first, high_last = spread(slice(8, 12))
    rising = low_last <= high_first
    falling = high_last <= low_first
    inner_low = np.where(rising, low_last, high_last)
    inner_high = np.where(rising, high_first, low_first)
    start, end = np.maximum(bright[..., 0], inner_low), np.minimum(bright[..., 1], inner_high)
    whole = some & (rising | falling) & (start <= end)
    useful_bright = np.where(whole[..., None], np.stack([start, end], axis=-1), np.nan)
    return ObjectFields(bright, total, useful_bright, useful_total)
