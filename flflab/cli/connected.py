"""What the commands of ``flflab bench`` have in common: the bench connected, an axis by its name,
where it stands.
"""

import os
import re
import signal
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from flflab.errors import DeviceError, InputError

if TYPE_CHECKING:
    from drivers.base import Axis
    from drivers.bench import ConnectedBench
    from flflab.bench import Bench

REST_S, LOOK_S = 2.0, 0.01  # for braking
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
    from drivers.bench import connect_described  # help waits for none of it
    from drivers.simulated import memory_of
    from flflab.bench import read_bench

    described = read_bench(bench)
    if without_serials:
        described = _without_serials(described)
    with (
        connect_described(described, memory_of(described)) as connected,
        stopped_by_ctrl_z(connected),
    ):
        try:
            yield connected
        except BaseException:
            _say_where_it_stopped(connected)
            raise


def _say_where_it_stopped(bench: "ConnectedBench") -> None:
    """Stop what moves after an interruption or a fault, and say where it came to rest, as far as it
    has a reference.
    """
    moving = [name for name, axis in bench.axes.items() if axis.is_under_way()]
    with suppress(DeviceError):  # leaving the bench stops it again, and tells
        bench.stop_what_moves()
        deadline = time.monotonic() + REST_S
        for name in moving:
            axis = bench.axes[name]
            while axis.is_moving() and time.monotonic() < deadline:
                time.sleep(LOOK_S)
            if axis.is_homed() and not axis.is_moving():
                place = axis.coordinate.show(axis.position(), ".4f")
                typer.echo(f"{name} stopped at {place}", err=True)


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


def _without_serials(bench: "Bench") -> "Bench":
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
    """Say where axes are."""
    for name in names:
        axis = bench.axes[name]
        typer.echo(f"{name} is at {axis.coordinate.show(axis.position(), '.4f')}")
