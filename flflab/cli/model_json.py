"""The contract of ``flflab model --json``: names, units (mm, degrees) and the reason for everything
that is null.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.optics.area import MeasurementArea
from flflab.optics.boundary import BOUNDARY_NAMES, Rays, boundary_rays, object_fields, useful_rays
from flflab.optics.brightness import irradiance
from flflab.optics.camera import Camera, microlens_indices
from flflab.optics.focus import vergence_of
from flflab.optics.per_type import TypeSolution
from flflab.optics.solution import CameraSolution, DistanceSolution
from flflab.optics.useful import sensor_edges
from flflab.optics.volume import MeasurementVolume

Array = npt.NDArray[np.float64]
DEGREES = 180 / math.pi


def as_json(
    camera: Camera,
    solution: CameraSolution,
    distances: list[DistanceSolution],
    areas: tuple[MeasurementArea, MeasurementArea],
    volume: MeasurementVolume,
) -> dict[str, Any]:
    """The contract of ``model --json``: mm and degrees; null where infinite or absent, with a
    reason.
    """
    reasons: dict[str, str] = {}
    stereo = solution.stereo
    if solution.sharp_distance is None:
        reasons["sharp_distance_mm"] = "no real target distance is in focus on the sensor"
    elif math.isinf(solution.sharp_distance):
        reasons["sharp_distance_mm"] = "the camera is focused at infinity"
    for key, value in (
        ("nearest_mm", stereo.nearest),
        ("farthest_mm", stereo.farthest),
        ("angle_deg", stereo.angle),
    ):
        if value is None:
            reasons[f"stereo.{key}"] = (
                stereo.reason
                or "unbounded: every farther point is seen by two micro-images as well"
            )
    if not solution.depth_of_field:
        reasons["depth_of_field_mm"] = "no real target distance is sharp to one pixel"
    for number, (_, far) in enumerate(solution.depth_of_field):
        if math.isinf(far):
            reasons[f"depth_of_field_mm[{number}][1]"] = "the depth of field reaches infinity"
    result: dict[str, Any] = {
        "arrangement": solution.arrangement,
        "sharp_distance_mm": _number(solution.sharp_distance),
        "image_pitch_mm": solution.image_pitch,
        "overlap": solution.overlap > 0,
        "overlap_mm": solution.overlap,
        "in_exit_pupil": solution.in_exit_pupil,
        "touching_f_number": solution.touching_f_number,
        "useful_pixels": {"row": solution.useful_pixels[0], "sensor": solution.useful_pixels[1]},
        "depth_of_field_mm": [
            [_number(near), _number(far)] for near, far in solution.depth_of_field
        ],
        "stereo": {
            "nearest_mm": _number(stereo.nearest),
            "farthest_mm": _number(stereo.farthest),
            "angle_deg": None if stereo.angle is None else stereo.angle * DEGREES,
            "field_angle_deg": None if stereo.field_angle is None else stereo.field_angle * DEGREES,
        },
        "microlenses": _microlenses(camera, solution, reasons),
        "types": [_type(one, number, reasons) for number, one in enumerate(solution.types)],
        "measurement_area": {
            name: _area(area, name, reasons)
            for name, area in zip(("total", "chief"), areas, strict=True)
        },
        "measurement_volume": {"mm3": volume.volume, "uncertainty_mm3": volume.uncertainty},
        "distances": [
            _distance_json(one, number, camera, solution, reasons)
            for number, one in enumerate(distances)
        ],
        "reference_planes": solution.reference_planes,
    }
    if volume.volume is None:
        reasons["measurement_volume.mm3"] = volume.reason
    if stereo.field_angle is None:
        reasons["stereo.field_angle_deg"] = (
            stereo.reason or "fewer than two micro-images of the row are useful"
        )
    result["reasons"] = reasons
    return result


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _microlenses(
    camera: Camera, solution: CameraSolution, reasons: dict[str, str]
) -> list[dict[str, Any]]:
    row = solution.row
    low, high = (float(edge[0]) for edge in sensor_edges(camera))
    for i in np.flatnonzero(np.isnan(row.useful[:, 0])):
        off = not low <= row.centre[i] <= high
        reasons[f"microlenses[{i}].useful_mm"] = (
            "its micro-image's centre is off the sensor"
            if off
            else "its middle is dark or overlapped"
        )
    indices = microlens_indices(camera.array)[row.members]
    inside, outside = row.smms.inside_radius, row.smms.outside_radius
    boundary, useful, shares = (
        boundary_rays(row.smms),
        useful_rays(row.smms, row.useful),
        irradiance(row.smms),
    )
    return [
        {
            "index": [int(index) for index in indices[i]],
            "centre_mm": float(row.smms.centre_x[i]),
            "image_centre_mm": float(row.centre[i]),
            "inside_mm": [float(row.centre[i] - inside[i]), float(row.centre[i] + inside[i])],
            "outside_mm": [float(row.centre[i] - outside[i]), float(row.centre[i] + outside[i])],
            "useful_mm": None
            if math.isnan(row.useful[i, 0])
            else [float(edge) for edge in row.useful[i]],
            "marginal_angle_deg": solution.marginal_angles[i] * DEGREES,
            "irradiance": float(shares[i]),
            "boundary_rays": {
                name: _ray(boundary, i, number) for number, name in enumerate(BOUNDARY_NAMES)
            },
            "useful_rays": [
                _ray(useful, i, number) for number in range(12) if useful.exists[i, number]
            ],
        }
        for i in range(len(row.members))
    ]


def _ray(rays: Rays, index: int, number: int) -> dict[str, float]:
    """Where a ray crosses the planes; on the object side it is at main_lens_mm + distance *
    object_slope.
    """
    return {
        "main_lens_mm": float(rays.main_lens[index, number]),
        "microlens_mm": float(rays.microlens[index, number]),
        "sensor_mm": float(rays.sensor[index, number]),
        "object_slope": float(rays.object_slope[index, number]),
    }


def _type(one: TypeSolution, number: int, reasons: dict[str, str]) -> dict[str, Any]:
    if one.sharp_distance is None:
        reasons[f"types[{number}].sharp_distance_mm"] = (
            "no real target distance is in focus on the sensor"
        )
    elif math.isinf(one.sharp_distance):
        reasons[f"types[{number}].sharp_distance_mm"] = "in focus at infinity"
    for piece, (_, far) in enumerate(one.depth_of_field):
        if math.isinf(far):
            reasons[f"types[{number}].depth_of_field_mm[{piece}][1]"] = (
                "the depth of field reaches infinity"
            )
    return {
        "focal_length_mm": one.focal_length,
        "arrangement": one.arrangement,
        "sharp_distance_mm": _number(one.sharp_distance),
        "depth_of_field_mm": [[_number(near), _number(far)] for near, far in one.depth_of_field],
        "inside_width_mm": 2 * one.inside_radius,
        "outside_width_mm": 2 * one.outside_radius,
    }


def _area(area: MeasurementArea, name: str, reasons: dict[str, str]) -> dict[str, Any]:
    """Corners as (z, y), the target at z < 0, and beside them homogeneous (-1, y/D, 1/D), which are
    finite at infinity too.
    """
    place = f"measurement_area.{name}"
    size = area.size()
    if area.reason:
        reasons[f"{place}.polygons"] = area.reason
    elif math.isinf(size):
        reasons[f"{place}.mm2"] = reasons[f"{place}.polygons"] = (
            "the area reaches infinity, where corners are null: read them in the homogeneous ones"
        )
    return {
        "polygons": [
            [[_number(float(z)), _number(float(y))] for z, y in part] for part in area.corners()
        ],
        "homogeneous": [[[-1.0, float(w), float(v)] for v, w in part] for part in area.polygons],
        "mm2": _number(size),
    }


def _fields(
    camera: Camera, solution: CameraSolution, distance: float, place: str, reasons: dict[str, str]
) -> list[dict[str, Any]]:
    """Bright and total field of each microlens of the row in the target's plane; mm, or degrees at
    infinity.
    """
    row = solution.row
    found = object_fields(row.smms, row.useful, vergence_of(distance))
    indices = microlens_indices(camera.array)[row.members]

    def interval(pair: Array) -> list[float] | None:
        if np.isnan(pair[0]):
            return None
        return [
            math.atan(end) * DEGREES if math.isinf(distance) else float(end) * distance
            for end in pair.tolist()
        ]

    unit = "deg" if math.isinf(distance) else "mm"
    for i in range(len(row.members)):
        if np.isnan(found.useful_total[i, 0]):
            reasons[f"{place}.fields[{i}].useful_total_{unit}"] = (
                "this microlens has no useful interval"
            )
        if np.isnan(found.useful_bright[i, 0]):
            reasons[f"{place}.fields[{i}].useful_bright_{unit}"] = (
                "no point of this plane sends its whole cone into the useful interval"
            )
    return [
        {
            "index": [int(part) for part in indices[i]],
            f"bright_{unit}": interval(found.bright[i]),
            f"total_{unit}": interval(found.total[i]),
            f"useful_bright_{unit}": interval(found.useful_bright[i]),
            f"useful_total_{unit}": interval(found.useful_total[i]),
        }
        for i in range(len(row.members))
    ]


def _distance_json(
    one: DistanceSolution,
    number: int,
    camera: Camera,
    solution: CameraSolution,
    reasons: dict[str, str],
) -> dict[str, Any]:
    place = f"distances[{number}]"
    if math.isinf(one.distance):
        reasons[f"{place}.distance_mm"] = "the target is at infinity"
    if not math.isfinite(one.image_distance):
        reasons[f"{place}.image_distance_mm"] = "the target lies in the front focal plane"
    for name, value in (("virtual_depth", one.virtual_depth), ("magnification", one.magnification)):
        if not math.isfinite(value):
            reasons[f"{place}.{name}"] = "the target's image lies on the array or at infinity"
    if not math.isfinite(one.magnification):
        reasons[f"{place}.mtf.cycles_per_mm"] = reasons[f"{place}.types"] = (
            "the magnification is infinite"
        )
    if not math.isfinite(one.blur):
        reasons[f"{place}.blur_mm"] = "the target's image lies at infinity"
    for axis, value in zip(("row", "sensor"), one.resolution_by_views, strict=True):
        if value is None:
            reasons[f"{place}.elr_by_views.{axis}"] = (
                "fewer than one micro-image sees a point on average"
            )
    for axis, resolved in zip(("row", "sensor"), one.resolution, strict=True):
        if not math.isfinite(resolved):
            reasons[f"{place}.elr.{axis}"] = "the virtual depth is 0"
    views = {
        axis: {"total": count.total, "bright": count.bright, "chief": count.chief}
        for axis, count in (("row", one.row_views), ("sensor", one.sensor_views))
    }
    return {
        "distance_mm": _number(one.distance),
        "image_distance_mm": _number(one.image_distance),
        "arrangement": one.arrangement,
        "virtual_depth": _number(one.virtual_depth),
        "magnification": _number(one.magnification),
        "blur_mm": _number(one.blur),
        "views": views,
        "elr": {"row": _number(one.resolution[0]), "sensor": _number(one.resolution[1])},
        "elr_by_views": {"row": one.resolution_by_views[0], "sensor": one.resolution_by_views[1]},
        "mtf": {
            "cycles_per_mm": [_number(value) for value in one.cycles_per_mm],
            "contrast_paper": list(one.contrast_paper),
            "mtf_pixel": list(one.mtf_pixel),
            "mtf": [_number(value) for value in one.mtf],
        },
        "types": [
            {"magnification": _number(enlarged), "blur_mm": _number(spot)}
            for enlarged, spot in one.by_type
        ],
        "fields": _fields(camera, solution, one.distance, place, reasons),
    }
