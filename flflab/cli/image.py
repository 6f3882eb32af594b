"""``flflab image CAMERA``: the picture a camera takes of a target, as numbers or as a picture file."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from flflab.camera_file import read_camera
from flflab.cli.ending import print_json
from flflab.cli.targets import read_target
from flflab.errors import InputError
from flflab.image.image_report import ImageReport, image_report
from flflab.image_file import write_picture
from flflab.units import parse_quantity


def image(
    camera: Annotated[Path, typer.Argument(help="camera file (YAML)")],
    out: Annotated[Path, typer.Option("-o", "--output", help=".npy (float64, white level 1), .tiff, .png or .dng")],
    distance: Annotated[str, typer.Option(help="main lens to target, with its unit, or infinity")],
    target: Annotated[str, typer.Option(help="kind of target, or a YAML target file, or a picture file")] = "four-dot",
    effects: Annotated[str, typer.Option(help="auto, fast, reference, or a list of effects joined by commas")] = "auto",
    tolerance: Annotated[float, typer.Option(help="largest error asked for, as a share of white level")] = 0.002,
    seed: Annotated[int | None, typer.Option(help="of the noise; without one the picture has none")] = None,
    explain: Annotated[bool, typer.Option(help="print every effect: size, bound, on or off, why, milliseconds")] = False,
    json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Form the image of a target and write it; columns rise with the world's x, rows with its y."""
    away = parse_quantity(distance, "length")
    if not away > 0:
        raise InputError(f"--distance {distance}: a distance in front of the main lens is above 0 mm, or infinity")
    if not 0 < tolerance < 1:
        raise InputError(f"--tolerance {tolerance:g}: a share of white level above 0 and below 1 is due")
    report = image_report(read_camera(camera), read_target(target), away, tolerance=tolerance, seed=seed, effects=effects)
    write_picture(out, report.image)
    if json:
        print_json(
            {
                "effects": [asdict(effect) for effect in report.effects],
                "error_estimate": report.error_estimate,
                "time_ms": report.time_ms,
            }
        )
        return
    console = Console()
    if explain:
        console.print(_table(report))
        absent = [effect.name for effect in report.effects if effect.size is None and not effect.on]
        if absent:
            console.print(f"Not simulated by this version: {', '.join(absent)}.", highlight=False)
    console.print(f"{out}: error below {report.error_estimate:.2g} of white level, {report.time_ms:.0f} ms", highlight=False)


def _table(report: ImageReport) -> Table:
    table = Table(box=box.SIMPLE)
    for head in ("effect", "on", "size", "bound", "ms", "why"):
        table.add_column(head, justify="right" if head in ("size", "bound", "ms") else "left")
    for effect in report.effects:
        if effect.size is None and not effect.on:
            continue  # told in one line below
        table.add_row(
            effect.name,
            "on" if effect.on else "off",
            "" if effect.size is None else f"{effect.size:.3g}",
            "" if effect.bound is None else f"{effect.bound:.2g}",
            f"{effect.ms:.1f}" if effect.ms else "",
            effect.why,
        )
    return table
