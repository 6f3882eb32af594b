"""``flflab refocus RAW``: the scene focused at other distances, or everywhere."""

from pathlib import Path
from typing import Annotated

import typer

from flflab.cli.quantities import option_quantity
from flflab.errors import InputError

ENDINGS = (".png", ".tif", ".tiff")
TOTAL = "total focus"


def refocus(
    picture: Annotated[Path, typer.Argument(metavar="RAW", help="picture of a scene")],
    camera: Annotated[Path, typer.Option(help="camera file (YAML) of the camera that took it")],
    white: Annotated[Path, typer.Option(help="picture of a white target, taken as RAW was")],
    out: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help=".png (16 bits) for one picture, or .tiff (float32), which holds several",
        ),
    ],
    distance: Annotated[
        list[str] | None,
        typer.Option(help="to be sharp at, with its unit, or infinity; repeat it for a stack"),
    ] = None,
    total: Annotated[bool, typer.Option("--total", help="sharp everywhere")] = False,
    dark: Annotated[
        Path | None,
        typer.Option(
            help="picture taken in the dark with the same settings, to subtract from both"
        ),
    ] = None,
) -> None:
    """Focus a picture anew."""
    from flflab.cli.depth_progress import depth_progress
    from flflab.depth_map.depth import refocused
    from flflab.depth_map.files import png_bytes, tiff_bytes
    from flflab.files.camera import read_camera  # help waits for none of it
    from flflab.files.image import Declared, read_declared
    from flflab.whole_file import require_writable, write_whole

    if total == bool(distance):
        raise InputError("refocus: give --distance, once or several times, or --total; not both")
    names = distance or [TOTAL]
    if out.suffix.lower() not in ENDINGS:
        raise InputError(f"{out}: pictures are written to files ending in {', '.join(ENDINGS)}")
    if len(names) > 1 and out.suffix.lower() == ".png":
        raise InputError(f"{out}: a .png holds one picture, not {len(names)}; give .tiff")
    away = [option_quantity("--distance", one, "length") for one in distance or []]
    require_writable(out)
    said = Declared(dark=dark)
    described = read_camera(camera)
    scene, flat = read_declared(picture, None, said), read_declared(white, None, said)
    with depth_progress() as tell:
        found = refocused(scene, described, flat, away or None, tell)
    pictures = dict(zip(names, found, strict=True))
    write_whole(out, png_bytes(found[0]) if out.suffix.lower() == ".png" else tiff_bytes(pictures))
    typer.echo(f"{out}: {', '.join(names)}")
