"""``flflab design REQUIREMENTS``: which configuration, what it gives up for what, and how well it
must be built.
"""

from pathlib import Path
from typing import Annotated

import typer

from flflab.errors import InputError


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
    from flflab.cli.as_json import print_json  # help waits for none of it
    from flflab.cli.designed import nothing_met, searched, table_of, write_answer
    from flflab.cli.terminal import Terminal
    from flflab.design.answer import answer, row
    from flflab.design.page import summary
    from flflab.design.requirements import read_requirements
    from flflab.design.search import hindrance
    from flflab.whole_file import make_folder

    wanted = read_requirements(requirements)
    make_folder(out, f"--out {out}")
    found = searched(wanted, scheduler, out / "search.jsonl", quiet=json)
    if found.met == 0:
        raise InputError(nothing_met(wanted, found, hindrance(wanted)))
    named, front = answer(wanted, found)
    write_answer(out, requirements.stem, wanted, found, named, front)
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
    console.print_table(table_of(wanted, named))
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
