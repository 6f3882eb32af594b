"""What the commands of ``flflab bench`` have in common: the bench connected, an axis by its name,
where it stands.
"""

import os
import re
import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from flflab.bench import Bench, read_bench
from flflab.errors import DeviceError, InputError

if TYPE_CHECKING:
    from drivers.base import Axis
    from drivers.bench import ConnectedBench

BenchFile = Annotated[Path, typer.Option("--bench", help="bench file (YAML)")]
AxisName = Annotated[str, typer.Argument(help="name of an axis in the bench file")]


class TakesReadings(TyperCommand):
    """A command that takes ``-1 mm`` for the reading it is: what begins with a minus and a digit is
    no option's name.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """A space before a reading keeps it from looking like an option; quantities may begin with
        one.
        """
        return super().parse_args(
            ctx, [f" {given}" if re.match(r"-\.?\d", given) else given for given in args]
        )


@contextmanager
def connected_bench(
    bench: Path, *, without_serials: bool = False
) -> Generator["ConnectedBench", None, None]:
    """The bench connected; Ctrl-C and any fault stop every axis that moves before it is let go,
    Ctrl-Z before the program sleeps.

    Args:
        bench: the bench file.
        without_serials: take the devices that are there, whatever numbers the file expects.
    """
    from drivers.bench import connect_described  # devices are loaded by those who use them

    described = read_bench(bench)
    if without_serials:
        described = _without_serials(described)
    with connect_described(described) as connected, stopped_by_ctrl_z(connected):
        yield connected


@contextmanager
def stopped_by_ctrl_z(bench: "ConnectedBench") -> Generator[None, None, None]:
    """Stop every axis before this program is suspended: it would see no motion to its end."""
    if not hasattr(signal, "SIGTSTP") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop_and_sleep(number: int, frame: object) -> None:
        with suppress(DeviceError):  # the sentinel stops them, too
            bench.stop()
        signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)
        signal.signal(signal.SIGTSTP, stop_and_sleep)  # it was woken

    before = signal.signal(signal.SIGTSTP, stop_and_sleep)
    try:
        yield
    finally:
        signal.signal(signal.SIGTSTP, before)


def _without_serials(bench: Bench) -> Bench:
    description = bench.description
    axes = {name: axis.model_copy(update={"serial": ""}) for name, axis in description.axes.items()}
    camera = description.camera.model_copy(update={"serial": ""})
    return replace(
        bench, description=description.model_copy(update={"axes": axes, "camera": camera})
    )


def axis_named(bench: "ConnectedBench", name: str) -> "Axis":
    """One axis.

    Raises:
        InputError: there is none of that name.
    """
    try:
        return bench.axes[name]
    except KeyError:
        raise InputError(
            f"there is no axis {name} on this bench; its axes are {', '.join(bench.axes)}"
        ) from None


def say_places(bench: "ConnectedBench", *names: str) -> None:
    """Say where axes are, and of axes that are simulated for this command alone that they forget
    it.
    """
    for name in names:
        axis = bench.axes[name]
        typer.echo(f"{name} is at {axis.coordinate.show(axis.position(), '.4f')}")
    if any(bench.described.description.axes[name].address == "simulated" for name in names):
        typer.echo(
            "this bench was simulated for this command alone and forgets it; `flflab sim"
            f" {bench.described.file} --write-bench served.yaml` serves one that stays, for --bench"
            " served.yaml",
            err=True,
        )
