"""Which part of each micro-image is useful: lit enough, on the sensor, and free of its neighbours' light.

Row (slit apertures, one coordinate): closed intervals. Sensor (round apertures): the disc in which the two-disc illumination
reaches the least value, less the open total fields of all other microlenses, as far as it is seen straight from the
micro-image's centre. Lengths in mm. Source: paper, "Chief rays and useful chief rays", Figs. 3 and 4.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.errors import InputError
from flflab.optics.camera import Camera, microlens_indices
from flflab.optics.discs import two_disc_areas
from flflab.optics.smms import Smms, camera_smms

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


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
        radius: useful radius by illumination alone, shape (N,), mm.
        blocked: radius of the disc that each microlens forbids to the others, shape (N,), mm.
        neighbours: indices of the microlenses that can reach a useful region, shape (N, K); -1 where there are fewer.
        low: lower corner (x, y) of the sensor, mm.
        high: upper corner, mm.
    """

    smms: Smms
    centre: Array
    radius: Array
    blocked: Array
    neighbours: npt.NDArray[np.int64]
    low: Array
    high: Array


def sensor_edges(camera: Camera) -> tuple[Array, Array]:
    """Lower and upper corner (x, y) of the sensor's pixels, mm."""
    half = np.asarray(camera.sensor.resolution) * camera.sensor.pixel / 2
    offset = np.asarray(camera.sensor.offset)
    return offset - half, offset + half


def row_members(camera: Camera) -> npt.NDArray[np.int64]:
    """Positions of the microlenses of the row nearest the axis (the lower one of two equally near), shape (n,)."""
    rows = microlens_indices(camera.array)[:, 1]
    smms = camera_smms(camera)
    heights = np.array([np.mean(smms.centre_y[rows == row]) for row in range(camera.array.count[1])])
    nearest = int(np.flatnonzero(np.abs(heights) <= np.abs(heights).min() * (1 + 1e-9) + 1e-12)[0])
    return np.flatnonzero(rows == nearest)


def row_fields(camera: Camera) -> RowFields:
    """Bright field, total field and useful interval of the row nearest the axis; vectorised over the row."""
    members = row_members(camera)
    smms = select(camera_smms(camera), members)
    centre = smms.centre_x * smms.image_scale
    ramp = np.minimum(smms.lens_width, smms.microlens_width)
    half = smms.outside_radius - camera.useful.minimum_illumination * ramp
    blocked = smms.outside_radius - camera.useful.maximum_crosstalk * ramp
    order = np.argsort(centre)
    sorted_centre, reach = centre[order], blocked[order]
    # Only total fields on the far side of the own centre count; accumulate covers neighbours of any width.
    left = np.concatenate([[-np.inf], np.maximum.accumulate(sorted_centre + reach)[:-1]])
    right = np.concatenate([np.minimum.accumulate((sorted_centre - reach)[::-1])[::-1][1:], [np.inf]])
    low_edge, high_edge = sensor_edges(camera)
    low = np.maximum(np.maximum(sorted_centre - half[order], left), low_edge[0])
    high = np.minimum(np.minimum(sorted_centre + half[order], right), high_edge[0])
    useful = np.empty((len(members), 2))
    useful[order] = np.where(((low <= sorted_centre) & (sorted_centre <= high))[:, None], np.stack([low, high], axis=1), np.nan)
    return RowFields(members, smms, centre, useful)


def select(smms: Smms, index: npt.NDArray[np.int64]) -> Smms:
    """The systems at ``index`` out of systems whose fields have shape (N,)."""
    return Smms(**{name: getattr(smms, name)[index] for name in Smms.__dataclass_fields__})


def round_illumination(smms: Smms, offset: Array) -> Array:
    """Relative illumination of round apertures at ``offset`` mm from the micro-image's centre: area common to two discs, 1 inside."""
    lens, microlens = smms.lens_width / 2, smms.microlens_width / 2
    smaller = np.minimum(lens, microlens)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = two_disc_areas(lens, microlens, np.abs(offset)) / (np.pi * smaller**2)
    return np.where(smaller > 0, share, (np.abs(offset) <= np.maximum(lens, microlens)).astype(np.float64))


def illumination_radius(smms: Smms, share: float) -> Array:
    """Radius at which the round illumination falls to ``share``, mm, by bisection to the last bit; the outside radius for 0."""
    if share == 0:
        return smms.outside_radius
    low, high = smms.inside_radius.copy(), smms.outside_radius.copy()
    for _ in range(60):
        middle = (low + high) / 2
        lit = round_illumination(smms, middle) >= share
        low, high = np.where(lit, middle, low), np.where(lit, high, middle)
    return low


def sensor_fields(camera: Camera) -> SensorFields:
    """Useful regions of every micro-image.

    Raises:
        InputError: square apertures, whose useful regions on the sensor are not computed.
    """
    smms = camera_smms(camera)
    return fields_of(smms, neighbours_of(smms, camera), camera)


def fields_of(smms: Smms, neighbours: npt.NDArray[np.int64], camera: Camera) -> SensorFields:
    """Useful regions of systems whose possible neighbours are known; useful rules and sensor are the camera's.

    Args:
        smms: the systems, fields of shape (N,).
        neighbours: indices into the systems, shape (N, K); -1 where there are fewer.
        camera: whose sensor and rules hold.

    Raises:
        InputError: square apertures, whose useful regions on the sensor are not computed.
    """
    if camera.aperture_shape != "round":
        raise InputError("camera: aperture_shape is square; useful regions on the sensor are computed for round apertures only")
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1) * smms.image_scale[:, None]
    radius = illumination_radius(smms, camera.useful.minimum_illumination)
    blocked = illumination_radius(smms, camera.useful.maximum_crosstalk)
    low, high = sensor_edges(camera)
    return SensorFields(smms, centre, radius, blocked, neighbours, low, high)


def neighbours_of(smms: Smms, camera: Camera, slack: float = 0.0) -> npt.NDArray[np.int64]:
    """Which other micro-images can reach the useful disc of each, shape (N, K); -1 where there are fewer.

    Args:
        smms: the systems, fields of shape (N,).
        camera: whose rules hold.
        slack: share by which the reach is enlarged, for systems that will be disturbed.
    """
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1) * smms.image_scale[:, None]
    radius = illumination_radius(smms, camera.useful.minimum_illumination) * (1 + slack)
    blocked = illumination_radius(smms, camera.useful.maximum_crosstalk) * (1 + slack)
    pairs = KDTree(centre).query_pairs(radius.max() + blocked.max(), output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    apart = np.hypot(*(centre[pairs[:, 1]] - centre[pairs[:, 0]]).T)
    reached = apart < radius[pairs[:, 0]] + blocked[pairs[:, 1]]
    # Nearest first: they cut most, and what they cut needs no further look.
    pairs = pairs[reached][np.lexsort((apart[reached], pairs[reached, 0]))]
    counts = np.bincount(pairs[:, 0], minlength=len(centre))
    column = np.arange(len(pairs)) - np.repeat(np.cumsum(counts) - counts, counts)
    neighbours = np.full((len(centre), int(counts.max(initial=0))), -1, dtype=np.int64)
    neighbours[pairs[:, 0], column] = pairs[:, 1]
    return neighbours


def in_useful(fields: SensorFields, owner: npt.NDArray[np.int64], points: Array, margin: Array | float = 0.0) -> Flags:
    """Whether discs on the sensor lie in the useful region of a micro-image; comparisons inclusive.

    Args:
        fields: the camera's useful regions.
        owner: microlens each point belongs to, shape (K,).
        points: positions (x, y) on the sensor, shape (K, 2), mm.
        margin: radius of the disc round each point that must lie inside, shape (K,) or one number, mm.
    """
    centre = fields.centre[owner]
    away = points - centre
    distance = np.hypot(away[:, 0], away[:, 1])
    margin = np.broadcast_to(np.asarray(margin, dtype=np.float64), distance.shape)
    limit = fields.radius[owner]
    dark_edge = limit >= fields.smms.outside_radius[owner]
    # On the rim of the total field the illumination is 0, and a useful point needs some.
    inside = np.where(dark_edge, distance + margin < limit, distance + margin <= limit)
    inside &= np.all((points - margin[:, None] >= fields.low) & (points + margin[:, None] <= fields.high), axis=1)
    inside &= np.all((centre >= fields.low) & (centre <= fields.high), axis=1)
    rest = np.flatnonzero(inside)
    for column in range(fields.neighbours.shape[1]):
        other = fields.neighbours[owner[rest], column]
        gap, reach = fields.centre[other] - centre[rest], away[rest]
        along = np.clip(np.einsum("ij,ij->i", gap, reach) / np.maximum(distance[rest] ** 2, np.finfo(np.float64).tiny), 0.0, 1.0)
        clear = np.hypot(*(gap - along[:, None] * reach).T) >= fields.blocked[other] + margin[rest]
        rest = rest[clear | (other < 0)]
    useful = np.zeros(inside.shape, dtype=np.bool_)
    useful[rest] = True
    return useful


def useful_pixels(camera: Camera) -> tuple[int, int]:
    """Number of pixels whose centre lies in some useful region: along the row nearest the axis, and on the whole sensor."""
    columns, rows = camera.sensor.resolution
    low, _ = sensor_edges(camera)
    pixel = camera.sensor.pixel
    row = row_fields(camera).useful
    row = row[~np.isnan(row[:, 0])]
    first = np.ceil((row[:, 0] - low[0]) / pixel - 0.5)
    last = np.floor((row[:, 1] - low[0]) / pixel - 0.5)
    return int(np.sum(np.clip(np.minimum(last, columns - 1) - np.maximum(first, 0) + 1, 0, None))), _sensor_pixels(camera, rows, columns)


def _sensor_pixels(camera: Camera, rows: int, columns: int) -> int:
    fields = sensor_fields(camera)
    low, pixel = fields.low, camera.sensor.pixel
    lit = np.flatnonzero(np.all((fields.centre >= fields.low) & (fields.centre <= fields.high), axis=1))
    total = 0
    for i in lit:
        first = np.maximum(np.floor((fields.centre[i] - fields.radius[i] - low) / pixel - 0.5).astype(int), 0)
        last = np.minimum(np.ceil((fields.centre[i] + fields.radius[i] - low) / pixel - 0.5).astype(int), [columns - 1, rows - 1])
        x, y = (low[axis] + (np.arange(first[axis], last[axis] + 1) + 0.5) * pixel for axis in (0, 1))
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        total += int(np.count_nonzero(in_useful(fields, np.full(len(points), i), points)))
    return total
