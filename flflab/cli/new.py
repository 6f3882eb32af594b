"""``flflab new camera|bench|study|scene|target|calibration|requirements FILE``: a commented copy of
a built-in description to start from.
"""

from pathlib import Path
from typing import Annotated

import typer

from flflab.built_in import Kind, built_in, full_bench, simulated_bench
from flflab.cli.quantities import option_quantity
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
    white: Annotated[
        Path | None,
        typer.Option(help="white picture that a camera file is begun from, with what it shows"),
    ] = None,
    pixel: Annotated[
        str | None, typer.Option(help="of the sensor that took it, such as 4.55um")
    ] = None,
    pitch: Annotated[
        str | None, typer.Option(help="of the microlens array before it, such as 125um")
    ] = None,
) -> None:
    """Write a commented copy of a built-in file; bench and scene get their camera file beside
    them. With --white, a camera file of what a white picture shows; the rest is to be filled in.
    """
    if (full or simulated) and kind is not Kind.BENCH:
        raise InputError(f"new {kind}: --full and --simulated are for a bench; leave them out")
    if full and simulated:
        raise InputError("new bench: --full and --simulated are two benches; give one of them")
    if any(one is not None for one in (white, pixel, pitch)):
        if kind is not Kind.CAMERA or white is None:
            raise InputError(
                f"new {kind}: --white, --pixel and --pitch begin a camera file from a white"
                " picture; give `new camera FILE --white PICTURE`"
            )
        text = _begun(white, pixel, pitch)
    else:
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


def _begun(white: Path, pixel: str | None, pitch: str | None) -> str:
    """The camera file of a white picture; what it needs is imported only here."""
    from flflab.camera_begun import begun_camera
    from flflab.files.image import read_sensor_picture
    from flflab.measurement.white import measure_blind

    sizes = [
        None if given is None else option_quantity(option, given, "length")
        for option, given in (("--pixel", pixel), ("--pitch", pitch))
    ]
    return begun_camera(measure_blind(read_sensor_picture(white)), white.name, *sizes)
