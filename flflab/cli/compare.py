"""``flflab compare OBSERVATIONS --camera CAMERA``: positions, views and virtual depths measured
elsewhere against the model.
"""

from pathlib import Path
from typing import Annotated

import typer


def compare(
    observations: Annotated[
        Path, typer.Argument(help="folder with observations.csv, poses.json and camera.json")
    ],
    camera: Annotated[
        Path, typer.Option(help="camera file (YAML) of the camera that took the pictures")
    ],
    json: Annotated[
        bool, typer.Option("--json", help="one JSON object on standard output (mm, degrees)")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="folder for compare.json, compare.csv and compare.png")
    ] = None,
) -> None:
    """Compare positions, view counts and virtual depths measured elsewhere with the model, and
    refit L and b.
    """
    from flflab.cli.as_json import print_json
    from flflab.cli.compared import as_json, frame_table, run_comparison, write_files
    from flflab.cli.terminal import Terminal
    from flflab.files.camera import read_camera  # help waits for none of it

    found = run_comparison(observations, read_camera(camera))
    result = as_json(found)
    if out is not None:
        write_files(out, found, result)
    if json:
        print_json(result)
        return
    console = Terminal()
    console.print_table(frame_table(found.frames))
    for sentence in found.sentences:
        console.print(sentence, highlight=False)
    if out is not None:
        console.print(
            "Written:"
            f" {', '.join(str(out / name) for name in ('compare.json', 'compare.csv', 'compare.png'))}",  # noqa: E501
            highlight=False,
        )
