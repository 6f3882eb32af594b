"""``flflab bench check --pin``: a person confirms that each address leads to the right stage, and
the bench file keeps the serial numbers.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from flflab.bench import Bench
from flflab.cli.connected import connected_bench
from flflab.errors import DeviceError, InputError, InterlockError, LimitError
from flflab.whole_file import write_whole
from flflab.yaml_file import edit_yaml, put

if TYPE_CHECKING:
    from drivers.base import Axis
    from drivers.bench import ConnectedBench

JOG = {"mm": 1.0, "rad": 0.0174532925}  # 1 mm or 1 degree


def pin(bench: Path, described: Bench, *, replace: bool) -> None:
    """Jog each axis, ask whether the right one moved, and write the serial numbers found.

    Raises:
        DeviceError: there is no terminal, a device has another number than the file, or a person
            said no; nothing is written.
    """
    from drivers.serials import serial_of  # devices are loaded by those who use them

    if not (sys.stdin and sys.stdin.isatty()):
        raise DeviceError(
            "a person has to see each axis move before its serial number is written; there is no"
            " terminal to ask on, run this in one"
        )
    found: dict[tuple[str, ...], str] = {}
    with connected_bench(bench, without_serials=replace) as connected:
        for name, axis in connected.axes.items():
            if not (number := serial_of(axis)):
                typer.echo(f"{name}: reports no serial number; nothing to write")
                continue
            way = axis.coordinate.show(JOG[axis.coordinate.unit], "g")
            towards = _towards(described, name, _jog(connected, axis))
            _require_yes(
                f"{name}, serial number {number}: did {described.description.axes[name].moves} move"
                f" by {way} towards {towards} and back, and nothing else?"
            )
            found["axes", name] = number
        if number := serial_of(connected.camera):
            _require_yes(f"camera, serial number {number}: is it the camera of this bench?")
            found[("camera",)] = number
    text = bench.read_text(encoding="utf-8")
    write_whole(bench, with_serials(text, str(bench), found))
    typer.echo(f"{bench}: {len(found)} serial numbers written")


def _towards(described: Bench, name: str, way: float) -> str:
    """Which way the world should have seen a jog go."""
    axis = described.description.axes[name]
    letter, forward = axis.moves.partition(".")[2], way * axis.sign > 0
    along = (" (away from the target)" if forward else " (against the light)") * (letter == "z")
    return f"{'+' if forward else '-'}{letter}{along}"


def _jog(connected: "ConnectedBench", axis: "Axis") -> float:
    """A short way and back, to whichever side is free; the way, mm or rad.

    Raises:
        NotHomedError: its place is not known.
        InterlockError: neither side is free.
    """
    start, way = axis.position(), JOG[axis.coordinate.unit]
    try:
        connected.check_way(axis.name, [start + way])
    except (InterlockError, LimitError):
        way = -way
        connected.check_way(axis.name, [start + way])
    axis.move_to(start + way).wait()
    axis.move_to(start).wait()
    return way


def _require_yes(question: str) -> None:
    if not typer.confirm(question):
        raise DeviceError(
            f"{question} no: correct the address or the wiring; no serial number was written"
        )


def with_serials(text: str, file: str, serials: Mapping[tuple[str, ...], str]) -> str:
    """A bench file's text with the serial numbers of devices; comments and the rest stay.

    Args:
        text: of the file.
        file: its name, for messages.
        serials: by where the device stands in the file.

    Raises:
        InputError: a number would be other devices', too.
    """

    def change(data: Any) -> None:
        for path, serial in serials.items():
            device = data
            for part in path:
                device = device[part]
            put(device, "serial", serial)

    try:
        return edit_yaml(text, file, change)
    except InputError as error:
        found = ", ".join(f"{'.'.join(path)} {number}" for path, number in serials.items())
        raise InputError(f"{error}; the serial numbers are {found}") from error
