"""``flflab image CAMERA``: the picture a camera takes of a scene, as numbers or as a picture file,
with its ground truth beside it.
"""

import json as text
from pathlib import Path
from typing import Annotated

import typer

from flflab.cli.as_json import print_json
from flflab.cli.quantities import option_quantity
from flflab.errors import InputError
from flflab.image.accuracy import TOLERANCE

WIDTH = 100  # characters, where the terminal is no narrower


def image(
    context: typer.Context,
    out: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help=(
                ".npy (float64, white level 1), .tiff, .png or .dng; the ground truth goes beside"
                " it, as .json"
            ),
        ),
    ],
    camera: Annotated[
        Path | None, typer.Argument(help="camera file (YAML); not needed where the scene names one")
    ] = None,
    scene: Annotated[
        Path | None, typer.Option(help="scene file (YAML), instead of --target and --distance")
    ] = None,
    distance: Annotated[
        str | None, typer.Option(help="main lens to target, with its unit, or infinity")
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            help="kind of target, or a YAML target file, or a picture file; without it four-dot"
        ),
    ] = None,
    wavelength: Annotated[
        str | None,
        typer.Option(
            help="of the light, with its unit; without it light is rays, and nothing bends"
        ),
    ] = None,
    effects: Annotated[
        str, typer.Option(help="auto, fast, reference, or a list of effects joined by commas")
    ] = "auto",
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="root mean square error to reach, as a share of the white level; without it"
            f" {TOLERANCE:g}"
        ),
    ] = None,
    time_budget: Annotated[
        str | None,
        typer.Option(
            help="time with its unit: the best accuracy that fits, instead of --tolerance"
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="of the noise; without one the picture has none")
    ] = None,
    explain: Annotated[
        bool, typer.Option(help="print every effect: size, bound, on or off, why, milliseconds")
    ] = False,
    json: Annotated[
        bool, typer.Option("--json", help="one JSON object on standard output")
    ] = False,
) -> None:
    """Form the picture of a scene and write it; columns rise with the world's x, rows with its
    y.
    """
    from flflab.cli.at_work import told_at_work  # help waits for none of it
    from flflab.cli.formed import effects_table, keys_of, require_ours, short_way
    from flflab.cli.terminal import Terminal
    from flflab.files.image import require_picture_file, write_picture
    from flflab.image.ground_truth import ground_truth
    from flflab.image.picture import take_picture
    from flflab.image.scene_file import read_scene
    from flflab.image.sensor.raw_picture import neutral
    from flflab.whole_file import write_whole

    if (scene is None) == (distance is None) or (camera is None and scene is None):
        context.fail(
            "give a camera and --distance, or --scene with a scene that names its camera or a"
            " camera beside it"
        )
    if scene is not None and target is not None:
        context.fail("--target belongs to --distance; a scene file has its targets in `planes`")
    if scene is not None and wavelength is not None:
        context.fail(
            "--wavelength belongs to --target and --distance; a scene file has a field of that name"
        )
    if time_budget is not None and tolerance is not None:
        context.fail("give --tolerance, or --time-budget, which chooses one; not both")
    require_picture_file(out)
    truth_file = out.with_suffix(".json")
    require_ours(truth_file)
    pictured = (
        read_scene(scene, camera)
        if scene is not None
        else short_way(camera or Path(), target, distance or "", wavelength)
    )
    budget = None if time_budget is None else option_quantity("--time-budget", time_budget, "time")
    with told_at_work():
        report = take_picture(
            pictured.scene,
            tolerance=TOLERANCE if tolerance is None else tolerance,
            effects=effects,
            seed=seed,
            response=pictured.response,
            electrons_at_white=pictured.electrons_at_white,
            budget=budget,
        )
    mosaic = pictured.scene.colour_filter
    if mosaic is None:
        write_picture(out, report.image)
    else:
        write_picture(out, report.image, pattern=mosaic.pattern, neutral=neutral(mosaic))
    told = {
        "effects": [keys_of(effect) for effect in report.effects],
        "error_estimate": report.error_estimate,
        "time_ms": report.time_ms,
    }
    truth = text.dumps({**ground_truth(pictured.scene), **told}, allow_nan=False, indent=1) + "\n"
    try:
        write_whole(truth_file, truth)
    except InputError as error:
        raise InputError(f"{error}; the picture itself, {out}, is written") from error
    if json:
        print_json(told)
        return
    console = Terminal(piped=WIDTH)
    console.width = min(console.width, WIDTH)
    if explain:
        console.print(effects_table(report, console.width))
        console.print(f"Formed by {report.path}: {report.why_path}.", highlight=False)
        absent = [effect.name for effect in report.effects if not effect.on and not effect.unit]
        if absent:
            console.print(f"Not in this scene: {', '.join(absent)}.", highlight=False)
    said = (
        f"error below {report.error_estimate:.2g} of white level (root mean square over lit"
        f" pixels), {report.time_ms:.0f} ms; ground truth in {truth_file}"
    )
    console.print(f"{out}: {said}", highlight=False, soft_wrap=True)
