"""``flflab measure FRAME``: lattice, views and contrast of one picture, whatever took it."""

from pathlib import Path
from statistics import fmean, median, pstdev
from typing import Annotated, Any

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from flflab.camera_file import read_camera
from flflab.cli.ending import print_json
from flflab.cli.quantities import option_quantity
from flflab.cli.targets import read_target
from flflab.errors import InputError
from flflab.image_file import Declared, read_declared
from flflab.measurement.measure import measure as measure_picture
from flflab.stored_picture import Filters


def measure(
    frame: Annotated[
        Path,
        typer.Argument(
            help="picture: .npy, .png, .tiff, .bmp, .pgm, .h5, .dng or another raw file"
        ),
    ],
    camera: Annotated[Path, typer.Option(help="camera file (YAML) of the camera that took it")],
    target: Annotated[
        str, typer.Option(help="kind of target that stood there, or its YAML file")
    ] = "white",
    distance: Annotated[
        str | None,
        typer.Option(
            help="main lens to target, with its unit; without it where the camera is sharp"
        ),
    ] = None,
    white: Annotated[
        Path | None,
        typer.Option(
            help=(
                "picture of a white target taken as the frame was: the lattice is measured in it,"
                " much better"
            )
        ),
    ] = None,
    number: Annotated[
        int | None, typer.Option(help="which picture of a file of several (.h5, .tiff), from 0")
    ] = None,
    mosaic: Annotated[
        Filters | None,
        typer.Option(help="colour filters of a grey file's pixels [0, 0], [0, 1], [1, 0], [1, 1]"),
    ] = None,
    channel: Annotated[
        str | None,
        typer.Option(
            metavar="red|green|blue|N", help="which channel of a colour picture (N counts from 0)"
        ),
    ] = None,
    full_scale: Annotated[
        float | None,
        typer.Option(metavar="N", help="what a saturated pixel reads, where no file says it"),
    ] = None,
    dark: Annotated[
        Path | None,
        typer.Option(
            help="picture taken in the dark with the same settings, to subtract (from --white too)"
        ),
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="one JSON object on standard output (pixels, mm)")
    ] = False,
) -> None:
    """Measure one picture; positions are (x, y) in pixels, (0, 0) is the centre of the top-left
    one.
    """
    away = None if distance is None else option_quantity("--distance", distance, "length")
    if away is not None and not away > 0:
        raise InputError(
            f"--distance {distance}: a distance in front of the main lens is above 0 mm"
        )
    said = Declared(mosaic, channel, full_scale, dark)
    picture = read_declared(frame, number, said)
    beside = None if white is None else read_declared(white, None, said)
    result = measure_picture(picture, read_camera(camera), read_target(target), away, white=beside)
    if json:
        print_json(result)
        return
    console = Console()
    _print_lattice(console, result["lattice"])
    if result["dots"]:
        console.print(_dots(result["dots"]))
    if result["mtf"]:
        console.print(_contrasts(result["mtf"]))
    for remark in result["remarks"]:
        console.print(f"Note: {remark}.", highlight=False)


def _print_lattice(console: Console, lattice: dict[str, Any]) -> None:
    table = Table(title="Lattice of micro-images", show_header=False, box=box.SIMPLE)
    table.add_row("layout", str(lattice["layout"]))
    table.add_row("pitch", f"{lattice['pitch_px']:.5f} px")
    table.add_row("angle", f"{lattice['angle_deg']:.5f} deg")
    table.add_row("origin (x, y)", "{:.4f}, {:.4f} px".format(*lattice["origin_px"]))
    table.add_row(
        "inside, outside radius",
        f"{lattice['inside_radius_px']:.3f}, {lattice['outside_radius_px']:.3f} px",
    )
    table.add_row("micro-images", str(len(lattice["centres_px"])))
    console.print(table)
    if lattice.get("micro_images"):
        console.print(_radii(lattice["micro_images"]))


def _radii(each: list[dict[str, Any]]) -> Table:
    """The bright and total field of the micro-images one by one, those of one kind of microlens
    together; ``--json`` lists them all.
    """
    table = Table(title="Radii of single micro-images, px", box=box.SIMPLE)
    for head in ("field", "model", "mean", "scatter", "stated", "least", "most", "seen"):
        table.add_column(head, justify="right")
    for name, key in (("bright", "inside_radius_px"), ("total", "outside_radius_px")):
        for due in sorted({one["model"][key] for one in each}):
            kind = [one for one in each if one["model"][key] == due]
            found = [(one[key], one["uncertainty"][key]) for one in kind if one[key] is not None]
            if not found:
                table.add_row(name, f"{due:.3f}", *["none"] * 5, f"0 of {len(kind)}")
                continue
            radii, doubts = zip(*found, strict=True)
            figures = fmean(radii), pstdev(radii), median(doubts), min(radii), max(radii)
            table.add_row(
                name,
                f"{due:.3f}",
                *(f"{value:.3f}" for value in figures),
                f"{len(found)} of {len(kind)}",
            )
    return table


def _dots(dots: list[dict[str, Any]]) -> Table:
    table = Table(title="Dots", box=box.SIMPLE)
    for head in ("dot", "views", "uncertain", "x mm", "y mm", "z mm"):
        table.add_column(head, justify="right")
    for dot in dots:
        position = [
            "none" if value is None or sigma is None else f"{value:.3f} ± {sigma:.3f}"
            for value, sigma in zip(
                dot["position_mm"] or [None] * 3, dot["uncertainty_mm"] or [None] * 3, strict=True
            )
        ]
        table.add_row(str(dot["dot"]), str(dot["views"]), str(dot["views_uncertain"]), *position)
    return table


def _contrasts(points: list[dict[str, Any]]) -> Table:
    """Of several kinds of microlenses a curve each; the classic reading, (max - min)/(max + min),
    with its bias.
    """
    table = Table(title="Contrast against frequency", box=box.SIMPLE)
    kinds = dict.fromkeys(point.get("microlens_focal_length_mm") for point in points)
    classic = any("classic" in point for point in points)
    heads = (
        ["microlens mm"] * (len(kinds) > 1)
        + ["cycles/px", "contrast"]
        + ["views", "max, min", "its bias"] * classic
    )
    for head in heads:
        table.add_column(head, justify="right")
    for point in points:
        row = [f"{point['microlens_focal_length_mm']:g}"] if len(kinds) > 1 else []
        row += [
            f"{point['cycles_per_px']:.4f}",
            f"{point['contrast']:.5f} ± {point['uncertainty']:.5f}",
        ]
        if classic:
            row += [str(len(point["views"]))]
            row += [
                "none" if value is None else f"{value:+.3f}"
                for value in (point["classic"], point["classic_bias"])
            ]
        table.add_row(*row)
    return table
