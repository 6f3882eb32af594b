"""``flflab align``: the array straight to the sensor, the sensor to its place, by white
pictures.
"""

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flflab.built_in import simulated_bench
from flflab.cli.as_json import AsJson, plain, print_json
from flflab.cli.ending import INTERRUPTED
from flflab.cli.quantities import option_quantity
from flflab.errors import FlflabError, InputError

if TYPE_CHECKING:
    from procedures.align import Outcome

ALIGNED = "aligned-bench.yaml"


def align(
    bench: Annotated[
        Path | None,
        typer.Option(help="bench file (YAML); the built-in simulated bench without one"),
    ] = None,
    exit_pupil: Annotated[
        bool,
        typer.Option("--exit-pupil", help="move the sensor into the exit pupil: no vignetting"),
    ] = False,
    overlap: Annotated[
        str | None,
        typer.Option(
            help="move the sensor until neighbours overlap so far: '20 um', '-50 um' is a gap"
        ),
    ] = None,
    f_number: Annotated[
        float | None,
        typer.Option(min=0.5, help="while white pictures are taken; the camera file's without one"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="folder of the run, new or empty; runs/<UTC>-align without one"),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="of the simulated bench, instead of its file's")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Align the array with the sensor's rows and parallel to it, and move the sensor where you want
    it, by white pictures.
    """
    from drivers.bench import connect_described  # help waits for none of it
    from flflab.bench import seeded
    from flflab.cli.aligned import ending_of, table_of, turned, with_zeros, zero_of
    from flflab.cli.described import described_bench
    from flflab.cli.run import say_remark
    from flflab.cli.terminal import Terminal
    from flflab.record import Recording, run_folder
    from flflab.whole_file import write_own
    from procedures.align import Request, most_frames, require_reachable
    from procedures.align import align as run
    from procedures.descriptions import with_descriptions
    from procedures.engine import RunInterruptedError

    if exit_pupil and overlap is not None:
        raise InputError(
            "align: --exit-pupil and --overlap are two places of the one sensor; give one of them"
        )
    described = seeded(described_bench(bench or simulated_bench()), seed)
    wanted = None if overlap is None else option_quantity("--overlap", overlap, "length")
    request = Request(f_number or described.optics.main_lens.f_number, wanted, exit_pupil)
    require_reachable(request, described)
    failure: FlflabError | None = None
    outcomes: tuple[Outcome, ...] = ()
    with run_folder(out, "align") as folder, connect_described(described) as connected:
        columns, rows = described.optics.sensor.resolution
        recording = with_descriptions(
            Recording(folder, most_frames(request), (rows, columns)), described, None
        )
        say_remark(recording)
        try:
            outcomes = run(connected, request, recording, _tell)
        except FlflabError as error:
            # raised below: every axis was told to stop, and what goes wrong in leaving must not
            # hide why
            failure = error
    if isinstance(failure, RunInterruptedError):
        sys.stderr.write(f"flflab: {failure}; align begins anew, a few pictures are all it takes\n")
        raise typer.Exit(INTERRUPTED)
    if failure is not None:
        raise failure
    write_own(
        folder / "alignment.json", json.dumps([asdict(one) for one in outcomes], indent=1) + "\n"
    )
    kept = folder / "bench.yaml"
    write_own(folder / ALIGNED, with_zeros(kept.read_text(encoding="utf-8"), outcomes, described))
    if as_json:
        print_json(
            {
                "run": str(folder.resolve()),
                "aligned": [plain(one) | {"unit": one.unit} for one in outcomes],
                "axes": {
                    one.axis: {
                        "zero_rad": zero_of(one, described),
                        "zero_uncertainty_rad": one.uncertainty,
                    }
                    for one in turned(outcomes)
                },
            }
        )
        return
    console = Terminal(piped=140)
    console.print_table(table_of(outcomes))
    for one in outcomes:
        console.print(ending_of(one), highlight=False)
    console.print(
        f"The bench file with the zeros of this alignment: {folder / ALIGNED}",
        highlight=False,
        soft_wrap=True,
    )


def _tell(sentence: str) -> None:
    sys.stderr.write(f"{sentence}\n")
