"""The measurement volume: the measurement area in three dimensions, counted on a low-discrepancy
set of object points.

Source: paper, "Measurement area", taken from its row to the sensor. Lengths in mm.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.optics.area import NEAREST, Rule, sharp_ranges
from flflab.optics.camera import Camera
from flflab.optics.focus import merge_intervals
from flflab.optics.neighbours import even_points, pairs_within
from flflab.optics.smms import image_offset
from flflab.optics.useful import SensorFields, select, sensor_fields
from flflab.optics.views import chief_seen_by, seen_by

Array = npt.NDArray[np.float64]
# Gauss-Legendre's six nodes and weights on (-1, 1); Abramowitz and Stegun, table 25.4.
_NODES = np.array([0.2386191860831969, 0.6612093864662645, 0.9324695142031521])
_WEIGHTS = np.array([0.4679139345726910, 0.3607615730481386, 0.1713244923791704])
# Pairs of an object point and a microlens at a time.
_PAIRS = 1 << 20


@dataclass(frozen=True)
class MeasurementVolume:
    """Volume in mm^3 that enough micro-images see sharply, and how far two halves of the points
    disagree about it.

    ``volume`` is None where it is not bounded or not there, and ``reason`` says which.
    """

    volume: float | None
    uncertainty: float
    reason: str


def measurement_volume(
    camera: Camera,
    by: Rule = "chief",
    views: int = 2,
    circle: float | None = None,
    points: int = 1024,
    fields: SensorFields | None = None,
) -> MeasurementVolume:
    """Volume of the points that at least ``views`` micro-images see inside their depths of field.

    Depth by six Gauss-Legendre planes in each piece of the depth of field, height and width by
    ``points`` object points a plane.

    Args:
        camera: the camera.
        by: "chief" views or "total" (some useful ray; slower, rays are traced).
        views: least number of micro-images.
        circle: permitted blur on the sensor, mm; one pixel unless told.
        points: object points a plane.
        fields: the camera's useful regions, where they are known already.
    """
    fields = fields or sensor_fields(camera)
    kinds, kind = np.unique(fields.smms.focal, return_inverse=True)
    first = np.array([int(np.flatnonzero(kind == one)[0]) for one in range(len(kinds))])
    ranges = sharp_ranges(
        select(fields.smms, first),
        circle or camera.sensor.pixel,
        NEAREST * camera.main_lens.focal_length,
    )
    cuts = sorted({end for one in ranges for part in one for end in part})
    pieces = [
        (a, b)
        for a, b in itertools.pairwise(cuts)
        if any(lo <= a and b <= hi for one in ranges for lo, hi in one)
    ]
    if not merge_intervals([part for one in ranges for part in one]):
        return MeasurementVolume(None, 0.0, "no micro-image is sharp at a real distance")
    node, weight = np.concatenate([-_NODES, _NODES]), np.concatenate([_WEIGHTS, _WEIGHTS])
    totals = np.zeros(2)
    for low, high in pieces:
        sharp = np.array([any(lo <= low and high <= hi for lo, hi in one) for one in ranges])[kind]
        if low == 0:
            if _counts(fields, sharp, 1e-3 * high, by, views, points)[0].any():
                return MeasurementVolume(None, 0.0, "it reaches infinity")
            continue
        near, far = 1 / high, 1 / low
        for distance, share in zip(
            (near + far) / 2 + node * (far - near) / 2, weight * (far - near) / 2, strict=True
        ):
            seen, box = _counts(fields, sharp, 1 / float(distance), by, views, points)
            halves = np.array([seen[: points // 2].mean(), seen[points // 2 :].mean()])
            totals += share * box * distance**2 * halves
    volume = float(totals.mean())
    if volume == 0:
        return MeasurementVolume(None, 0.0, f"no sharp point is seen by {views} micro-images")
    return MeasurementVolume(volume, float(np.ptp(totals)) / math.sqrt(2), "")


def _counts(
    fields: SensorFields,
    sharp: npt.NDArray[np.bool_],
    vergence: float,
    by: Rule,
    views: int,
    points: int,
) -> tuple[npt.NDArray[np.bool_], float]:
    """Whether each of ``points`` object points is seen often enough by sharp microlenses, and the
    area of their box in (o V)^2.
    """
    members = np.flatnonzero(sharp)
    smms = select(fields.smms, members)
    x = image_offset(smms, vergence)
    stops = smms.lens_aperture * np.abs(x), smms.aperture
    reach = (stops[0] + stops[1] if by == "total" else np.maximum(*stops)) / 2
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)
    lit = np.all(
        (fields.centre[members] >= fields.low) & (fields.centre[members] <= fields.high), axis=1
    )
    if not np.any(lit):
        return np.zeros(points, dtype=np.bool_), 0.0
    members, smms, centre, reach = (
        members[lit],
        select(smms, np.flatnonzero(lit)),
        centre[lit],
        reach[lit],
    )
    # In the coordinate -o V L a microlens sees what lies within its reach of its own centre.
    low, high = (centre - reach[:, None]).min(axis=0), (centre + reach[:, None]).max(axis=0)
    scale = float(smms.distance.mean())
    low, high = low - 0.01 * (high - low), high + 0.01 * (high - low)
    at = low + (high - low) * even_points(points)
    near = float(reach.max() + np.abs(smms.distance / scale - 1).max() * np.abs(at).max())
    seen: list[npt.NDArray[np.bool_]] = []
    expected = points * len(members) * min(1.0, (2 * near) ** 2 / float(np.prod(high - low)))
    for some in np.array_split(at, 1 + int(expected) // _PAIRS):
        pairs = pairs_within(some, centre, near)
        owner, angle = members[pairs[:, 1]], -some[pairs[:, 0]] / scale
        hit = chief_seen_by(fields, owner, vergence, angle)
        count = np.bincount(pairs[hit, 0], minlength=len(some))
        if by == "total":
            # Rays are traced only where chief views, which are total views too, do not decide.
            possible = np.bincount(pairs[:, 0], minlength=len(some))
            undecided = ((count < views) & (possible >= views))[pairs[:, 0]]
            rest = np.flatnonzero(~hit & undecided)
            traced = seen_by(fields, owner[rest], vergence, angle[rest])[0]
            count += np.bincount(pairs[rest[traced], 0], minlength=len(some))
        seen.append(count >= views)
    return np.concatenate(seen), float(np.prod(high - low)) / scale**2
