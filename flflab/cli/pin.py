"""``flflab bench check --pin``: a person confirms that each address leads to the right stage, and
the bench file keeps the serial numbers.
"""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
import yaml

from flflab.bench import Bench
from flflab.cli.connected import connected_bench
from flflab.errors import DeviceError, InputError, InterlockError, LimitError
from flflab.whole_file import write_whole

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
    for path, number in found.items():
        text = with_serial(text, path, number)
    write_whole(bench, text)
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


def with_serial(text: str, path: tuple[str, ...], serial: str) -> str:
    """A bench file's text with the serial number of a device; every other character stays.

    Raises:
        InputError: the text has no such device, or others share its keys.
    """
    changed = _changed(text, path, serial)
    if yaml.safe_load(changed) != _with(yaml.safe_load(text), path, serial):
        raise InputError(
            f"{'.'.join(path)}: its serial number would be other devices', too (an anchor?); write"
            f" serial: {json.dumps(serial)} into the file by hand"
        )
    return changed


def _with(data: Any, path: tuple[str, ...], serial: str) -> Any:
    if not path:
        return {**data, "serial": serial}
    return {**data, path[0]: _with(data[path[0]], path[1:], serial)}


def _changed(text: str, path: tuple[str, ...], serial: str) -> str:
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    for part in path:
        entries = node.value if isinstance(node, yaml.MappingNode) else []
        node = next((value for key, value in entries if key.value == part), None)
    if not isinstance(node, yaml.MappingNode):
        raise InputError(f"{'.'.join(path)}: there is no such device in the file")
    for key, value in node.value:
        if key.value == "serial":
            return (
                text[: value.start_mark.index] + json.dumps(serial) + text[value.end_mark.index :]
            )
    first = node.value[0][0].start_mark
    behind = ", " if node.flow_style else "\n" + " " * first.column
    return f"{text[: first.index]}serial: {json.dumps(serial)}{behind}{text[first.index :]}"
