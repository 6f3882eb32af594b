"""``flflab new camera|bench|study|calibration|requirements FILE``: a commented copy of a built-in
description to start from.
"""

from pathlib import Path
from typing import Annotated

import typer

from flflab.built_in import Kind, built_in
from flflab.errors import InputError
from flflab.whole_file import write_whole


def new(
    kind: Annotated[Kind, typer.Argument(help="camera, bench, study, calibration or requirements")],
    file: Annotated[
        Path, typer.Argument(help="file to write; an existing one is never overwritten")
    ],
) -> None:
    """Write a commented copy of a built-in file; a bench gets its camera file beside it."""
    text = built_in(kind).read_text(encoding="utf-8")
    written = {file: text}
    if kind is Kind.BENCH:
        camera = file.with_name(f"{file.stem}-camera.yaml")
        written = {
            file: text.replace("optics: ../cameras/osinski.yaml", f"optics: {camera.name}"),
            camera: built_in(Kind.CAMERA).read_text(encoding="utf-8"),
        }
    for path in written:
        if path.exists():
            raise InputError(f"{path} exists already and is not overwritten; give another name")
    for path, content in written.items():
        write_whole(path, content)
        typer.echo(f"wrote {path}")
