"""Which part of each micro-image is useful: lit enough, on the sensor, and free of its neighbours'
light.

Row (slit apertures, one coordinate): closed intervals. Sensor: where the illumination (two discs in
common; for square apertures, whose sides lie along the sensor's, the product of two ramps) reaches
the least value, less the open total fields of all other microlenses, as far as it is seen straight
from the micro-image's centre. Lengths in mm. Source: paper, "Chief rays and useful chief rays",
Figs. 3 and 4.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import ApertureShape, Camera, microlens_indices
from flflab.optics.hull import meets_disc, meets_square, way_in_square
from flflab.optics.illumination import square_illumination, useful_radii
from flflab.optics.neighbours import neighbours_of
from flflab.optics.smms import Smms, camera_smms

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_ROUNDOFF = 8 * np.finfo(np.float64).eps
# Share of an interval that a step of golden-section search leaves, and steps: to 1e-5 of it.
_GOLDEN, _STEPS = (5**0.5 - 1) / 2, 24


@dataclass(frozen=True)
class RowFields:
    """The row of microlenses nearest the axis, in its own coordinate x on the sensor, mm.

    Attributes:
        members: positions of the row's microlenses in the camera's list, shape (n,).
        smms: their systems, fields of shape (n,).
        centre: micro-image centres, shape (n,).
        useful: (low, high) of each useful interval, shape (n, 2); nan where there is none.
    """

    members: npt.NDArray[np.int64]
    smms: Smms
    centre: Array
    useful: Array


@dataclass(frozen=True)
class SensorFields:
    """Useful regions of all micro-images in two dimensions.

    Attributes:
        smms: the systems, fields of shape (N,).
        centre: micro-image centres (x, y), shape (N, 2), mm.
        radius: useful radius by illumination alone (square apertures: half width along an axis),
            shape (N,), mm.
        blocked: radius (half width) of what each microlens forbids to the others, shape (N,), mm.
        neighbours: indices of the microlenses that can reach a useful region, shape (N, K); -1
            where there are fewer.
        low: lower corner (x, y) of the sensor, mm.
        high: upper corner, mm.
        shape: shape of all apertures.
        least: least relative illumination of a useful point.
        crosstalk: most relative illumination by a neighbour.
    """

    smms: Smms
    centre: Array
    radius: Array
    blocked: Array
    neighbours: npt.NDArray[np.int64]
    low: Array
    high: Array
    shape: ApertureShape = "round"
    least: float = 0.0
    crosstalk: float = 0.0


def sensor_edges(camera: Camera) -> tuple[Array, Array]:
    """Lower and upper corner (x, y) of the sensor's pixels, mm."""
    half = np.asarray(camera.sensor.resolution) * camera.sensor.pixel / 2
    offset = np.asarray(camera.sensor.offset)
    return offset - half, offset + half


def row_members(camera: Camera) -> npt.NDArray[np.int64]:
    """Positions of the microlenses of the row nearest the axis (the lower one of two equally near),
    shape (n,).
    """
    rows = microlens_indices(camera.array)[:, 1]
    smms = camera_smms(camera)
    heights = np.array(
        [np.mean(smms.centre_y[rows == row]) for row in range(camera.array.count[1])]
    )
    nearest = int(np.flatnonzero(np.abs(heights) <= np.abs(heights).min() * (1 + 1e-9) + 1e-12)[0])
    return np.flatnonzero(rows == nearest)


def row_fields(camera: Camera) -> RowFields:
    """Bright field, total field and useful interval of the row nearest the axis; vectorised over
    the row.
    """
    members = row_members(camera)
    smms = select(camera_smms(camera), members)
    centre = smms.centre_x * smms.image_scale
    ramp = np.minimum(smms.lens_width, smms.microlens_width)
    half = smms.outside_radius - camera.useful.minimum_illumination * ramp
    blocked = smms.outside_radius - camera.useful.maximum_crosstalk * ramp
    order = np.argsort(centre)
    sorted_centre, reach = centre[order], blocked[order]
    # Only total fields on the far side of the own centre count; accumulate covers neighbours of any
    # width.
    left = np.concatenate([[-np.inf], np.maximum.accumulate(sorted_centre + reach)[:-1]])
    right = np.concatenate(
        [np.minimum.accumulate((sorted_centre - reach)[::-1])[::-1][1:], [np.inf]]
    )
    low_edge, high_edge = sensor_edges(camera)
    low = np.maximum(np.maximum(sorted_centre - half[order], left), low_edge[0])
    high = np.minimum(np.minimum(sorted_centre + half[order], right), high_edge[0])
    slack = _ROUNDOFF * (np.abs(sorted_centre) + half[order] + reach)
    lit = (low <= sorted_centre + slack) & (sorted_centre - slack <= high)
    low, high = np.minimum(low, sorted_centre), np.maximum(high, sorted_centre)
    useful = np.empty((len(members), 2))
    useful[order] = np.where(lit[:, None], np.stack([low, high], axis=1), np.nan)
    return RowFields(members, smms, centre, useful)


def select(smms: Smms, index: npt.NDArray[np.int64]) -> Smms:
    """The systems at ``index`` out of systems whose fields have shape (N,)."""
    return Smms(**{name: getattr(smms, name)[index] for name in Smms.__dataclass_fields__})


def sensor_fields(camera: Camera) -> SensorFields:
    """Useful regions of every micro-image, for round apertures and square ones."""
    smms = camera_smms(camera)
    radii = useful_radii(smms, camera)
    return fields_of(smms, neighbours_of(smms, camera, radii=radii), camera, radii)


def fields_of(
    smms: Smms,
    neighbours: npt.NDArray[np.int64],
    camera: Camera,
    radii: tuple[Array, Array] | None = None,
) -> SensorFields:
    """Useful regions of systems whose possible neighbours are known; useful rules and sensor are
    the camera's.

    Args:
        smms: the systems, fields of shape (N,).
        neighbours: indices into the systems, shape (N, K); -1 where there are fewer.
        camera: whose sensor and rules hold.
        radii: what ``useful_radii`` says of them, where it is known already.
    """
    rules, shape = camera.useful, camera.aperture_shape
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1) * smms.image_scale[:, None]
    radius, blocked = radii or useful_radii(smms, camera)
    low, high = sensor_edges(camera)
    return SensorFields(
        smms,
        centre,
        radius,
        blocked,
        neighbours,
        low,
        high,
        shape,
        rules.minimum_illumination,
        rules.maximum_crosstalk,
    )


def in_useful(
    fields: SensorFields,
    owner: npt.NDArray[np.int64],
    points: Array,
    margin: Array | float = 0.0,
    slack: Array | float = 0.0,
) -> Flags:
    """Whether footprints on the sensor lie in the useful region of a micro-image; comparisons
    inclusive.

    A footprint is useful where all of it is seen straight from the micro-image's centre: no
    neighbour's light meets the hull of the two.

    Args:
        fields: the camera's useful regions.
        owner: microlens each point belongs to, shape (K,).
        points: positions (x, y) on the sensor, shape (K, 2), mm.
        margin: radius of the disc (square apertures: half width of the square) round each point
            that must lie inside, shape (K,) or one number, mm.
        slack: by how much an edge may be missed, shape (K,) or one number, mm.
    """
    centre = fields.centre[owner]
    away = points - centre
    size, slack = (
        np.broadcast_to(np.asarray(part, dtype=np.float64), owner.shape) for part in (margin, slack)
    )
    least = size - slack
    lit = _lit_round if fields.shape == "round" else _lit_square
    inside = lit(fields, owner, away, least)
    inside &= np.all(
        (points - least[:, None] >= fields.low) & (points + least[:, None] <= fields.high), axis=1
    )
    edge = slack[:, None]
    inside &= np.all((centre + edge >= fields.low) & (centre - edge <= fields.high), axis=1)
    rest = np.flatnonzero(inside)
    meets = meets_disc if fields.shape == "round" else meets_square
    for column in range(fields.neighbours.shape[1]):
        other = fields.neighbours[owner[rest], column]
        gap, reach = fields.centre[other] - centre[rest], away[rest]
        met = meets(gap, reach, size[rest], fields.blocked[other] - slack[rest]) & (other >= 0)
        suspects = np.flatnonzero(met)
        if fields.shape == "square" and fields.crosstalk > 0 and len(suspects):
            asked = rest[suspects]
            met[suspects] = _meets_glow(
                fields, other[suspects], gap[suspects], away[asked], size[asked], slack[asked]
            )
        rest = rest[~met]
    useful = np.zeros(inside.shape, dtype=np.bool_)
    useful[rest] = True
    return useful


def _lit_round(
    fields: SensorFields, owner: npt.NDArray[np.int64], away: Array, margin: Array
) -> Flags:
    """Whether discs of radius ``margin`` at ``away`` (x, y) from the micro-image's centre are lit
    enough.
    """
    farthest, limit = np.hypot(away[:, 0], away[:, 1]) + margin, fields.radius[owner]
    # On the rim of the total field the illumination is 0, and a useful point needs some.
    dark_edge = limit >= fields.smms.outside_radius[owner]
    return np.where(dark_edge, farthest < limit, farthest <= limit)


def _lit_square(
    fields: SensorFields, owner: npt.NDArray[np.int64], away: Array, margin: Array
) -> Flags:
    """The same for squares of half width ``margin``."""
    share = square_illumination(select(fields.smms, owner), away, margin)
    return (share >= fields.least) & (share > 0)


def _meets_glow(
    fields: SensorFields,
    other: npt.NDArray[np.int64],
    centre: Array,
    reach: Array,
    margin: Array,
    slack: Array,
) -> Flags:
    """Whether a neighbour's illumination exceeds the permitted crosstalk anywhere in the hull of
    (0, 0) and the footprint.

    The brightest point of (t reach, t margin) is a product of two ramps: it rises to one peak and
    falls, so that golden-section search finds it.
    """
    smms = select(fields.smms, other)

    def glow(part: Array) -> Array:
        return square_illumination(smms, part[:, None] * reach - centre, slack - part * margin)

    low, high = np.sort(way_in_square(centre, reach, margin, fields.blocked[other]), axis=0)
    first, last = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    left, right = glow(first), glow(last)
    brightest = np.maximum(np.maximum(glow(low), glow(high)), np.maximum(left, right))
    for _ in range(_STEPS):
        rising = left < right
        low, high = np.where(rising, first, low), np.where(rising, high, last)
        mirror = low + high - np.where(rising, last, first)
        found = glow(mirror)
        first, last = np.where(rising, last, mirror), np.where(rising, mirror, first)
        left, right = np.where(rising, right, found), np.where(rising, found, left)
        brightest = np.maximum(brightest, found)
    return brightest > fields.crosstalk
