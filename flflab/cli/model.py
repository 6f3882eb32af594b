"""``flflab model CAMERA``: what the model says of a camera and of targets at given distances."""

from pathlib import Path
from typing import Annotated

import typer

from flflab.cli.as_json import print_json
from flflab.cli.quantities import option_quantity
from flflab.errors import InputError


def model(
    camera: Annotated[Path, typer.Argument(help="camera file (YAML)")],
    distance: Annotated[
        list[str] | None,
        typer.Option(help="target distance with its unit, or infinity; may be repeated"),
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="one JSON object on standard output (mm, degrees)")
    ] = False,
    figures: Annotated[
        Path | None,
        typer.Option(help="folder for the paper's Figures 1 to 9, drawn for this camera"),
    ] = None,
) -> None:
    """State every property the model has for a camera; distances are measured from the main
    lens.
    """
    from flflab.cli.model_json import as_json
    from flflab.description import load
    from flflab.files.camera import CameraDescription  # help waits for none of it
    from flflab.optics.area import measurement_area
    from flflab.optics.solution import solve_camera, solve_distance
    from flflab.optics.useful import sensor_fields
    from flflab.optics.volume import measurement_volume
    from flflab.whole_file import make_folder

    if figures is not None:
        make_folder(figures, f"--figures {figures}")
    description = load(camera, CameraDescription)
    described = description.camera()
    distances = [_distance(given) for given in distance or []]
    fields = sensor_fields(described)
    solution = solve_camera(described, fields)
    if not distances and solution.sharp_distance is not None:
        distances = [solution.sharp_distance]
    solved = [
        solve_distance(described, one, solution.useful_pixels, fields, solution.row)
        for one in distances
    ]
    areas = measurement_area(described, "total"), measurement_area(described, "chief")
    volume = measurement_volume(described, fields=fields)
    if json:
        print_json(as_json(described, solution, solved, areas, volume))
    else:
        from flflab.cli.model_table import (
            print_tables,
        )  # a program that reads JSON need not wait for tables

        print_tables(solution, solved, areas, volume, description.remarks())
    if figures is not None:
        from flflab.figures import (
            draw_figures,
        )  # matplotlib takes longer to start than the model to compute

        for file, caption in draw_figures(described, figures):
            typer.echo(f"{file}: {caption}", err=json)


def _distance(given: str) -> float:
    value = option_quantity("--distance", given, "length")
    if not value > 0:
        raise InputError(
            f"--distance {given}: a distance in front of the main lens is above 0 mm, or infinity"
        )
    return value
