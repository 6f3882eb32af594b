"""Targets from descriptions: a bare kind, a mapping of fields, or a YAML file with one."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field

from flflab.description import Angle, Description, Frequency, Length, check, require_kind
from flflab.errors import InputError, reason
from flflab.targets import (
    Bars,
    BarsAlongY,
    Black,
    Chirp,
    Edge,
    FourDot,
    Picture,
    Target,
    Texture,
    White,
)
from flflab.yaml_file import read_yaml

PositiveLength = Annotated[Length, Field(gt=0)]


def _with_unit(given: object) -> object:
    """The unit of ``cycles_per_mm`` stands in its name, so a bare number is enough."""
    return (
        f"{given!r} cycles/mm"
        if isinstance(given, (int, float)) and not isinstance(given, bool)
        else given
    )


CyclesPerMm = Annotated[Frequency, BeforeValidator(_with_unit), Field(gt=0)]


class FourDotDescription(Description):
    """Four white dots on black."""

    kind: Literal["four-dot"]
    diameter: PositiveLength = FourDot.diameter
    spacing: PositiveLength = FourDot.spacing


class BarsDescription(Description):
    """Square bars across x or y, or a sine across x, of linearly changing frequency."""

    kind: Literal["bars", "bars-y", "chirp"]
    cycles_per_mm: tuple[CyclesPerMm, CyclesPerMm] = Bars.cycles_per_mm
    width: PositiveLength = Bars.width
    height: PositiveLength = Bars.height


class EdgeDescription(Description):
    """A straight edge."""

    kind: Literal["edge"]
    angle: Angle = Edge.angle


class PlainDescription(Description):
    """White or black."""

    kind: Literal["white", "black"]


class PictureDescription(Description):
    """A grey picture from a file that OpenCV reads, or a .npy file of radiances from 0 to 1."""

    kind: Literal["picture"]
    file: Path
    width: PositiveLength


class TextureDescription(Description):
    """A random texture."""

    kind: Literal["texture"]
    width: PositiveLength = Texture.width
    grain: PositiveLength = Texture.grain
    seed: Annotated[int, Field(ge=0)] = Texture.seed


DESCRIPTIONS: dict[str, type[Description]] = {
    "four-dot": FourDotDescription,
    "bars": BarsDescription,
    "bars-y": BarsDescription,
    "chirp": BarsDescription,
    "edge": EdgeDescription,
    "white": PlainDescription,
    "black": PlainDescription,
    "picture": PictureDescription,
    "texture": TextureDescription,
}


def target_from(
    data: str | Mapping[str, Any],
    source: str = "target",
    folder: Path = Path(),
    lines: Mapping[tuple[str | int, ...], int] | None = None,
    under: tuple[str | int, ...] = (),
) -> Target:
    """Make a target of a bare kind (its defaults) or of a mapping of fields.

    Args:
        data: for instance ``four-dot`` or ``{kind: four-dot, diameter: 1 mm, spacing: 8 mm}``.
        source: where the data stood, for the errors.
        folder: what a picture's relative path is relative to.
        lines: the line of every field of the file that the data stood in.
        under: where in that file the data stood.

    Raises:
        InputError: an unknown kind or field, a quantity without a unit, an impossible value, or a
            picture that cannot be read.
    """
    given: dict[str, Any] = {"kind": data} if isinstance(data, str) else dict(data)
    return _made(given, source, lines or {}, folder, under)


def load_target(file: Path) -> Target:
    """Read a target from a YAML file; a picture's path is relative to that file.

    Raises:
        InputError: as ``target_from``, with file and line.
    """
    data, lines = read_yaml(file)
    require_kind(data, "target", str(file))
    return _made(data, str(file), lines, Path(file).parent)


def _made(
    data: dict[str, Any],
    source: str,
    lines: Mapping[tuple[str | int, ...], int],
    folder: Path,
    under: tuple[str | int, ...] = (),
) -> Target:
    place = ".".join(str(part) for part in (*under, "kind"))
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in DESCRIPTIONS:
        asked = "this field is missing" if kind is None else f"{kind!r} is not a target"
        raise InputError(
            f"{source}:{lines.get((*under, 'kind'), lines.get(under, 1))}: {place}: {asked};"
            f" allowed: {', '.join(DESCRIPTIONS)}"
        )
    found = check(data, DESCRIPTIONS[kind], source, lines, under)
    try:
        match found:
            case FourDotDescription():
                return FourDot(found.diameter, found.spacing)
            case BarsDescription():
                made = {"bars": Bars, "bars-y": BarsAlongY, "chirp": Chirp}[found.kind]
                return made(found.cycles_per_mm, found.width, found.height)
            case EdgeDescription():
                return Edge(found.angle)
            case TextureDescription():
                return Texture(found.width, found.grain, found.seed)
            case PictureDescription():
                return _read_picture(folder / found.file, found.width)
            case _:
                return White() if kind == "white" else Black()
    except InputError as error:
        raise InputError(f"{source}:{lines.get(under, 1)}: {error}") from error


def _read_picture(file: Path, width: float) -> Picture:
    """A grey picture as radiances: whole numbers count from 0 to their type's largest, real numbers
    stand for themselves.
    """
    import cv2  # only who has a picture as a target waits for it

    try:
        coded = np.load(file) if file.suffix == ".npy" else np.fromfile(file, dtype=np.uint8)
        values = (
            coded
            if file.suffix == ".npy"
            else cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        )
    except (OSError, ValueError, cv2.error) as error:
        raise InputError(
            f"the picture {file} cannot be read ({reason(error)}); give a .png, .tiff, .jpg or .npy"
            " file"
        ) from error
    if values is None:
        raise InputError(
            f"the picture {file} is of no kind that can be read; give a .png, .tiff, .jpg or .npy"
            " file"
        )
    grey: npt.NDArray[Any] = np.asarray(values)
    full = float(np.iinfo(str(grey.dtype)).max) if grey.dtype.kind in "iu" else 1.0
    return Picture(grey.astype(np.float64) / full, width)
