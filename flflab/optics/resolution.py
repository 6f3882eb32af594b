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
from flflab.optics.smms import Smms, camera_smms, image_offset
from flflab.optics.useful import RowFields, SensorFields, in_useful, row_fields, select
from flflab.optics.views import chief_crossings

Array = npt.NDArray[np.float64]
_GRID = 201


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


def mean_row_views(row: RowFields, pitch: float, vergence: float) -> float:
    """Mean number of chief views along the row over one period, for the microlens nearest the axis
    and its likes.

    2/p min(max(A |x|, d)/2, reach) with reach the half width, at the array, of the rays that land
    in the useful interval.
    """
    middle = int(np.argmin(np.abs(row.centre)))
    if np.isnan(row.useful[middle, 0]):
        return 0.0
    smms = select(row.smms, np.array([middle]))
    return float(
        _reach_lengths(smms, vergence, row.centre[middle], row.useful[middle]).sum() / pitch
    )


def _reach_lengths(smms: Smms, vergence: float, centre: float, useful: Array) -> Array:
    """Lengths, on both sides of the microlens, of the shifts y + o V L whose chief ray lands in the
    useful interval.
    """
    x = float(image_offset(smms, vergence)[0])
    stop = max(float(smms.lens_aperture[0]) * abs(x), float(smms.aperture[0])) / 2
    by_microlens = bool(microlens_limits(smms, vergence)[0])
    per_shift = (
        float(smms.gap[0] / smms.distance[0]) / abs(x)
        if by_microlens
        else abs(float(smms.kappa[0]))
    )
    with np.errstate(divide="ignore"):
        sides = np.abs(useful - centre) / np.float64(per_shift)
    return np.minimum(sides, stop)


def mean_sensor_views(fields: SensorFields, camera: Camera, vergence: float) -> float:
    """Mean number of chief views on the sensor over one cell of the lattice, by counting a 201 x
    201 grid of object points.
    """
    middle = int(np.argmin(np.round(np.hypot(fields.smms.centre_x, fields.smms.centre_y), 12)))
    owner = np.full(_GRID**2, middle)
    smms = select(fields.smms, owner)
    x = float(image_offset(smms, vergence)[0])
    reach = max(float(smms.lens_aperture[0]) * abs(x), float(smms.aperture[0])) / 2
    steps = (np.arange(_GRID) + 0.5) / _GRID * 2 - 1
    shift = reach * np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    own = np.stack([smms.centre_x, smms.centre_y], axis=1)
    _, passes, landing = chief_crossings(
        smms, vergence, (shift - own) / smms.distance[:, None], own, fields.shape
    )
    seen = passes & in_useful(fields, owner, landing)
    pitch_x, pitch_y = camera.array.pitch
    cell = pitch_x * pitch_y * (math.sqrt(3) / 2 if camera.array.layout == "hexagonal" else 1.0)
    return float(np.mean(seen)) * (2 * reach) ** 2 / cell


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
    """The stereo condition of the row: |x| >= p / A_u on the side of focus, for the first point
    seen twice.

    A_u = min(max(A, d/|x|), 2 u L/b) is the base over which a point's chief rays are useful.
    """
    row = row_fields(camera)
    middle = int(np.argmin(np.abs(row.centre)))
    if np.isnan(row.useful[middle, 0]):
        return Stereo(
            None, None, None, None, "the micro-image nearest the axis has no useful interval"
        )
    smms = select(row.smms, np.array([middle]))
    length, gap, kappa = float(smms.distance[0]), float(smms.gap[0]), float(smms.kappa[0])
    aperture, d = float(smms.lens_aperture[0]), float(smms.aperture[0])
    if kappa == 0:
        return Stereo(
            None, None, None, None, "the sensor lies in the exit pupil and no target is in focus"
        )
    pitch = camera.array.pitch[0]
    base = float(np.ptp(row.useful[middle])) * length / gap
    # |x| min(max(A, d/|x|), B) >= p; the branch d/|x| has |x| A_u = d < p unless the microlenses
    # touch.
    candidates = [pitch / min(aperture, base)]
    if d >= pitch and base > 0:
        candidates.append(pitch / base)
    least = min(candidates) if base > 0 else math.inf
    focal = float(smms.lens_focal[0])

    def vergence(x: float) -> float:
        return 1 / focal - (1 - x) / length

    side = math.copysign(1.0, kappa)
    nearest, farthest = (
        (vergence(side * least), 0.0) if side < 0 else (math.inf, vergence(side * least))
    )
    if nearest <= 0 or nearest < max(farthest, 0.0):
        return Stereo(
            None, None, None, None, "no real distance is seen by two micro-images of a row"
        )
    sharp = float(sharp_vergence(smms)[0])
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


def _stereo_angle(row: RowFields, vergence: float) -> float | None:
    """2 atan(B / 2D) with B between the outermost chief rays' crossings of the main lens, for the
    point on the axis.
    """
    crossing, passes, landing = chief_crossings(
        row.smms, vergence, np.zeros(1), row.smms.centre_x[:, None]
    )
    with np.errstate(invalid="ignore"):
        seen = passes & (landing[:, 0] >= row.useful[:, 0]) & (landing[:, 0] <= row.useful[:, 1])
    if np.count_nonzero(seen) < 2:
        return None
    return 2 * math.atan(float(np.ptp(crossing[seen, 0])) * vergence / 2)


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
