"""``flflab bench snap`` and ``scan``: look through the camera, once, again and again, or along an
axis, with a figure of focus.
"""

import json
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flflab.cli.connected import AxisName, BenchFile, axis_named, connected_bench, say_places
from flflab.cli.ending import INTERRUPTED
from flflab.cli.quantities import option_quantity
from flflab.cli.saying import say
from flflab.errors import DeviceError, InputError
from flflab.units import parse_quantity

if TYPE_CHECKING:
    import numpy as np

    from drivers.base import CameraDevice, Frame, Setting
    from drivers.bench import ConnectedBench

ENDINGS = (".png", ".tiff", ".tif", ".dng")
WITH_DETAIL = ("bars", "chirp", "four-dot", "edge")  # the best to focus on first
FEATURELESS = ("white", "black")
MOST_FAILED = 3  # frames in a row before a live view gives up
BAR = 40  # characters
Exposure = Annotated[str, typer.Option(help="exposure time with its unit")]
Gain = Annotated[float, typer.Option(help="gain, as a factor")]


def snap(
    context: typer.Context,
    bench: BenchFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="picture to write: .png, .tiff (16 bits) or .dng"),
    ] = None,
    exposure: Exposure = "10 ms",
    gain: Gain = 1.0,
    live: Annotated[
        bool,
        typer.Option("--live", help="go on until Ctrl-C; -o then always holds the newest picture"),
    ] = False,
    last: Annotated[
        bool,
        typer.Option("--last", help="the last frame of the run that is on, which goes on"),
    ] = False,
) -> None:
    """Take one picture of whatever stands before the camera, or one after the other with a figure
    of focus.
    """
    seconds = option_quantity("--exposure", exposure, "time")
    if output is not None and output.suffix.lower() not in ENDINGS:
        raise InputError(f"{output}: a picture is written as .png, .tiff or .dng; give such a name")
    if output is None and not live:
        context.fail("give a file for the picture with -o, or look only with --live")
    if last:
        _write_last(bench, output)
        return
    with connected_bench(bench) as connected:
        camera = connected.camera
        camera.prepare(seconds, gain)
        if live:
            _watch(camera, output)
        frame = camera.grab()
        saturated = _saturated(frame, camera)
        if output is not None:
            _write(output, frame, camera, _note(frame, connected))
    rows, columns = frame.picture.shape
    typer.echo(
        f"{output}: {columns} x {rows} pixels, {frame.exposure_s:g} s, {frame.pixel_format},"
        f" {saturated} saturated"
    )


def scan(
    axis: AxisName,
    first: Annotated[str, typer.Argument(help="first reading with its unit: '10 mm', '-2 deg'")],
    last: Annotated[str, typer.Argument(help="last reading with its unit")],
    bench: BenchFile,
    points: Annotated[
        int, typer.Option(min=3, max=1000, help="how many readings, both ends included")
    ] = 11,
    exposure: Exposure = "10 ms",
    gain: Gain = 1.0,
    go: Annotated[
        bool,
        typer.Option("--go", help="at the end go to the best reading, from the side of the first"),
    ] = False,
) -> None:
    """Move an axis through a range, take a picture at each reading, and show where it is
    sharpest.
    """
    import numpy as np

    from flflab.measurement.focus import parabola_top

    seconds = option_quantity("--exposure", exposure, "time")
    with connected_bench(bench) as connected:
        moved, camera = axis_named(connected, axis), connected.camera
        show, dimension = moved.coordinate.show, moved.coordinate.dimension
        readings = np.linspace(
            parse_quantity(first, dimension), parse_quantity(last, dimension), points
        )
        if readings[0] == readings[-1]:
            raise InputError(
                f"asked to scan {axis} from {first.strip()} to {last.strip()}; the two must differ"
            )
        connected.check_way(
            axis, [float(reading) for reading in readings]
        )  # all of it before anything moves
        _show_detail(connected)
        camera.prepare(seconds, gain)
        figures = np.zeros(points)
        saturated = 0
        for place_, reading in enumerate(readings):
            moved.move_to(float(reading)).wait()
            frame = camera.grab()
            figures[place_] = _figure(frame, camera)
            saturated = max(saturated, _saturated(frame, camera))
            sys.stderr.write(
                f"{place_ + 1}/{points} {show(float(reading), '.4f')}  sharpness"
                f" {figures[place_]:.5f}\n"
            )
        best = parabola_top(readings, figures)
        for line in _curve([show(float(reading), ".4f") for reading in readings], figures):
            typer.echo(line)
        if saturated:
            typer.echo(
                f"up to {saturated} pixels saturated: expose less, else the figure says little"
            )
        if best is None:
            end = show(float(readings[int(figures.argmax())]), ".4f")
            typer.echo(f"sharpest at the end of the range, {end}: scan beyond it")
            return
        typer.echo(f"sharpest at {show(best, '.4f')}")
        if not go:
            typer.echo(
                f'to go there: flflab bench move {axis} "{show(best, ".4f")}" --bench {bench}'
            )
        if go:
            moved.move_to(float(readings[0])).wait()
            moved.move_to(best).wait()
            say_places(connected, axis)


def _show_detail(bench: "ConnectedBench") -> None:
    """Have a target in place that can be in focus, and say which one it is.

    Raises:
        DeviceError: none is in place, and none could be put there.
    """
    try:
        present = bench.target.value()
    except DeviceError:  # a person has not confirmed any
        present = ""
    if present not in ("", *FEATURELESS):
        typer.echo(f"focus is looked for on the {present} target")
        return
    shown = next((kind for kind in WITH_DETAIL if kind in bench.target.allowed), None)
    if shown is None:
        raise DeviceError(
            f"target: {present or 'nothing known'} is in place, which has nothing to focus on, and"
            f" there is none of {', '.join(WITH_DETAIL)} here; nothing moved, show another target"
        )
    bench.target.set(shown).wait()
    typer.echo(f"focus is looked for on the {shown} target, shown for it")


def _watch(camera: "CameraDevice", output: Path | None) -> None:
    """Show every frame's figure until Ctrl-C.

    Raises:
        typer.Exit: with code 130, at Ctrl-C.
        DeviceError: several frames in a row failed; a single one is told and the view goes on.
    """
    best, failed = 0.0, 0
    end = "\r" if sys.stdout.isatty() else "\n"
    try:
        while True:
            begun = time.monotonic()
            try:
                frame = camera.grab()
            except DeviceError as error:
                failed += 1
                if failed == MOST_FAILED:
                    raise
                say(f"flflab: {error}")
                continue
            failed = 0
            figure = _figure(frame, camera)
            best = max(best, figure)
            if output is not None:
                _write(output, frame, camera)
            rate = 1 / max(time.monotonic() - begun, 1e-6)
            facts = f"best {best:.5f}, {_saturated(frame, camera)} saturated, {rate:.1f} frames/s"
            sys.stdout.write(
                f"frame {frame.number}  sharpness {figure:.5f}"
                f" {_bar(figure / best if best else 0.0)} {facts}  {end}"
            )
            sys.stdout.flush()
    except KeyboardInterrupt:
        sys.stdout.write("\n")
        raise typer.Exit(INTERRUPTED) from None


def _figure(frame: "Frame", camera: "CameraDevice") -> float:
    from flflab.measurement.focus import focus_figure  # a bench that stops waits for no kernels

    return focus_figure(
        frame.picture, camera.offset_dn, camera.dn_per_electron, camera.read_noise_dn
    )


def _saturated(frame: "Frame", camera: "CameraDevice") -> int:
    return int((frame.picture >= camera.full_scale).sum())


def _bar(share: float) -> str:
    return ("#" * round(BAR * share)).ljust(BAR, ".")


def _curve(readings: list[str], figures: "np.ndarray") -> Iterator[str]:
    """A table with a bar for each reading, scaled between the least and the largest figure."""
    least, most = float(figures.min()), float(figures.max())
    width = max(map(len, readings))
    for reading, figure in zip(readings, figures, strict=True):
        share = (figure - least) / (most - least) if most > least else 1.0
        yield f"{reading.rjust(width)}  {figure:.5f}  {'#' * max(1, round(BAR * share))}"


def _write_last(bench: Path, output: Path | None) -> None:
    """Write the last frame of the program that drives the bench."""
    from drivers.answers import ask_for_last_frame
    from flflab.files.image import write_picture

    facts, picture = ask_for_last_frame(bench)
    if output is not None:
        write_picture(output, picture, note=json.dumps(facts))
    rows, columns = picture.shape
    typer.echo(
        f"{output}: {columns} x {rows} pixels, {facts['exposure_s']:g} s, frame {facts['number']}"
        " of the run that is on"
    )


def _note(frame: "Frame", bench: "ConnectedBench") -> str:
    """What a picture was taken with, and where everything stood, as JSON: what nobody knows is
    null.
    """
    from procedures.by_hand import where

    def known(setting: "Setting[Any]") -> Any:
        try:
            return setting.value()
        except DeviceError:
            return None

    return json.dumps(
        {
            "taken": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "exposure_s": frame.exposure_s,
            "gain": frame.gain,
            "f_number": known(bench.iris),
            "target": known(bench.target),
            "world": where(bench),  # mm, rad
            "readings": {
                axis.coordinate.column(name): axis.position() if axis.is_homed() else None
                for name, axis in bench.axes.items()
            },
            "camera": bench.camera.identity(),
            "bench": bench.described.file.name,
        }
    )


def _write(output: Path, frame: "Frame", camera: "CameraDevice", note: str = "") -> None:
    from flflab.files.image import write_picture
    from flflab.files.raw import RawPicture, write_raw

    if output.suffix.lower() == ".dng":
        mosaic = (
            frame.pixel_format.removeprefix("Bayer").rstrip("0123456789")
            if frame.pixel_format.startswith("Bayer")
            else ""
        )
        pattern = {"RG": "rggb", "BG": "bggr", "GR": "grbg", "GB": "gbrg"}.get(mosaic)
        black = round(camera.offset_dn)
        write_raw(
            output,
            RawPicture(
                frame.picture,
                pattern,
                (black, black, black, black),
                camera.full_scale,
                exposure_s=frame.exposure_s,
                note=note,
            ),
        )
    else:
        write_picture(output, frame.picture, note=note)
