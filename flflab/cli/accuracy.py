"""``flflab accuracy WHAT``: what accuracy costs, where the model holds, how well lattice and depth
are known: a page, a CSV and a table.
"""

import os
import platform
from collections.abc import Callable
from datetime import UTC, datetime
from enum import StrEnum
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flflab.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from flflab.accuracy.page import Page
    from flflab.accuracy.page import Table as PlainTable
    from flflab.optics.camera import Camera


class What(StrEnum):
    """What there is to be measured."""

    IMAGE = "image"
    MEASURE = "measure"
    MODEL = "model"
    DEPTH = "depth"
    LATTICE = "lattice"
    BENCH = "bench"


TAKE = {  # which of them take which file
    "--camera": (What.IMAGE, What.DEPTH, What.LATTICE),
    "--scene": (What.IMAGE,),
    "--bench": (What.BENCH,),
    "--study": (What.BENCH,),
}


def accuracy(
    what: Annotated[
        What,
        typer.Argument(
            help=(
                "image, measure: error against time of pictures and of measured numbers; model:"
                " against exact rays; "
                "depth: error of a dot's depth against its distance; lattice: that of the"
                " micro-images' lattice against the f-number; bench: time of a whole validation"
                " against the accuracy of its pictures and the number of frames"
            )
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="folder for the page and the CSV, made if need be")
    ] = Path(),
    camera: Annotated[
        Path | None,
        typer.Option(
            help=(
                "camera file (YAML) to evaluate, for depth, lattice and image; without it the"
                " built-in ones"
            )
        ),
    ] = None,
    scene: Annotated[
        Path | None, typer.Option(help="scene file (YAML) for `image`: its own frame is formed")
    ] = None,
    bench: Annotated[
        Path | None,
        typer.Option(help="simulated bench (YAML) for `bench`; without it the built-in"),
    ] = None,
    study: Annotated[
        Path | None,
        typer.Option(help="study (YAML) for `bench`; without it the built-in first one"),
    ] = None,
) -> None:
    """Show what accuracy costs in time, where the first-order model holds, and how well a camera
    tells depth and its lattice.
    """
    from flflab.accuracy.page import write_page  # help waits for none of it
    from flflab.cli.terminal import Terminal
    from flflab.whole_file import make_folder

    given = {"--camera": camera, "--scene": scene, "--bench": bench, "--study": study}
    for option, file in given.items():
        if file is not None and what not in TAKE[option]:
            *first, last = TAKE[option]
            those = f"{', '.join(first)} and {last} take one" if first else f"{last} takes one"
            raise InputError(f"{option} {file}: accuracy {what} takes no such file; only {those}")
    make_folder(out, f"--out {out}")
    page_file, table_file = (out / f"accuracy-{what}.{kind}" for kind in ("html", "csv"))
    console = Terminal(soft_wrap=True)
    with Terminal(stderr=True).status(f"accuracy {what}") as status:
        ways = {
            What.IMAGE: _image
            if scene is None and camera is None
            else partial(_own, scene, camera),
            What.BENCH: partial(_bench, bench, study),
            What.MEASURE: _measure,
            What.MODEL: _model,
            What.DEPTH: partial(_depth, camera),
            What.LATTICE: partial(_lattice, camera),
        }
        page, table = ways[what](table_file, status.update)
        write_page(page, page_file)
    console.print_table(_shown(table))
    for sentence in page.answers:
        console.print(sentence, highlight=False)
    console.print(f"Page: {page_file}\nTable: {table_file}", highlight=False)


def _made(what: str) -> str:
    return (
        f"flflab accuracy {what}, version {version('flflab')}, {datetime.now(UTC):%Y-%m-%d %H:%M}"
        f" UTC, {platform.machine()}, {os.cpu_count()} cores"
    )


def _image(file: Path, tell: Callable[[str], None]) -> "tuple[Page, PlainTable]":
    from flflab.accuracy.image import image_rows
    from flflab.accuracy.image_page import image_page, image_summary
    from flflab.accuracy.table import write_table

    rows = image_rows(tell)
    write_table(rows, file, also=("processor_s_per_megapixel",))
    return image_page(rows, _made(What.IMAGE)), image_summary(rows)


def _own(
    scene: Path | None, camera: Path | None, file: Path, tell: Callable[[str], None]
) -> "tuple[Page, PlainTable]":
    from flflab.accuracy.own_page import scene_page, scene_table
    from flflab.accuracy.own_scene import scene_rows
    from flflab.accuracy.table import write_table
    from flflab.files.camera import read_camera
    from flflab.image.ground_truth import sharp_distance
    from flflab.image.scene import Plane
    from flflab.image.scene_file import read_scene, short_scene
    from flflab.targets import Bars

    if scene is not None:
        pictured, name = read_scene(scene, camera).scene, scene.stem
    else:
        optics = read_camera(camera or Path())
        pictured = short_scene(optics, Plane(Bars(), sharp_distance(optics)))
        name = f"bars in focus, {camera.stem if camera else ''}"
    rows, uncertainty = scene_rows(pictured, tell)
    write_table(rows, file)
    return scene_page(rows, name, uncertainty, _made(What.IMAGE)), scene_table(rows)


def _bench(
    bench: Path | None, study: Path | None, file: Path, tell: Callable[[str], None]
) -> "tuple[Page, PlainTable]":
    from flflab.accuracy.bench_page import bench_page, bench_table
    from flflab.accuracy.table import write_table
    from flflab.built_in import Kind, built_in, simulated_bench
    from flflab.cli.accuracy_bench import bench_rows

    rows = bench_rows(bench or simulated_bench(), study or built_in(Kind.STUDY), tell)
    write_table(rows, file)
    return bench_page(rows, _made(What.BENCH)), bench_table(rows)


def _measure(file: Path, tell: Callable[[str], None]) -> "tuple[Page, PlainTable]":
    from flflab.accuracy.measure import measure_rows
    from flflab.accuracy.measure_page import measure_page, measure_summary
    from flflab.accuracy.table import write_table

    rows = measure_rows(tell)
    write_table(rows, file)
    return measure_page(rows, _made(What.MEASURE)), measure_summary(rows)


def _model(file: Path, tell: Callable[[str], None]) -> "tuple[Page, PlainTable]":
    from flflab.accuracy.model import sweep_model, write_sweeps
    from flflab.accuracy.model_page import model_page, model_table

    sweeps = sweep_model(tell)
    write_sweeps(sweeps, file)
    return model_page(sweeps, _made(What.MODEL)), model_table(sweeps)


def _depth(
    camera: Path | None, file: Path, tell: Callable[[str], None]
) -> "tuple[Page, PlainTable]":
    from flflab.accuracy.depth import depth_rows
    from flflab.accuracy.depth_page import depth_page, depth_summary
    from flflab.accuracy.table import write_table

    of_one_kind, name = _described(camera, What.DEPTH)
    rows = depth_rows(of_one_kind, tell)
    write_table(rows, file)
    return depth_page(rows, name, _made(What.DEPTH)), depth_summary(rows)


def _lattice(
    camera: Path | None, file: Path, tell: Callable[[str], None]
) -> "tuple[Page, PlainTable]":
    from flflab.accuracy.lattice import lattice_rows
    from flflab.accuracy.lattice_page import lattice_page, lattice_summary
    from flflab.accuracy.table import write_table

    of_one_kind, name = _described(camera, What.LATTICE)
    rows = lattice_rows(of_one_kind, tell)
    write_table(rows, file)
    return lattice_page(rows, name, _made(What.LATTICE)), lattice_summary(rows)


def _described(camera: Path | None, what: What) -> "tuple[Camera, str]":
    """The camera that is asked for, whose array is of one kind of microlenses, and its name."""
    from flflab.built_in import Kind, built_in
    from flflab.files.camera import read_camera

    file = built_in(Kind.CAMERA) if camera is None else camera
    found = read_camera(file)
    if (kinds := len(found.array.focal_lengths)) > 1:
        raise InputError(
            f"accuracy {what}: {file} has microlenses of {kinds} focal lengths; give a camera whose"
            " array has one"
        )
    return found, file.stem


def _shown(table: "PlainTable") -> "Table":
    from rich import box
    from rich.table import Table

    shown = Table(
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, 1, 0, 0),
        title=table.caption,
    )
    for number, heading in enumerate(table.headings):
        longest = max(
            len(word) for row in table.rows for word in row[number].split() or [""]
        )  # no word of a cell is cut
        shown.add_column(
            heading,
            justify="left" if number < 2 else "right",
            no_wrap=number < 2,
            min_width=longest,
        )
    for row in table.rows:
        shown.add_row(*row)
    return shown
