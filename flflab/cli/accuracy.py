"""``flflab accuracy WHAT``: what accuracy costs in time, and where the model holds, as a page, a CSV and a table."""

import os
import platform
from collections.abc import Callable
from datetime import UTC, datetime
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from flflab.accuracy.page import Page, write_page
from flflab.accuracy.page import Table as PlainTable
from flflab.errors import InputError


class What(StrEnum):
    """What there is to be measured."""

    IMAGE = "image"
    MEASURE = "measure"
    MODEL = "model"


def accuracy(
    what: Annotated[
        What,
        typer.Argument(help="image, measure: error against time of pictures and of measured numbers; model: against exact rays"),
    ],
    out: Annotated[Path, typer.Option(help="folder for the page and the CSV, made if need be")] = Path(),
) -> None:
    """Show what accuracy costs in time, and where the first-order model holds."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: the folder cannot be made ({error}); give a place you may write in") from error
    page_file, table_file = (out / f"accuracy-{what}.{kind}" for kind in ("html", "csv"))
    console = Console(soft_wrap=True)
    with Console(stderr=True).status(f"accuracy {what}") as status:
        page, table = {What.IMAGE: _image, What.MEASURE: _measure, What.MODEL: _model}[what](table_file, status.update)
        write_page(page, page_file)
    console.print(_shown(table))
    for sentence in page.answers:
        console.print(sentence, highlight=False)
    console.print(f"Page: {page_file}\nTable: {table_file}", highlight=False)


def _made(what: str) -> str:
    return (
        f"flflab accuracy {what}, version {version('flflab')}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {platform.machine()}, "
        f"{os.cpu_count()} cores"
    )


def _image(file: Path, tell: Callable[[str], None]) -> tuple[Page, PlainTable]:
    from flflab.accuracy.image import image_rows
    from flflab.accuracy.image_page import image_page, image_summary
    from flflab.accuracy.work_precision import write_table

    rows = image_rows(tell)
    write_table(rows, file)
    return image_page(rows, _made(What.IMAGE)), image_summary(rows)


def _measure(file: Path, tell: Callable[[str], None]) -> tuple[Page, PlainTable]:
    from flflab.accuracy.measure import measure_rows, write_measure_table
    from flflab.accuracy.measure_page import measure_page, measure_summary

    rows = measure_rows(tell)
    write_measure_table(rows, file)
    return measure_page(rows, _made(What.MEASURE)), measure_summary(rows)


def _model(file: Path, tell: Callable[[str], None]) -> tuple[Page, PlainTable]:
    from flflab.accuracy.model import sweep_model, write_sweeps
    from flflab.accuracy.model_page import model_page, model_table

    sweeps = sweep_model(tell)
    write_sweeps(sweeps, file)
    return model_page(sweeps, _made(What.MODEL)), model_table(sweeps)


def _shown(table: PlainTable) -> Table:
    shown = Table(box=box.SIMPLE, title=table.caption)
    for number, heading in enumerate(table.headings):
        shown.add_column(heading, justify="left" if number < 2 else "right", no_wrap=number < 2)
    for row in table.rows:
        shown.add_row(*row)
    return shown
