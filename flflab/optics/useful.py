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
from flflab.optics.overlap import common_area, common_chord
from flflab.optics.smms import Smms, camera_smms, row_illumination

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

BEYOND, MOST_NEWTON = (
    2.0,
    16,
)  # units in the last place, and steps: where so many do not do halving takes over


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
    useful = np.empty((len(members), 2))
    useful[order] = np.where(
        ((low <= sorted_centre) & (sorted_centre <= high))[:, None],
        np.stack([low, high], axis=1),
        np.nan,
    )
    return RowFields(members, smms, centre, useful)


def select(smms: Smms, index: npt.NDArray[np.int64]) -> Smms:
    """The systems at ``index`` out of systems whose fields have shape (N,)."""
    return Smms(**{name: getattr(smms, name)[index] for name in Smms.__dataclass_fields__})


def round_illumination(smms: Smms, offset: Array) -> Array:
    """Relative illumination of round apertures at ``offset`` mm from the micro-image's centre: area
    common to two discs, 1 inside.
    """
    lens, microlens = smms.lens_width / 2, smms.microlens_width / 2
    smaller = np.minimum(lens, microlens)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = common_area(lens, microlens, np.abs(offset)) / (np.pi * smaller**2)
    return np.where(
        smaller > 0, share, (np.abs(offset) <= np.maximum(lens, microlens)).astype(np.float64)
    )


def illumination_radius(smms: Smms, share: float) -> Array:
    """Radius at which the round illumination falls to ``share``, mm, to the last bit; the outside
    radius for 0.

    The area common to two discs falls by the chord that they share for each unit that their centres
    move apart, so that Newton's steps find it; each ends a little beyond, which closes in from both
    sides, and halves what is left where it would leave that.
    """
    if share == 0:
        return smms.outside_radius
    widths = np.stack(np.broadcast_arrays(smms.lens_width, smms.microlens_width), axis=-1)
    kinds, kind = np.unique(widths.reshape(-1, 2), axis=0, return_inverse=True)
    lens, microlens = kinds.T / 2
    wanted = share * np.pi * np.minimum(lens, microlens) ** 2
    low, high = np.abs(lens - microlens), lens + microlens
    apart, steps = low + (high - low) / 2, 0
    while np.any(np.nextafter(low, high) < high):
        more = common_area(lens, microlens, apart) - wanted
        low, high = (
            np.where(more >= 0, apart, low),
            np.where(more >= 0, high, np.where(apart > low, apart, low)),
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            chord = common_chord(lens, microlens, apart)
            beyond = BEYOND * (np.spacing(apart) + np.spacing(wanted) / chord)
            further = apart + more / chord + np.copysign(beyond, more)
        apart, steps = low + (high - low) / 2, steps + 1
        if steps < MOST_NEWTON:
            apart = np.where((further > low) & (further < high), further, apart)
    return low[kind].reshape(widths.shape[:-1])


def edge_radius(smms: Smms, share: float, shape: ApertureShape) -> Array:
    """Where the illumination falls to ``share`` on the way out along an axis, mm: radius (round),
    half width (square apertures).
    """
    if shape == "round":
        return illumination_radius(smms, share)
    return smms.outside_radius - share * np.minimum(smms.lens_width, smms.microlens_width)


def sensor_fields(camera: Camera) -> SensorFields:
    """Useful regions of every micro-image, for round apertures and square ones."""
    smms = camera_smms(camera)
    radii = useful_radii(smms, camera)
    return fields_of(smms, neighbours_of(smms, camera, radii=radii), camera, radii)


def useful_radii(smms: Smms, camera: Camera) -> tuple[Array, Array]:
    """How far out each micro-image is useful, and how far out it forbids others, by the camera's
    rules; see ``edge_radius``.
    """
    rules, shape = camera.useful, camera.aperture_shape
    return edge_radius(smms, rules.minimum_illumination, shape), edge_radius(
        smms, rules.maximum_crosstalk, shape
    )


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


def neighbours_of(
    smms: Smms, camera: Camera, slack: float = 0.0, radii: tuple[Array, Array] | None = None
) -> npt.NDArray[np.int64]:
    """Which other micro-images can reach the useful region of each, shape (N, K); -1 where there
    are fewer.

    Args:
        smms: the systems, fields of shape (N,).
        camera: whose rules hold.
        slack: share by which the reach is enlarged, for systems that will be disturbed.
        radii: what ``useful_radii`` says of them, where it is known already.
    """
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1) * smms.image_scale[:, None]
    enlarged = (1 + slack) * (1.0 if camera.aperture_shape == "round" else np.sqrt(2.0))
    radius, blocked = (part * enlarged for part in radii or useful_radii(smms, camera))
    pairs = pairs_within(centre, centre, float(radius.max() + blocked.max()))
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    apart = np.hypot(*(centre[pairs[:, 1]] - centre[pairs[:, 0]]).T)
    reached = apart < radius[pairs[:, 0]] + blocked[pairs[:, 1]]
    # Nearest first: they cut most, and what they cut needs no further look.
    pairs = pairs[reached][np.lexsort((apart[reached], pairs[reached, 0]))]
    counts = np.bincount(pairs[:, 0], minlength=len(centre))
    column = np.arange(len(pairs)) - np.repeat(np.cumsum(counts) - counts, counts)
    neighbours = np.full((len(centre), int(counts.max(initial=0))), -1, dtype=np.int64)
    neighbours[pairs[:, 0], column] = pairs[:, 1]
    return neighbours


def pairs_within(points: Array, others: Array, reach: float) -> npt.NDArray[np.int64]:
    """Pairs (i, j) of points and other points at most ``reach`` apart in x and in y, shape (K, 2),
    by cells of that size.
    """
    lowest = others.min(axis=0)
    size = max(
        reach * (1 + 1e-9), float(np.ptp(others, axis=0).max()) / 1000, np.finfo(np.float64).tiny
    )
    cells = np.floor((others - lowest) / size).astype(np.int64)
    columns = int(cells[:, 0].max()) + 3
    order = np.argsort(cells[:, 1] * columns + cells[:, 0], kind="stable")
    keys = (cells[:, 1] * columns + cells[:, 0])[order]
    near = np.flatnonzero(
        np.all((points >= lowest - reach) & (points <= others.max(axis=0) + reach), axis=1)
    )
    cell = np.floor((points[near] - lowest) / size).astype(np.int64)
    found: list[npt.NDArray[np.int64]] = []
    for row in (-1, 0, 1):
        # Three cells side by side have consecutive keys.
        key = (cell[:, 1] + row) * columns + cell[:, 0]
        first = np.searchsorted(keys, key - 1, side="left")
        counts = np.searchsorted(keys, key + 1, side="right") - first
        owner = np.repeat(np.arange(len(near)), counts)
        place = (
            np.arange(len(owner))
            - np.repeat(np.cumsum(counts) - counts, counts)
            + np.repeat(first, counts)
        )
        found.append(np.stack([near[owner], order[place]], axis=1))
    pairs = np.concatenate(found)
    return pairs[np.all(np.abs(points[pairs[:, 0]] - others[pairs[:, 1]]) <= reach, axis=1)]


def in_useful(
    fields: SensorFields, owner: npt.NDArray[np.int64], points: Array, margin: Array | float = 0.0
) -> Flags:
    """Whether footprints on the sensor lie in the useful region of a micro-image; comparisons
    inclusive.

    Args:
        fields: the camera's useful regions.
        owner: microlens each point belongs to, shape (K,).
        points: positions (x, y) on the sensor, shape (K, 2), mm.
        margin: radius of the disc (square apertures: half width of the square) round each point
            that must lie inside, shape (K,) or one number, mm.
    """
    if fields.shape == "square":
        return _in_useful_square(fields, owner, points, margin)
    centre = fields.centre[owner]
    away = points - centre
    distance = np.hypot(away[:, 0], away[:, 1])
    margin = np.broadcast_to(np.asarray(margin, dtype=np.float64), distance.shape)
    limit = fields.radius[owner]
    dark_edge = limit >= fields.smms.outside_radius[owner]
    # On the rim of the total field the illumination is 0, and a useful point needs some.
    inside = np.where(dark_edge, distance + margin < limit, distance + margin <= limit)
    inside &= np.all(
        (points - margin[:, None] >= fields.low) & (points + margin[:, None] <= fields.high), axis=1
    )
    inside &= np.all((centre >= fields.low) & (centre <= fields.high), axis=1)
    rest = np.flatnonzero(inside)
    for column in range(fields.neighbours.shape[1]):
        other = fields.neighbours[owner[rest], column]
        gap, reach = fields.centre[other] - centre[rest], away[rest]
        along = np.clip(
            np.einsum("ij,ij->i", gap, reach)
            / np.maximum(distance[rest] ** 2, np.finfo(np.float64).tiny),
            0.0,
            1.0,
        )
        clear = np.hypot(*(gap - along[:, None] * reach).T) >= fields.blocked[other] + margin[rest]
        rest = rest[clear | (other < 0)]
    useful = np.zeros(inside.shape, dtype=np.bool_)
    useful[rest] = True
    return useful


def _square_illumination(smms: Smms, away: Array, margin: Array) -> Array:
    """Relative illumination of square apertures at ``away`` (x, y), each coordinate first moved by
    ``margin`` but not past the centre.
    """
    moved = np.maximum(np.abs(away) + margin[:, None], 0.0)
    return row_illumination(smms, moved[:, 0]) * row_illumination(smms, moved[:, 1])


def _in_useful_square(
    fields: SensorFields, owner: npt.NDArray[np.int64], points: Array, margin: Array | float
) -> Flags:
    centre, smms = fields.centre[owner], select(fields.smms, owner)
    away = points - centre
    margin = np.broadcast_to(np.asarray(margin, dtype=np.float64), owner.shape)
    share = _square_illumination(smms, away, margin)
    inside = (share >= fields.least) & (share > 0)
    inside &= np.all(
        (points - margin[:, None] >= fields.low) & (points + margin[:, None] <= fields.high), axis=1
    )
    inside &= np.all((centre >= fields.low) & (centre <= fields.high), axis=1)
    rest = np.flatnonzero(inside)
    for column in range(fields.neighbours.shape[1]):
        other = fields.neighbours[owner[rest], column]
        gap, reach = fields.centre[other] - centre[rest], away[rest]
        blocked = _meets_square(gap, reach, fields.blocked[other] + margin[rest])
        suspects = np.flatnonzero(blocked & (other >= 0))
        if fields.crosstalk > 0 and len(suspects):
            blocked[suspects] = _meets_glow(
                fields, other[suspects], gap[suspects], reach[suspects], margin[rest][suspects]
            )
        rest = rest[~blocked | (other < 0)]
    useful = np.zeros(inside.shape, dtype=np.bool_)
    useful[rest] = True
    return useful


def _meets_square(centre: Array, reach: Array, half: Array) -> Flags:
    """Whether the way from (0, 0) to ``reach`` runs through the open square of this half width
    round ``centre``.
    """
    enter, leave = np.zeros(len(reach)), np.ones(len(reach))
    beside = np.zeros(len(reach), dtype=np.bool_)
    for axis in (0, 1):
        step = reach[:, axis]
        still = step == 0
        sides = (centre[:, axis] + np.array([-1.0, 1.0])[:, None] * half) / np.where(
            still, 1.0, step
        )
        beside |= still & (np.abs(centre[:, axis]) >= half)
        enter = np.where(still, enter, np.maximum(enter, sides.min(axis=0)))
        leave = np.where(still, leave, np.minimum(leave, sides.max(axis=0)))
    ends_inside = np.all(np.abs(reach - centre) < half[:, None], axis=1)
    return ~beside & ((enter < leave) | ends_inside)


def _meets_glow(
    fields: SensorFields, other: npt.NDArray[np.int64], centre: Array, reach: Array, margin: Array
) -> Flags:
    """Whether a neighbour's illumination exceeds the permitted crosstalk anywhere on the way
    (looked at in 65 places).
    """
    smms = select(fields.smms, other)
    met = np.zeros(len(other), dtype=np.bool_)
    for part in np.linspace(0.0, 1.0, 65):
        met |= _square_illumination(smms, part * reach - centre, -margin) > fields.crosstalk
    return met
