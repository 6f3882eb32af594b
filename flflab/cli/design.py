"""``flflab design REQUIREMENTS``: which configuration, what it gives up for what, and how well it
must be built.
"""

from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.progress import Progress
from rich.table import Table

from flflab.cli.as_json import print_json
from flflab.cli.terminal import Terminal
from flflab.design.answer import Option, answer, row
from flflab.design.camera_text import camera_text
from flflab.design.chunk_log import Found
from flflab.design.cluster import search_on_cluster
from flflab.design.page import asked, label, summary, write_page
from flflab.design.requirements import Requirements, read_requirements
from flflab.design.search import Hindrance, hindrance, search
from flflab.errors import InputError
from flflab.whole_file import make_folder, write_csv, write_whole


def design(
    requirements: Annotated[Path, typer.Argument(help="requirements file (YAML)")],
    out: Annotated[
        Path,
        typer.Option(help="folder for the page, the table, the camera files and the search's log"),
    ] = Path("design"),
    scheduler: Annotated[
        str | None, typer.Option(help="address of a Dask scheduler whose workers share the search")
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="one JSON object on standard output")
    ] = False,
) -> None:
    """Search the configurations that meet the requirements; an interrupted search goes on when it
    is started again.
    """
    wanted = read_requirements(requirements)
    make_folder(out, f"--out {out}")
    found = _searched(wanted, scheduler, out / "search.jsonl", quiet=json)
    if found.met == 0:
        raise InputError(_nothing(wanted, found, hindrance(wanted)))
    named, front = answer(wanted, found)
    _write(out, requirements.stem, wanted, found, named, front)
    if json:
        print_json(
            {
                "tried": found.tried,
                "built": found.built,
                "met": found.met,
                "epsilon": found.front.epsilon,
                "named": [
                    row(wanted, option) | {"yield": option.built.share if option.built else None}
                    for option in named
                ],
                "front": [row(wanted, option) for option in front],
            }
        )
        return
    console = Terminal()
    console.print(summary(found), highlight=False)
    console.print_table(_table(wanted, named))
    for option in named:
        built = option.built
        if built is not None and built.buys_most is not None:
            better = (
                f"{100 * built.halved[built.buys_most]:.1f} % if"
                f" {built.buys_most.replace('_', ' ')} is held twice as well"
            )
            console.print(
                f"{option.name}: yield {100 * built.share:.1f} % at the stated tolerances,"
                f" {better}.",
                highlight=False,
            )
    console.print(
        f"{out / 'design.html'}, {out / 'front.csv'}, {len(named) + len(front)} camera files in"
        f" {out / 'cameras'}",
        highlight=False,
    )


def _searched(wanted: Requirements, scheduler: str | None, log: Path, quiet: bool) -> Found:
    with Progress(transient=True, disable=quiet, console=Terminal(stderr=True)) as progress:
        bar = progress.add_task("configurations", total=None)

        def tell(done: int, total: int) -> None:
            progress.update(bar, completed=done, total=total)

        if scheduler is not None:
            return search_on_cluster(wanted, scheduler, log, tell)
        return search(wanted, log, tell)


def _nothing(wanted: Requirements, found: Found, why: Hindrance) -> str:
    """What clashes, and by how much, in sentences."""
    said = [f"none of {found.tried:,} configurations meets the requirements"]
    if why.nearest is None:
        return (
            f"{said[0]}: none can be built, no gap within travel.gap puts the depth in focus; widen"
            " travel.gap or travel.array"
        )
    for demand, value in why.alone:
        bound = "at least" if demand.least else "at most"
        said.append(
            f"closest: {demand.name} {demand.show(value)} instead of {bound}"
            f" {demand.show(demand.limit)}; all other requirements can be met"
        )
    if not why.alone:
        clash = " and ".join(
            f"{demand.name} ({demand.show(value)}, asked {demand.show(demand.limit)})"
            for demand, value in why.misses
        )
        said.append(f"at least two clash: the nearest configuration misses {clash}")
    return "; ".join(said)


def _table(wanted: Requirements, named: tuple[Option, ...]) -> Table:
    """One column an option, so that it fits a narrow terminal."""
    rows = [row(wanted, option) for option in named]
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("")
    for cells in rows:
        table.add_column(str(cells["name"]), justify="right")
    several = {
        part
        for part in ("main_lens", "array", "sensor")
        if len({cells[part] for cells in rows}) > 1
    }
    for head in rows[0]:
        if head not in ({"name", "main_lens", "array", "sensor"} - several):
            table.add_row(label(head), *(_cell(cells[head]) for cells in rows))
    return table


def _cell(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _write(
    out: Path,
    title: str,
    wanted: Requirements,
    found: Found,
    named: tuple[Option, ...],
    front: tuple[Option, ...],
) -> None:
    write_page(out / "design.html", f"Design search: {title}", wanted, found, named, front)
    rows = [row(wanted, option) for option in (*named, *front)]
    heads = list(rows[0])
    write_csv(out / "front.csv", [heads, *([cells[head] for head in heads] for cells in rows)])
    cameras = out / "cameras"
    make_folder(cameras, f"--out {out}: {cameras.name}")
    for option in (*named, *front):
        heading = f"Design search '{title}', {option.name}: {'; '.join(asked(wanted)[:1])}"
        name = (
            option.name.replace(" ", "-")
            if not option.name.isdigit()
            else f"{int(option.name):03d}"
        )
        write_whole(
            cameras / f"{name}.yaml", camera_text(option.given, option.lens, wanted, heading)
        )
