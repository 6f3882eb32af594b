"""How many pixels are useful: R_u of eq. (3), along the row and on the sensor.

A pixel row meets a round micro-image in a chord; what a neighbour hides of it, its disc and all
behind it as seen from the micro-image's centre, is convex and meets the row in one interval. So
pixels are counted by intervals, not one by one.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import Camera
from flflab.optics.useful import SensorFields, in_useful, row_fields, sensor_edges, sensor_fields

Array = npt.NDArray[np.float64]
_CHUNK = 400_000


def useful_pixels(camera: Camera, fields: SensorFields | None = None) -> tuple[int, int]:
    """Number of pixels whose centre lies in some useful region: along the row nearest the axis, and
    on the whole sensor.

    Args:
        camera: the camera.
        fields: its useful regions, where they are known already.
    """
    columns = camera.sensor.resolution[0]
    low, _ = sensor_edges(camera)
    pixel = camera.sensor.pixel
    row = row_fields(camera).useful
    row = row[~np.isnan(row[:, 0])]
    first = np.ceil((row[:, 0] - low[0]) / pixel - 0.5)
    last = np.floor((row[:, 1] - low[0]) / pixel - 0.5)
    along = int(np.sum(np.clip(np.minimum(last, columns - 1) - np.maximum(first, 0) + 1, 0, None)))
    fields = fields or sensor_fields(camera)
    return along, (
        _round_pixels(camera, fields) if fields.shape == "round" else _square_pixels(camera, fields)
    )


def _lit(fields: SensorFields) -> npt.NDArray[np.int64]:
    """Micro-images whose centre is on the sensor and in nobody else's light."""
    members = np.flatnonzero(
        np.all((fields.centre >= fields.low) & (fields.centre <= fields.high), axis=1)
        & (fields.radius > 0)
    )
    return members[in_useful(fields, members, fields.centre[members])]


def _round_pixels(camera: Camera, fields: SensorFields) -> int:
    members, (columns, rows), pixel = _lit(fields), camera.sensor.resolution, camera.sensor.pixel
    if len(members) == 0:
        return 0
    height = min(math.ceil(2 * float(fields.radius.max()) / pixel) + 2, rows)
    step = max(1, _CHUNK // (height * max(1, fields.neighbours.shape[1])))
    total = 0
    for start in range(0, len(members), step):
        part = members[start : start + step]
        centre, radius = fields.centre[part], fields.radius[part][:, None]
        lowest = np.floor((centre[:, 1:] - radius - fields.low[1]) / pixel - 0.5)
        row = np.clip(lowest, 0, rows - height) + np.arange(height)
        up = fields.low[1] + (row + 0.5) * pixel - centre[:, 1:]
        with np.errstate(invalid="ignore"):
            half = np.sqrt((radius - np.abs(up)) * (radius + np.abs(up)))
        exists = np.abs(up) <= radius
        # The rim of the total field is dark and no longer useful.
        dark = (radius >= fields.smms.outside_radius[part][:, None]).astype(np.float64)
        place = (centre[:, :1] - fields.low[0]) / pixel - 0.5
        half = np.where(exists, half, 0.0) / pixel
        first = np.where(dark == 1, np.floor(place - half) + 1, np.ceil(place - half))
        last = np.where(dark == 1, np.ceil(place + half) - 1, np.floor(place + half))
        first, last = np.maximum(first, 0), np.minimum(last, columns - 1)
        hidden = _hidden(fields, part, up, place, pixel, first, last)
        total += int(np.sum(np.where(exists, np.maximum(last - first + 1, 0) - hidden, 0)))
    return total


def _hidden(
    fields: SensorFields,
    part: npt.NDArray[np.int64],
    up: Array,
    place: Array,
    pixel: float,
    first: Array,
    last: Array,
) -> Array:
    """Number of pixels from ``first`` to ``last`` of each row (shape (n, rows)) that some
    neighbour's light or shadow covers.
    """
    other = fields.neighbours[part]
    if other.shape[1] == 0:
        return np.zeros(up.shape)
    present = other >= 0
    # What stands where there is no neighbour hides nothing, but must lie beside the centre.
    gap = np.where(present[..., None], fields.centre[other] - fields.centre[part][:, None], 1.0)
    radius = np.where(present, fields.blocked[other], 0.0)
    reach = np.hypot(gap[..., 0], gap[..., 1])
    side = np.sqrt(np.maximum((reach - radius) * (reach + radius), 0.0))
    # Tangents from the centre: the shadow's straight edges, beginning where they touch.
    cos, sin = side / reach, radius / reach
    edges = [
        side[...,
        None] * np.stack([gap[..., 0] * cos - turn * gap[..., 1] * sin,
        gap[..., 1] * cos + turn * gap[..., 0] * sin], axis=-1)
        / reach[..., None]
        for turn in (-1.0, 1.0)
    ]  # fmt: skip
    t, gx, gy, r = up[:, :, None], gap[:, None, :, 0], gap[:, None, :, 1], radius[:, None, :]
    with np.errstate(invalid="ignore", divide="ignore"):
        across = np.sqrt((r - np.abs(t - gy)) * (r + np.abs(t - gy)))
        ends: list[Array] = []
        for sign in (-1.0, 1.0):
            x = gx + sign * across
            ends.append(np.where(x * gx + t * gy <= (side**2)[:, None, :], x, np.nan))
        for edge in edges:
            share = t / edge[:, None, :, 1]
            ends.append(np.where(share >= 1, share * edge[:, None, :, 0], np.nan))
    found = np.stack(ends)
    some = ~np.all(np.isnan(found), axis=0) & present[:, None, :]
    low = np.where(some, np.where(np.isnan(found), np.inf, found).min(axis=0), np.inf)
    high = np.where(some, np.where(np.isnan(found), -np.inf, found).max(axis=0), -np.inf)
    # A row along which the shadow never ends: the direction of x lies between the tangents.
    endless = (np.abs(gap[..., 1]) < radius)[:, None, :]
    low, high = (
        np.where(some & endless & (gx < 0), -np.inf, low),
        np.where(some & endless & (gx > 0), np.inf, high),
    )
    begin = np.maximum(
        np.where(some, np.floor(place[:, :, None] + low / pixel) + 1, np.inf), first[..., None]
    )
    end = np.minimum(
        np.where(some, np.ceil(place[:, :, None] + high / pixel) - 1, -np.inf), last[..., None]
    )
    order = np.argsort(begin, axis=-1)
    begin, end = np.take_along_axis(begin, order, axis=-1), np.take_along_axis(end, order, axis=-1)
    before = np.concatenate(
        [np.full((*end.shape[:2], 1), -np.inf), np.maximum.accumulate(end, axis=-1)[..., :-1]],
        axis=-1,
    )
    covered = np.where(begin <= end, end - np.maximum(begin - 1, before), 0.0)
    return np.maximum(covered, 0.0).sum(axis=-1)


def _square_pixels(camera: Camera, fields: SensorFields) -> int:
    columns, rows = camera.sensor.resolution
    low, pixel = fields.low, camera.sensor.pixel
    total = 0
    for i in _lit(fields):
        first = np.maximum(
            np.floor((fields.centre[i] - fields.radius[i] - low) / pixel - 0.5).astype(int), 0
        )
        last = np.minimum(
            np.ceil((fields.centre[i] + fields.radius[i] - low) / pixel - 0.5).astype(int),
            [columns - 1, rows - 1],
        )
        x, y = (
            low[axis] + (np.arange(first[axis], last[axis] + 1) + 0.5) * pixel for axis in (0, 1)
        )
        for some in np.array_split(y, 1 + len(x) * len(y) // _CHUNK):
            points = np.stack(np.meshgrid(x, some), axis=-1).reshape(-1, 2)
            total += int(np.count_nonzero(in_useful(fields, np.full(len(points), i), points)))
    return total
