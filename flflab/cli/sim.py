"""``flflab sim BENCH``: every instrument of a bench file, served on the loopback until ended."""

from pathlib import Path
from typing import Annotated

import typer


def sim(
    bench: Annotated[Path, typer.Argument(help="bench file (YAML); its addresses are ignored")],
    json: Annotated[
        bool, typer.Option("--json", help="one JSON line with all addresses on standard output")
    ] = False,
    port: Annotated[
        int,
        typer.Option(
            min=0, max=65000, help="first port, the next ones count up; 0 takes free ones"
        ),
    ] = 0,
    pty: Annotated[
        bool, typer.Option("--pty", help="serial instruments on pseudo terminals instead of TCP")
    ] = False,
    write_bench: Annotated[
        Path | None,
        typer.Option(help="also write a copy of the bench file with the addresses served"),
    ] = None,
    memory: Annotated[
        Path | None,
        typer.Option(help="file that keeps where everything stands, and is begun from"),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="instead of the bench file's simulated.seed")
    ] = None,
) -> None:
    """Serve until Ctrl-C, or until standard input ends where it is a pipe."""
    from flflab.bench import read_bench, with_seed  # help waits for none of it
    from sim.serve import main

    main(
        with_seed(read_bench(bench), seed),
        port,
        pty=pty,
        json_line=json,
        write_bench_file=write_bench,
        memory=memory,
    )
