"""What ``flflab image`` does around a picture: the scene in short, its effects as a table, the
ground truth's file.
"""

import json as text
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from flflab.cli.quantities import option_quantity
from flflab.cli.targets import read_target
from flflab.errors import InputError
from flflab.files.camera import read_camera
from flflab.image.choose import Decision
from flflab.image.picture import Report
from flflab.image.scene import Plane
from flflab.image.scene_file import PicturedScene, short_scene, wavelength_from
from flflab.image.sensor.response import SensorResponse
from flflab.whole_file import require_writable

DOTS = "four-dot"
ROOMY = 72  # columns of a terminal that shows bound and time of every effect

OURS = {
    "camera",
    "lattice",
    "planes",
    "reasons",
    "error_estimate",
}  # keys by which a ground truth is known


def short_way(
    camera: Path, target: str | None, distance: str, wavelength: str | None
) -> PicturedScene:
    """One target on the axis, the short way."""
    away = option_quantity("--distance", distance, "length")
    if not away > 0:
        raise InputError(
            f"--distance {distance}: a distance in front of the main lens is above 0 mm, or"
            " infinity"
        )
    bent = None if wavelength is None else _bent(wavelength)
    return PicturedScene(
        short_scene(read_camera(camera), Plane(read_target(target or DOTS), away), bent),
        SensorResponse(),
        None,
    )


def _bent(wavelength: str) -> float:
    try:
        return wavelength_from(wavelength)
    except InputError as error:
        raise InputError(f"--wavelength {error}") from error


def keys_of(effect: Decision) -> dict[str, Any]:
    """An effect, for a program."""
    return {
        "name": effect.name,
        "on": effect.on,
        "size": effect.size,
        "bound": effect.bound,
        "why": effect.why,
        "ms": effect.ms,
    }


def require_ours(file: Path) -> None:
    """Refuse to overwrite with ground truth what is none: another program's file, or an input."""
    if not file.exists():
        return
    try:
        held: object = text.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        held = None
    if not isinstance(held, dict) or not held.keys() >= OURS:
        raise InputError(
            f"{file}: the picture's ground truth goes into a file of this name, and the one that is"
            " there is none; move it, or give -o another name"
        )
    require_writable(file)


def effects_table(report: Report, width: int) -> Table:
    """One line an effect that is on or was weighed: size and why; bound and time where there is
    room.
    """
    roomy = width >= ROOMY
    table = Table(box=box.SIMPLE_HEAD, width=width, pad_edge=False, padding=(0, 1))
    for head in ("effect", "size", "bound", "", "ms") if roomy else ("effect", "size", ""):
        table.add_column(head, justify="left" if head in ("effect", "") else "right", no_wrap=True)
    table.add_column("why", ratio=1)
    for effect in report.effects:
        if not effect.on and not effect.unit:
            continue  # named in one line below
        size = "" if effect.size is None else f"{effect.size:.3g} {effect.unit}"
        state, style = ("on", "") if effect.on else ("off", "dim")
        table.add_row(
            effect.name,
            size,
            *[f"{effect.bound:.2g}"] * roomy,
            state,
            *[_short_number(effect.ms)] * roomy,
            effect.why,
            style=style,
        )
    return table


def _short_number(ms: float) -> str:
    return f"{ms:.0f}" if ms >= 10 else f"{ms:.1f}"
