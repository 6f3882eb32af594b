"""``flflab depth RAW|RUN``: a depth map with its uncertainty, from a picture or a recorded run."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flflab.cli.quantities import option_quantity
from flflab.errors import InputError
from flflab.files.stored_picture import Filters

if TYPE_CHECKING:
    from flflab.depth_map.result import DepthMap


def depth(
    source: Annotated[
        Path, typer.Argument(metavar="RAW|RUN", help="picture of a scene, or folder of a run")
    ],
    camera: Annotated[
        Path | None,
        typer.Option(help="camera file (YAML) of the camera that took the picture; a run has its"),
    ] = None,
    white: Annotated[
        Path | None,
        typer.Option(help="picture of a white target, taken as RAW was; a run has its own"),
    ] = None,
    dark: Annotated[
        Path | None,
        typer.Option(
            help="picture taken in the dark with the same settings, to subtract from both"
        ),
    ] = None,
    distances: Annotated[
        tuple[str, str] | None,
        typer.Option(
            "--range",
            metavar="NEAR FAR",
            help='distances to look at, as "300 mm" "900 mm"; all that the camera sees without it',
        ),
    ] = None,
    mosaic: Annotated[
        Filters | None,
        typer.Option(help="colour filters of a grey file's pixels [0, 0], [0, 1], [1, 0], [1, 1]"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="folder of the files; without it NAME-depth beside RAW, depth in RUN"),
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="one JSON object on standard output (mm)")
    ] = False,
) -> None:
    """Make a depth map: distance with its uncertainty, total focus, a cloud of points, and a page
    to look at.
    """
    from flflab.cli.depth_progress import depth_progress
    from flflab.depth_map.depth import depth as depth_of
    from flflab.depth_map.files import require_writable_folder
    from flflab.files.camera import read_camera  # help waits for none of it
    from flflab.files.image import Declared, read_declared

    asked = _range_of(distances)
    if source.is_dir():
        if camera or white or dark or mosaic:
            raise InputError(
                f"{source}: a run holds its camera, white and dark pictures; leave --camera,"
                " --white, --dark and --mosaic out"
            )
        _depth_of_run(source, asked, out, json)
        return
    if camera is None or white is None:
        missing = " and ".join(
            name for name, given in (("--camera", camera), ("--white", white)) if given is None
        )
        raise InputError(
            f"{source}: {missing} missing; a depth map needs the camera file, and a picture of a"
            " white target taken with the same settings, which shows where the micro-images are"
        )
    folder = out or source.with_name(f"{source.stem}-depth")
    said = Declared(mosaic=mosaic, dark=dark)
    described = read_camera(camera)
    picture, flat = read_declared(source, None, said), read_declared(white, None, said)
    require_writable_folder(folder)
    with depth_progress() as tell:
        found = depth_of(picture, described, flat, distances=asked, progress=tell)
    _conclude({"": found}, folder, json)


def _depth_of_run(
    folder: Path, distances: tuple[float, float] | None, out: Path | None, json: bool
) -> None:
    from flflab.bench import read_bench
    from flflab.cli.depth_progress import depth_progress
    from flflab.depth_map.files import require_writable_folder
    from flflab.record import read_run
    from flflab.study import read_study
    from flflab.verdict.properties.depth_maps import depth_of_frames, pictures_of

    run = read_run(folder)
    bench = read_bench(folder / "bench.yaml")
    study = read_study(folder / "study.yaml", bench.optics)
    place = out or folder / "depth"
    found: dict[str, DepthMap] = {}
    due = pictures_of(run, study)
    for one in due:
        require_writable_folder(place / one.name)
    for number, one in enumerate(due, 1):
        with depth_progress(f"{one.name} ({number} of {len(due)}): ") as tell:
            found[one.name] = depth_of_frames(run, one, bench, distances, tell)
    _conclude(found, place, json)


def _conclude(found: "dict[str, DepthMap]", folder: Path, json: bool) -> None:
    """Write the files of every map, and say what they hold."""
    from flflab.cli.as_json import print_json
    from flflab.cli.terminal import Terminal
    from flflab.depth_map.page import summary_rows

    console = Terminal()
    told: dict[str, Any] = {}
    for name, one in found.items():
        place = folder / name
        files = one.save(place)
        summary = one.summary()
        told[name] = {**summary, "files": [str(file) for file in files]}
        if json:
            continue
        if name:
            console.print(f"{name}:", highlight=False)
        for what, value in summary_rows(summary):
            console.print(f"  {what:32} {value}", highlight=False, soft_wrap=True)
        for remark in summary["remarks"]:
            console.print(f"Note: {remark}.", highlight=False)
        console.print(
            f"{place}: {', '.join(file.name for file in files)}", highlight=False, soft_wrap=True
        )
    if json:
        print_json(told[""] if set(told) == {""} else {"maps": told})


def _range_of(given: tuple[str, str] | None) -> tuple[float, float] | None:
    if given is None:
        return None
    near, far = (option_quantity("--range", one, "length") for one in given)
    return near, far
