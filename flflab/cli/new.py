"""``flflab new camera|bench|study|scene|target|calibration|requirements FILE``: a commented copy of
a built-in description to start from.
"""

from pathlib import Path
from typing import Annotated

import typer

from flflab.built_in import Kind, built_in, full_bench, simulated_bench
from flflab.errors import InputError
from flflab.whole_file import write_whole

CAMERA_OF = {  # the line of a file that names its camera file
    Kind.BENCH: "optics: ../cameras/osinski.yaml",
    Kind.SCENE: "camera: ../cameras/osinski.yaml",
}


def new(
    kind: Annotated[
        Kind,
        typer.Argument(help="camera, bench, study, scene, target, calibration or requirements"),
    ],
    file: Annotated[
        Path, typer.Argument(help="file to write; an existing one is never overwritten")
    ],
    full: Annotated[
        bool, typer.Option("--full", help="a bench with all seven axes, simulated")
    ] = False,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="the simulated bench that commands use by default")
    ] = False,
) -> None:
    """Write a commented copy of a built-in file; bench and scene get their camera file beside
    them.
    """
    if (full or simulated) and kind is not Kind.BENCH:
        raise InputError(f"new {kind}: --full and --simulated are for a bench; leave them out")
    if full and simulated:
        raise InputError("new bench: --full and --simulated are two benches; give one of them")
    source = full_bench() if full else simulated_bench() if simulated else built_in(kind)
    text = source.read_text(encoding="utf-8")
    written = {file: text}
    if line := CAMERA_OF.get(kind):
        camera = file.with_name(f"{file.stem}-camera.yaml")
        named = f"{line.partition(':')[0]}: {camera.name}"
        written = {
            file: text.replace(line, named),
            camera: built_in(Kind.CAMERA).read_text(encoding="utf-8"),
        }
    for path in written:
        if path.exists():
            raise InputError(f"{path} exists already and is not overwritten; give another name")
    for path, content in written.items():
        write_whole(path, content)
        typer.echo(f"wrote {path}")
