"""``flflab bench test``: what every bench promises, asked of this one."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from flflab.cli.connected import BenchFile
from flflab.cli.ending import INTERRUPTED
from flflab.errors import InputError

STOPPED_BY_CTRL_C = 2  # as pytest says it


def try_out(
    bench: BenchFile,
    faults: Annotated[
        int,
        typer.Option(min=0, help="show so many faults to simulated axes, too"),
    ] = 0,
    junit: Annotated[
        Path | None, typer.Option(help="write the results as JUnit XML, for a CI system")
    ] = None,
) -> None:
    """Home every axis in the safe order, move each over a quarter of its travel at most, stop it on
    its way, and have it refuse what lies beyond its limits; take frames; change iris and target.
    Everything moves: stand by. What a person moves is left alone. Ends with 1 where a promise is
    broken.
    """
    from flflab.cli.described import described_bench  # help waits for none of it

    if find_spec("pytest") is None:
        raise InputError("bench test runs on pytest, which is not installed: pip install pytest")
    real = [
        name
        for name, axis in described_bench(bench).description.axes.items()
        if axis.address != "simulated"
    ]
    if faults and real:
        raise InputError(
            f"{bench}: --faults shows faults to simulated axes, and {', '.join(real)} are none;"
            " leave it out, nothing moved"
        )
    import pytest  # only who tests needs it

    suite = find_spec("drivers.contract")
    assert suite is not None  # noqa: S101 - it is a part of this wheel
    words = ["-p", "drivers.contract", "--flflab-bench", str(bench.resolve())]
    words += ["--flflab-faults", str(faults), "--noconftest", "-p", "no:cacheprovider"]
    words += ["-c", os.devnull, "--rootdir", str(Path(str(suite.origin)).parent)]
    words += ["-v", "--tb", "short"]
    words += [f"--junitxml={junit}"] if junit else []
    code = pytest.main(words)
    sys.stdout.flush()
    if code:
        raise typer.Exit(INTERRUPTED if code == STOPPED_BY_CTRL_C else 1)
