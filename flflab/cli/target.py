"""``flflab target print``: a target as a file to print in its true size."""

from pathlib import Path
from typing import Annotated

import typer

from flflab.cli.quantities import option_quantity
from flflab.errors import InputError

app = typer.Typer(
    help="Make targets to put before a camera.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@app.callback()
def targets() -> None:
    """Make targets to put before a camera."""


@app.command(name="print", short_help="Write a target in its true size, to be printed.")
def printed(
    target: Annotated[
        str, typer.Argument(help="kind of target, as texture, or a YAML target file")
    ],
    out: Annotated[
        Path, typer.Option("-o", "--output", help=".png with its resolution, or .svg with a ruler")
    ],
    width: Annotated[
        str | None, typer.Option(help="of the print, with its unit; the target's own without it")
    ] = None,
    dots_per_inch: Annotated[
        float, typer.Option("--dpi", help="of the printer", min=1, max=20000)
    ] = 1200.0,
) -> None:
    """Write a target in its true size, to be printed; a texture shows depth everywhere."""
    from flflab.cli.targets import read_target  # help waits for none of it
    from flflab.target_print import print_target

    wide = None if width is None else option_quantity("--width", width, "length")
    if wide is not None and not wide > 0:
        raise InputError(f"--width {width}: a width is above 0 mm")
    typer.echo(print_target(read_target(target), out, wide, dots_per_inch))
