"""``flflab model CAMERA``: what the model says of a camera and of targets at given distances."""

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from flflab.camera_file import CameraDescription
from flflab.cli.ending import print_json
from flflab.description import load
from flflab.errors import InputError
from flflab.optics.camera import Camera, microlens_indices
from flflab.optics.solution import CameraSolution, DistanceSolution, solve_camera, solve_distance
from flflab.optics.useful import sensor_fields
from flflab.units import parse_quantity, show_quantity

DEGREES = 180 / math.pi


def model(
    camera: Annotated[Path, typer.Argument(help="camera file (YAML)")],
    distance: Annotated[list[str] | None, typer.Option(help="target distance with its unit, or infinity; may be repeated")] = None,
    json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output (mm, degrees)")] = False,
) -> None:
    """State every property the model has for a camera; distances are measured from the main lens."""
    description = load(camera, CameraDescription)
    described = description.camera()
    distances = [_distance(given) for given in distance or []]
    solution = solve_camera(described)
    if not distances and solution.sharp_distance is not None:
        distances = [solution.sharp_distance]
    fields = sensor_fields(described)
    solved = [solve_distance(described, one, solution.useful_pixels, fields, solution.row) for one in distances]
    if json:
        print_json(as_json(described, solution, solved))
    else:
        _print(solution, solved, description.remarks())


def _distance(given: str) -> float:
    value = parse_quantity(given, "length")
    if not value > 0:
        raise InputError(f"--distance {given}: a distance in front of the main lens is above 0 mm, or infinity")
    return value


def as_json(camera: Camera, solution: CameraSolution, distances: list[DistanceSolution]) -> dict[str, Any]:
    """The contract of ``model --json``: mm and degrees; null where infinite or absent, with a reason."""
    reasons: dict[str, str] = {}
    stereo = solution.stereo
    if solution.sharp_distance is None:
        reasons["sharp_distance_mm"] = "no real target distance is in focus on the sensor"
    elif math.isinf(solution.sharp_distance):
        reasons["sharp_distance_mm"] = "the camera is focused at infinity"
    for key, value in (("nearest_mm", stereo.nearest), ("farthest_mm", stereo.farthest), ("angle_deg", stereo.angle)):
        if value is None:
            reasons[f"stereo.{key}"] = stereo.reason or "unbounded: every farther point is seen by two micro-images as well"
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
        "depth_of_field_mm": [[_number(near), _number(far)] for near, far in solution.depth_of_field],
        "stereo": {
            "nearest_mm": _number(stereo.nearest),
            "farthest_mm": _number(stereo.farthest),
            "angle_deg": None if stereo.angle is None else stereo.angle * DEGREES,
            "field_angle_deg": None if stereo.field_angle is None else stereo.field_angle * DEGREES,
        },
        "microlenses": _microlenses(camera, solution),
        "distances": [_distance_json(one, number, reasons) for number, one in enumerate(distances)],
    }
    result["reasons"] = reasons
    return result


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _microlenses(camera: Camera, solution: CameraSolution) -> list[dict[str, Any]]:
    row = solution.row
    indices = microlens_indices(camera.array)[row.members]
    inside, outside = row.smms.inside_radius, row.smms.outside_radius
    return [
        {
            "index": [int(index) for index in indices[i]],
            "centre_mm": float(row.smms.centre_x[i]),
            "image_centre_mm": float(row.centre[i]),
            "inside_mm": [float(row.centre[i] - inside[i]), float(row.centre[i] + inside[i])],
            "outside_mm": [float(row.centre[i] - outside[i]), float(row.centre[i] + outside[i])],
            "useful_mm": None if math.isnan(row.useful[i, 0]) else [float(edge) for edge in row.useful[i]],
            "marginal_angle_deg": solution.marginal_angles[i] * DEGREES,
        }
        for i in range(len(row.members))
    ]


def _distance_json(one: DistanceSolution, number: int, reasons: dict[str, str]) -> dict[str, Any]:
    place = f"distances[{number}]"
    if math.isinf(one.distance):
        reasons[f"{place}.distance_mm"] = "the target is at infinity"
    if not math.isfinite(one.image_distance):
        reasons[f"{place}.image_distance_mm"] = "the target lies in the front focal plane"
    for name, value in (("virtual_depth", one.virtual_depth), ("magnification", one.magnification)):
        if not math.isfinite(value):
            reasons[f"{place}.{name}"] = "the target's image lies on the array or at infinity"
    for axis, value in zip(("row", "sensor"), one.resolution_by_views, strict=True):
        if value is None:
            reasons[f"{place}.elr_by_views.{axis}"] = "fewer than one micro-image sees a point on average"
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
    }


def _print(solution: CameraSolution, distances: list[DistanceSolution], remarks: tuple[str, ...]) -> None:
    console = Console()
    for remark in remarks:
        console.print(f"Note: {remark}.")
    table = Table(title="The camera (distances from the main lens)", show_header=False, box=box.SIMPLE)
    sharp = "none: no real target is in focus" if solution.sharp_distance is None else show_quantity(solution.sharp_distance, "mm")
    table.add_row("arrangement", solution.arrangement)
    table.add_row("sharp at", sharp)
    table.add_row("pitch of the micro-images", f"{solution.image_pitch * 1e3:.2f} um")
    table.add_row("overlap of neighbours" if solution.overlap > 0 else "gap between neighbours", f"{abs(solution.overlap) * 1e3:.1f} um")
    table.add_row("sensor in the exit pupil", "yes" if solution.in_exit_pupil else "no")
    table.add_row("micro-images of the main lens touch at", f"F/{solution.touching_f_number:.2f}")
    table.add_row("useful pixels, row / sensor", f"{solution.useful_pixels[0]} / {solution.useful_pixels[1]}")
    sharp_from = ", ".join(f"{show_quantity(near, 'mm')} to {show_quantity(far, 'mm')}" for near, far in solution.depth_of_field)
    table.add_row("depth of field (blur of one pixel)", sharp_from or "none")
    stereo = solution.stereo
    table.add_row(
        "seen by two micro-images of a row from", stereo.reason if stereo.nearest is None else show_quantity(stereo.nearest, "mm")
    )
    if stereo.farthest is not None:
        table.add_row("seen by two micro-images of a row to", show_quantity(stereo.farthest, "mm"))
    if stereo.angle is not None:
        table.add_row("stereo angle on the axis in focus", f"{stereo.angle * DEGREES:.3f} deg")
    middle = solution.marginal_angles[len(solution.marginal_angles) // 2]
    table.add_row("marginal angle near the axis", f"{middle * DEGREES:.2f} deg")
    console.print(table)
    if not distances:
        return
    table = Table(title="Targets: views along the row / on the sensor; ELR along the row by eq. (3) and by views", box=box.SIMPLE)
    for head in ("D mm", "v", "M", "blur um", "views", "ELR", "by views", "image"):
        table.add_column(head, justify="left" if head == "image" else "right")
    for one in distances:
        table.add_row(
            show_quantity(one.distance, ""),
            f"{one.virtual_depth:.4g}",
            f"{one.magnification:.4g}",
            f"{one.blur * 1e3:.2f}",
            f"{one.row_views.chief} / {one.sensor_views.chief}",
            f"{one.resolution[0]:.0f}",
            "none" if one.resolution_by_views[0] is None else f"{one.resolution_by_views[0]:.0f}",
            one.arrangement,
        )
    console.print(table)
