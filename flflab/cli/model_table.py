"""What ``flflab model`` prints for a person."""

import math

from rich import box
from rich.table import Table

from flflab.cli.terminal import Terminal
from flflab.optics.area import MeasurementArea
from flflab.optics.per_type import TypeSolution
from flflab.optics.solution import CameraSolution, DistanceSolution
from flflab.optics.volume import MeasurementVolume
from flflab.units import show_quantity

DEGREES = 180 / math.pi
WORDS = (
    (
        "virtual depth: distance from the microlenses to the main lens's image of the target, over"
        " their distance to the sensor (v in the paper)"
    ),
    "magnification: size of the image on the sensor over that of the target (M)",
    "views: micro-images that show the point, along the row / on the whole sensor",
    (
        "ELR: effective lateral resolution, useful pixels along the row over the virtual depth (eq."
        " (3) of the paper), or over the mean number of views"
    ),
)


def print_tables(
    solution: CameraSolution,
    distances: list[DistanceSolution],
    areas: tuple[MeasurementArea, MeasurementArea],
    volume: MeasurementVolume,
    remarks: tuple[str, ...],
) -> None:
    """Print the camera's properties, then a line for each target distance."""
    console = Terminal()
    for remark in remarks:
        console.print(f"Note: {remark}.")
    console.print(solution.reference_planes)
    table = Table(title="The camera", show_header=False, box=box.SIMPLE)
    sharp = (
        "none: no real target is in focus"
        if solution.sharp_distance is None
        else show_quantity(solution.sharp_distance, "mm")
    )
    table.add_row("arrangement", solution.arrangement)
    table.add_row("sharp at", sharp)
    table.add_row("pitch of the micro-images", f"{solution.image_pitch * 1e3:.2f} um")
    table.add_row(
        "overlap of neighbours" if solution.overlap > 0 else "gap between neighbours",
        f"{abs(solution.overlap) * 1e3:.1f} um",
    )
    table.add_row("sensor in the exit pupil", "yes" if solution.in_exit_pupil else "no")
    table.add_row("micro-images of the main lens touch at", f"F/{solution.touching_f_number:.2f}")
    table.add_row(
        "useful pixels, row / sensor", f"{solution.useful_pixels[0]} / {solution.useful_pixels[1]}"
    )
    sharp_from = ", ".join(
        f"{show_quantity(near, 'mm')} to {show_quantity(far, 'mm')}"
        for near, far in solution.depth_of_field
    )
    table.add_row("depth of field (blur of one pixel)", sharp_from or "none")
    stereo = solution.stereo
    table.add_row(
        "seen by two micro-images of a row from",
        stereo.reason if stereo.nearest is None else show_quantity(stereo.nearest, "mm"),
    )
    if stereo.farthest is not None:
        table.add_row("seen by two micro-images of a row to", show_quantity(stereo.farthest, "mm"))
    if stereo.angle is not None:
        table.add_row("stereo angle on the axis in focus", f"{stereo.angle * DEGREES:.3f} deg")
    middle = solution.marginal_angles[len(solution.marginal_angles) // 2]
    table.add_row("marginal angle near the axis", f"{middle * DEGREES:.2f} deg")
    for name, area in zip(("some useful ray", "chief rays"), areas, strict=True):
        table.add_row(f"measurement area by {name}", area.reason or _size(area.size(), "mm^2"))
    table.add_row(
        "measurement volume by chief rays",
        volume.reason if volume.volume is None else _size(volume.volume, "mm^3"),
    )
    if len(solution.types) > 1:
        for number, one in enumerate(solution.types):
            table.add_row(
                f"microlens type {number}, f = {show_quantity(one.focal_length, 'mm')}", _type(one)
            )
    console.print(table)
    if not distances:
        return
    table = Table(title="Targets", box=box.SIMPLE, pad_edge=False, padding=(0, 1, 0, 0))
    for head in (
        "target\nmm",
        "virtual\ndepth",
        "magni-\nfication",
        "blur\num",
        "views\nrow/all",
        "ELR\neq. (3)",
        "ELR by\nviews",
        "image",
    ):
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
    console.print_table(table)
    for sentence in WORDS:
        console.print(sentence, highlight=False)


def _size(size: float, unit: str) -> str:
    return "reaches infinity" if math.isinf(size) else f"{size:.4g} {unit}"


def _type(one: TypeSolution) -> str:
    if one.sharp_distance is None:
        return f"{one.arrangement}, sharp nowhere"
    fields = ", ".join(
        f"{show_quantity(near, 'mm')} to {show_quantity(far, 'mm')}"
        for near, far in one.depth_of_field
    )
    return f"{one.arrangement}, sharp at {show_quantity(one.sharp_distance, 'mm')} ({fields})"
