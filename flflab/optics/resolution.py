"""What the camera as a whole resolves: mean views, both effective lateral resolutions, and the
stereo condition.

Source: paper, "Effective lateral resolution" (eq. 3) and "Stereo and multistereovision" (Fig. 5).
Lengths in mm, angles in rad.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import Camera
from flflab.optics.focus import microlens_limits, sharp_vergence, virtual_depth
from flflab.optics.neighbours import even_points
from flflab.optics.smms import Smms, camera_smms, image_offset
from flflab.optics.useful import RowFields, SensorFields, row_fields, select
from flflab.optics.views import chief_seen_by, row_chief_views

Array = npt.NDArray[np.float64]
# Pairs of an object point and a microlens for a mean number of views, and fewest points.
_PAIRS, _FEWEST = 40_000, 16


@dataclass(frozen=True)
class Stereo:
    """Where at least two micro-images of the row see a point; None where there is no such distance,
    and why.
    """

    nearest: float | None
    farthest: float | None
    angle: float | None
    field_angle: float | None
    reason: str


def central_smms(camera: Camera) -> Smms:
    """The system of the microlens nearest the axis, fields of shape (); L and b are those on the
    axis, also of a tilted array.
    """
    smms = camera_smms(camera)
    nearest = int(np.argmin(np.round(np.hypot(smms.centre_x, smms.centre_y), 12)))
    central = Smms(
        **{name: np.asarray(getattr(smms, name)[nearest]) for name in Smms.__dataclass_fields__}
    )
    # that microlens may stand half a pitch aside, where a tilt of 3 mrad has moved it by a
    # micrometre
    return replace(
        central, distance=np.asarray(camera.optical_distance), gap=np.asarray(camera.optical_gap)
    )


def mean_row_views(row: RowFields, camera: Camera, vergence: float) -> float:
    """Mean number of chief views along the row over one period of the lattice round the axis.

    A microlens sees the points whose shift y + o V L lies within max(A |x|, d)/2 and brings their
    chief rays into its useful interval; the mean is the sum of these lengths within the period,
    over the period. Without an end of the lattice it is (2/p) min(max(A |x|, d)/2, reach).
    """
    smms = row.smms
    size = np.abs(image_offset(smms, vergence))
    stop = np.maximum(smms.lens_aperture * size, smms.aperture) / 2
    by_microlens = microlens_limits(smms, vergence)
    # The chief ray of a shift lands at the micro-image's centre less this times the shift.
    ratio = smms.gap / np.where(by_microlens, image_offset(smms, vergence), 1.0) / smms.distance
    per_shift = np.where(by_microlens, ratio, smms.kappa)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort((row.centre[:, None] - row.useful) / per_shift[:, None], axis=1)
    # Where no shift moves the landing point, all of them land on the micro-image's centre.
    ends = np.where((per_shift == 0)[:, None], np.array([-np.inf, np.inf]), ends)
    low, high = np.maximum(ends[:, 0], -stop), np.minimum(ends[:, 1], stop)
    half = _period(camera)[0] * smms.distance / camera.optical_distance / 2
    seen = np.minimum(high - smms.centre_x, half) - np.maximum(low - smms.centre_x, -half)
    lit = ~np.isnan(row.useful[:, 0])
    return float(np.sum(np.maximum(seen, 0.0)[lit] / (2 * half[lit])))


def _period(camera: Camera) -> tuple[float, float]:
    """(x, y) of the rectangle in which lattice and microlens types repeat, mm."""
    array = camera.array
    columns, rows = len(array.pattern[0]), len(array.pattern)
    if array.layout == "hexagonal":
        return columns * array.pitch[0], math.lcm(rows, 2) * array.pitch[1] * math.sqrt(0.75)
    return columns * array.pitch[0], rows * array.pitch[1]


def mean_sensor_views(fields: SensorFields, camera: Camera, vergence: float) -> float:
    """Mean number of chief views on the sensor over one period of the lattice round the axis, by
    counting on object points that fill it evenly.
    """
    smms = fields.smms
    x = np.abs(image_offset(smms, vergence))
    period = np.array(_period(camera))
    corner = 1.0 if fields.shape == "round" else math.sqrt(2.0)
    reach = np.maximum(smms.lens_aperture * x, smms.aperture) / 2 * corner
    members = np.flatnonzero(
        (np.hypot(smms.centre_x, smms.centre_y) <= reach + np.hypot(*period))
        & np.all((fields.centre >= fields.low) & (fields.centre <= fields.high), axis=1)
    )
    if len(members) == 0:
        return 0.0
    count = max(_PAIRS // len(members), _FEWEST)
    at = even_points(count) - 0.5
    turn = camera.array.roll
    axes = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    angle = (at * period) @ axes / camera.optical_distance
    seen = chief_seen_by(
        fields,
        np.tile(members, count),
        vergence,
        np.repeat(angle, len(members), axis=0),
    )
    return float(np.count_nonzero(seen)) / count


def effective_resolution(
    camera: Camera, vergence: float, useful: tuple[int, int]
) -> tuple[float, float]:
    """ELR of eq. (3): useful pixels over the virtual depth along the row, over its square on the
    sensor.

    Args:
        camera: the camera.
        vergence: V = 1/D of the target, 1/mm.
        useful: useful pixels along the row and on the sensor.
    """
    depth = float(virtual_depth(central_smms(camera), vergence))
    return (useful[0] / depth, useful[1] / depth**2) if depth > 0 else (math.inf, math.inf)


def stereo(camera: Camera) -> Stereo:
    """The stereo condition of the row on the side of focus: from where on two of its micro-images
    see one and the same point.

    The chief rays that land in a useful interval cross the main lens from m1 to m2 and meet the
    object plane at o V = m W - y/L. As |W| grows, micro-images side by side are the first that
    share a point; of equal ones in a boundless row at |x| = p / min(A, 2 u L/b).
    """
    row = row_fields(camera)
    lit = np.flatnonzero(~np.isnan(row.useful[:, 0]))
    if len(lit) < 2:
        return _no_stereo(
            "no micro-image of the row has a useful interval"
            if len(lit) == 0
            else "only one micro-image of the row has a useful interval"
        )
    smms = select(row.smms, lit)
    middle = int(np.argmin(np.abs(row.centre[lit])))
    kappa = float(smms.kappa[middle])
    if kappa == 0:
        return _no_stereo("the sensor lies in the exit pupil and no target is in focus")
    limit = _shared_from(smms, row.centre[lit], row.useful[lit], kappa > 0)
    # W rises with the vergence: a Keplerian camera shares points at all distances beyond.
    nearest, farthest = (limit, 0.0) if kappa < 0 else (math.inf, limit)
    if nearest <= 0 or farthest == math.inf:
        return _no_stereo("no real distance is seen by two micro-images of a row")
    sharp = float(sharp_vergence(smms)[middle])
    angle = _stereo_angle(row, sharp) if sharp > 0 else None
    return Stereo(
        nearest=0.0 if math.isinf(nearest) else 1 / nearest,
        farthest=None if farthest <= 0 else 1 / farthest,
        angle=angle,
        field_angle=_field_angle(row),
        reason=""
        if angle is not None
        else "fewer than two micro-images see the point on the axis in focus",
    )


def _no_stereo(reason: str) -> Stereo:
    return Stereo(None, None, None, None, reason)


def _shared_from(smms: Smms, centre: Array, useful: Array, above: bool) -> float:
    """The vergence at which two micro-images side by side begin to share a point, as it rises
    (``above``) or falls from that of the array's own conjugate; infinite of that sign where they
    never do.
    """
    half = smms.lens_aperture / 2
    m = (centre[:, None] - useful) * (smms.distance / smms.gap)[:, None]
    first, last = np.clip(np.sort(m, axis=1), -half[:, None], half[:, None]).T
    bend, place = 1 / smms.distance - 1 / smms.lens_focal, -smms.centre_x / smms.distance
    order = np.argsort(place)
    lower, upper = order[:-1], order[1:]
    # Of the lower one the upper edge, of the upper one the lower edge: m W + place.
    near, far = (last[lower], first[upper]) if above else (first[lower], last[upper])
    base = near - far
    with np.errstate(divide="ignore", invalid="ignore"):
        limits = (place[upper] - place[lower] + far * bend[upper] - near * bend[lower]) / base
    limits = np.where(base == 0, np.inf if above else -np.inf, limits)
    return float(limits.min() if above else limits.max())


def _stereo_angle(row: RowFields, vergence: float) -> float | None:
    """2 atan(B / 2D) with B between the outermost chief rays' crossings of the main lens, for the
    point on the axis.
    """
    crossing, seen = row_chief_views(row, vergence, 0.0)
    if np.count_nonzero(seen) < 2:
        return None
    return 2 * math.atan(float(np.ptp(crossing[seen])) * vergence / 2)


def _field_angle(row: RowFields) -> float | None:
    """Opening angle of the edges of the region that two micro-images see: the second outermost
    useful fields' outer chief rays.

    The chief ray that lands at s crosses the main lens at m = (c - s) L/b and falls at o = m (1 + D
    (1/L - 1/F)) - y D/L.
    """
    lit = np.flatnonzero(~np.isnan(row.useful[:, 0]))
    if len(lit) < 2:
        return None
    smms = row.smms
    half = smms.lens_aperture / 2
    slopes = []
    for edge in (0, 1):
        m = np.clip((row.centre - row.useful[:, edge]) * smms.distance / smms.gap, -half, half)
        slopes.append(m * (1 / smms.distance - 1 / smms.lens_focal) - smms.centre_x / smms.distance)
    slope = np.sort(np.stack(slopes)[:, lit], axis=0)
    upper, lower = np.sort(slope[1])[-2], np.sort(slope[0])[1]
    return float(math.atan(upper) - math.atan(lower))
