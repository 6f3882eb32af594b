"""``flflab measure FRAME``: lattice, views and contrast of one picture, whatever took it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flflab.cli.quantities import option_quantity
from flflab.errors import InputError
from flflab.files.stored_picture import Filters

if TYPE_CHECKING:
    from flflab.files.sensor_picture import SensorPicture
    from flflab.optics.camera import Camera
    from flflab.targets import Target


def measure(
    frame: Annotated[
        Path,
        typer.Argument(
            help="picture: .npy, .png, .tiff, .bmp, .pgm, .h5, .dng or another raw file"
        ),
    ],
    camera: Annotated[
        Path | None,
        typer.Option(
            help="camera file (YAML) of the camera that took it; a white picture needs none"
        ),
    ] = None,
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
    overlay: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png", help="draw centres, radii, kinds and departures over a white one"
        ),
    ] = None,
    plain: Annotated[
        bool,
        typer.Option(
            "--plain", help="an ordinary picture of a slanted edge, taken without microlenses"
        ),
    ] = False,
    json: Annotated[
        bool, typer.Option("--json", help="one JSON object on standard output (pixels, mm)")
    ] = False,
) -> None:
    """Measure one picture; positions are (x, y) in pixels, (0, 0) is the centre of the top-left
    one.
    """
    from flflab.cli.as_json import print_json
    from flflab.cli.measured import contrasts_table, dots_table, print_lattice
    from flflab.cli.targets import read_target
    from flflab.cli.terminal import Terminal
    from flflab.files.camera import read_camera  # help waits for none of it
    from flflab.files.image import Declared, read_declared
    from flflab.measurement.measure import measure as measure_picture
    from flflab.targets import White

    away = None if distance is None else option_quantity("--distance", distance, "length")
    if away is not None and not away > 0:
        raise InputError(
            f"--distance {distance}: a distance in front of the main lens is above 0 mm"
        )
    said = Declared(mosaic, channel, full_scale, dark)
    picture = read_declared(frame, number, said)
    beside = None if white is None else read_declared(white, None, said)
    if plain:
        if camera is not None or white is not None or overlay is not None:
            raise typer.BadParameter(
                "an ordinary picture has no camera file, white picture or overlay",
                param_hint="--plain",
            )
        _measure_plain(picture, json)
        return
    standing = read_target(target)
    if camera is None or standing.kind == White.kind:
        if white is not None or standing.kind != White.kind:
            _refuse(standing, camera)
        described = None if camera is None else read_camera(camera)
        _measure_white(picture, described, overlay, json)
        return
    if overlay is not None:
        raise typer.BadParameter(
            "it draws what is measured in a white picture; leave --target out",
            param_hint="--overlay",
        )
    result = measure_picture(picture, read_camera(camera), standing, away, white=beside)
    if json:
        print_json(result)
        return
    console = Terminal()
    print_lattice(console, result["lattice"])
    if result["dots"]:
        console.print_table(dots_table(result["dots"]))
    if result["mtf"]:
        console.print_table(contrasts_table(result["mtf"]))
    for remark in result["remarks"]:
        console.print(f"Note: {remark}.", highlight=False)


def _measure_plain(picture: "SensorPicture", json: bool) -> None:
    """An ordinary picture of an edge."""
    from flflab.cli.as_json import print_json
    from flflab.cli.measured import contrasts_table
    from flflab.cli.terminal import Terminal
    from flflab.measurement.plain_edge import measure_plain_edge

    result = measure_plain_edge(picture)
    if json:
        print_json(result)
        return
    console = Terminal()
    console.print_table(contrasts_table(result["mtf"]))
    for remark in result["remarks"]:
        console.print(f"Note: {remark}.", highlight=False)


def _refuse(target: "Target", camera: Path | None) -> None:
    """Say what cannot be measured together."""
    if camera is None:
        raise typer.BadParameter(
            "without a camera file a white picture is measured; name the camera file of a picture"
            " of another target",
            param_hint="--camera",
        )
    raise InputError(
        f"measure: a white picture beside a {target.kind} one; it belongs beside a picture of"
        " another target"
    )


def _measure_white(
    picture: "SensorPicture", camera: "Camera | None", drawn: Path | None, json: bool
) -> None:
    """A white picture, whatever took it, or of a camera whose file is known."""
    import cv2

    from flflab.cli.as_json import print_json
    from flflab.cli.measured import print_white
    from flflab.cli.terminal import Terminal
    from flflab.measurement.overlay import overlay as overlay_of
    from flflab.measurement.white import measure_blind, measure_described
    from flflab.whole_file import require_writable, write_whole

    if drawn is not None:
        if drawn.suffix.lower() != ".png":
            raise typer.BadParameter("a file ending in .png is due", param_hint="--overlay")
        require_writable(drawn)
    found = measure_blind(picture) if camera is None else measure_described(picture, camera)
    if drawn is not None:
        canvas = overlay_of(found.picture, found.white, found.types)
        write_whole(drawn, cv2.imencode(".png", canvas)[1].tobytes())
    if json:
        print_json(found.json())
        return
    print_white(Terminal(), found)
