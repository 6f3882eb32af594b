"""In how many micro-images an object point is seen: total, bright and chief views, along the row
and on the sensor.

``total``: some ray lands in the useful region. ``bright``: the full cone passes and lands in it
whole. ``chief``: the ray through the centre of the limiting stop passes and lands in it; this is
the number of views wherever one number is meant. Comparisons are inclusive: what misses an edge by
less than the roundoff of its own terms lies on it. Written in the crossing m of the main lens: a
ray of the object point o meets the microlens plane at q = x m - o V L and the sensor at s = (kappa
x - b/L) m - kappa L V o + (b/f) y, finite for every x and V.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import ApertureShape
from flflab.optics.focus import limiting_aperture, microlens_limits
from flflab.optics.smms import Smms, image_offset
from flflab.optics.useful import RowFields, SensorFields, in_useful, select

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
_RINGS, _SPOKES = 6, 48
_ROUNDOFF = 8 * np.finfo(np.float64).eps


@dataclass(frozen=True)
class Views:
    """Number of views of one object point."""

    total: int
    bright: int
    chief: int


def _scalars(smms: Smms, vergence: Array | float) -> tuple[Array, Array, Array]:
    """x, the slope of the sensor position over m, and the slope of m over the microlens's centre
    (1/x, safe at 0).
    """
    x = image_offset(smms, vergence)
    with np.errstate(divide="ignore"):
        inverse = np.where(x == 0, 0.0, 1 / x)
    return x, smms.kappa * x - smms.gap / smms.distance, inverse


def _extent(shift: Array, shape: ApertureShape) -> Array:
    """How far out (x, y) lies: from the centre of a round aperture, or along the sides of a square
    one.
    """
    return np.linalg.norm(shift, axis=-1) if shape == "round" else np.abs(shift).max(axis=-1)


def _roundoff(
    smms: Smms, vergence: Array | float, angle: Array, centre: Array
) -> tuple[Array, Array]:
    """What rounding can do to y + o V L against the stops' edges and to a landing point, mm: units
    of roundoff of the sums of |terms|.

    Args:
        smms: systems, fields of shape (N,).
        vergence: V = 1/D, 1/mm, one number or one a system.
        angle: size of o V of the object point, one number or one a system.
        centre: size of the microlens's centre, shape (N,), mm.
    """
    ratio = smms.gap / smms.distance
    terms = smms.distance * (np.abs(vergence) + 1 / np.abs(smms.lens_focal)) + 1
    at_array = centre + angle * smms.distance + (smms.lens_aperture * terms + smms.aperture) / 2
    size = np.maximum(np.abs(image_offset(smms, vergence)), smms.aperture / smms.lens_aperture)
    steep = np.maximum(np.abs(smms.kappa), ratio / size)
    widths = smms.lens_width + smms.aperture * (1 + ratio + smms.gap / np.abs(smms.focal))
    return _ROUNDOFF * at_array, _ROUNDOFF * (centre * (1 + ratio) + widths + steep * at_array)


def chief_crossings(
    smms: Smms, vergence: Array | float, angle: Array, centre: Array, shape: ApertureShape = "round"
) -> tuple[Array, Flags, Array]:
    """The ray of an object point through the centre of the limiting stop of each SMMS, in one
    coordinate or several.

    Args:
        smms: systems, fields of shape (N,).
        vergence: V = 1/D, 1/mm, one number or one a system.
        angle: o V of the object point, shape (k,) for k coordinates, or one a system, shape (N, k).
        centre: microlens centres, shape (N, k), mm.
        shape: shape of the apertures.

    Returns:
        Main-lens crossings (N, k), whether the ray passes both apertures (N,), landing points on
        the sensor (N, k).
    """
    crossing, passes, landing, _ = _chief(smms, vergence, angle, centre, shape)
    return crossing, passes, landing


def _chief(
    smms: Smms, vergence: Array | float, angle: Array, centre: Array, shape: ApertureShape
) -> tuple[Array, Flags, Array, Array]:
    """``chief_crossings``, and by how much rounding can move the landing points (N,)."""
    x, _, inverse = _scalars(smms, vergence)
    shift = centre + angle * smms.distance[:, None]
    slack, on_sensor = _roundoff(smms, vergence, _extent(angle, shape), _extent(centre, shape))
    stop = np.maximum(smms.lens_aperture * np.abs(x), smms.aperture) / 2
    passes = _extent(shift, shape) <= stop + slack
    by_microlens = microlens_limits(smms, vergence)[:, None]
    crossing = np.where(by_microlens, shift * inverse[:, None], 0.0)
    # From the micro-image's centre: few terms, none of them much larger than their sum.
    offset = np.where(
        by_microlens,
        (smms.gap / smms.distance)[:, None] * crossing,
        smms.kappa[:, None] * shift,
    )
    return crossing, passes, smms.image_scale[:, None] * centre - offset, on_sensor


def row_chief_views(row: RowFields, vergence: float, angle: float) -> tuple[Array, Flags]:
    """Main-lens crossings of the row's chief rays of the object point with o V = ``angle``, and
    which of them are views; both of shape (n,).
    """
    crossing, passes, landing, slack = _chief(
        row.smms, vergence, np.array([angle]), row.smms.centre_x[:, None], "square"
    )
    with np.errstate(invalid="ignore"):
        inside = landing[:, 0] >= row.useful[:, 0] - slack
        inside &= landing[:, 0] <= row.useful[:, 1] + slack
    return crossing[:, 0], passes & inside


def row_views(row: RowFields, vergence: float, angle: float) -> Views:
    """Views along the row of the object point with o V = ``angle`` (its x), slit apertures.

    Raises nothing: a point seen nowhere has 0 views.
    """
    smms = row.smms
    x, slope, inverse = _scalars(smms, vergence)
    shift = smms.centre_x + angle * smms.distance
    base = smms.gap / smms.focal * smms.centre_x - smms.kappa * smms.distance * angle
    lens, microlens = smms.lens_aperture * np.abs(x) / 2, smms.aperture / 2
    slack, on_sensor = _roundoff(smms, vergence, np.abs(angle), np.abs(smms.centre_x))
    half_lens = smms.lens_aperture / 2
    half = np.where(x == 0, np.inf, microlens * np.abs(inverse))
    middle = np.clip(shift * inverse, -half_lens - half, half_lens + half)
    low, high = np.maximum(-half_lens, middle - half), np.minimum(half_lens, middle + half)
    ends = np.sort(np.stack([slope * low + base, slope * high + base]), axis=0)
    first, last = row.useful[:, 0] - on_sensor, row.useful[:, 1] + on_sensor
    with np.errstate(invalid="ignore"):
        some = np.abs(shift) <= lens + microlens + slack
        total = some & (ends[0] <= last) & (ends[1] >= first)
        full = np.abs(shift) <= np.abs(lens - microlens) + slack
        bright = full & (ends[0] >= first) & (ends[1] <= last)
    _, chief = row_chief_views(row, vergence, angle)
    return Views(int(total.sum()), int(bright.sum()), int(chief.sum()))


def chief_view_indices(
    fields: SensorFields, vergence: float, angle: Array
) -> npt.NDArray[np.int64]:
    """Positions in the camera's list of the microlenses that see the point with o V = ``angle`` (x,
    y) by a chief ray.
    """
    every = np.arange(len(fields.radius))
    return np.flatnonzero(
        chief_seen_by(fields, every, vergence, np.broadcast_to(angle, (len(every), 2)))
    )


def sensor_views(fields: SensorFields, vergence: float, angle: Array) -> Views:
    """Views on the sensor of the point with o V = ``angle`` (x, y), round or square apertures.

    Where neighbours' fields cut the useful regions, ``total`` is decided on a polar grid of rays
    over the light that passes (exact otherwise to the grid's step of 1/6 of the footprint's radius
    at its rim).
    """
    smms, shape = fields.smms, fields.shape
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)
    shift = centre + angle * smms.distance[:, None]
    slack, _ = _roundoff(smms, vergence, _extent(angle, shape), _extent(centre, shape))
    reach = (smms.lens_aperture * np.abs(image_offset(smms, vergence)) + smms.aperture) / 2
    members = np.flatnonzero(_extent(shift, shape) <= reach + slack)
    if len(members) == 0:
        return Views(0, 0, 0)
    total, bright, chief = seen_by(
        fields, members, vergence, np.broadcast_to(angle, (len(members), 2))
    )
    return Views(int(total.sum()), int(bright.sum()), int(chief.sum()))


def seen_by(
    fields: SensorFields, members: npt.NDArray[np.int64], vergence: float, angle: Array
) -> tuple[Flags, Flags, Flags]:
    """Whether microlenses see object points, pair by pair: total, bright and chief; see
    ``sensor_views``.

    Args:
        fields: the camera's useful regions.
        members: microlenses, shape (K,).
        vergence: V = 1/D, 1/mm.
        angle: o V (x, y) of the point for each of them, shape (K, 2).
    """
    smms, shape = select(fields.smms, members), fields.shape
    x, slope, inverse = _scalars(smms, vergence)
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)
    shift = centre + angle * smms.distance[:, None]
    base = (smms.gap / smms.focal)[:, None] * centre - (smms.kappa * smms.distance)[:, None] * angle
    crossing, passes, landing, slack = _chief(smms, vergence, angle, centre, shape)
    chief = passes & in_useful(fields, members, landing, slack=slack)
    at_array, _ = _roundoff(smms, vergence, _extent(angle, shape), _extent(centre, shape))
    least = np.abs(smms.lens_aperture * np.abs(x) - smms.aperture) / 2
    full = _extent(shift, shape) <= least + at_array
    footprint = np.abs(slope) * limiting_aperture(smms, vergence) / 2
    bright = full & in_useful(fields, members, landing, footprint, slack)
    rays = _rays(crossing, shift * inverse[:, None], smms, x, shift, shape)
    landed = slope[:, None, None] * rays + base[:, None, :]
    lit = ~np.isnan(landed[..., 0])
    place = np.repeat(np.arange(len(members)), landed.shape[1])[lit.ravel()]
    hit = np.zeros(lit.shape, dtype=np.bool_)
    hit[lit] = in_useful(fields, members[place], landed[lit], slack=slack[place])
    return hit.any(axis=1) | chief, bright, chief


def chief_seen_by(
    fields: SensorFields, members: npt.NDArray[np.int64], vergence: float, angle: Array
) -> Flags:
    """The chief views of ``seen_by`` alone, without tracing rays."""
    smms = select(fields.smms, members)
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)
    _, passes, landing, slack = _chief(smms, vergence, angle, centre, fields.shape)
    passed = np.flatnonzero(passes)
    passes[passed] = in_useful(fields, members[passed], landing[passed], slack=slack[passed])
    return passes


def _rays(
    crossing: Array, disc_centre: Array, smms: Smms, x: Array, shift: Array, shape: ApertureShape
) -> Array:
    """Main-lens crossings of rays that pass both apertures, shape (n, rays, 2); nan where a ray is
    stopped.
    """
    angles = np.arange(_SPOKES) * (2 * np.pi / _SPOKES)
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    radii = np.arange(_RINGS + 1) / _RINGS
    polar = (radii[:, None, None] * (rim / _extent(rim, shape)[:, None])[None]).reshape(-1, 2)
    lens_rays = smms.lens_aperture[:, None, None] / 2 * polar
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = np.where(x == 0, 0.0, smms.aperture / 2 / np.abs(x))[:, None, None]
    microlens_rays = disc_centre[:, None, :] + radius * polar
    rays = np.concatenate([crossing[:, None, :], lens_rays, microlens_rays], axis=1)
    tolerance = 1 + 1e-12
    passes = _extent(rays, shape) <= smms.lens_aperture[:, None] / 2 * tolerance
    passes &= (
        _extent(x[:, None, None] * rays - shift[:, None, :], shape)
        <= smms.aperture[:, None] / 2 * tolerance
    )
    return np.where(passes[..., None], rays, np.nan)
