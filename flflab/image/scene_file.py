"""The scene file: YAML in, a frozen ``Scene`` and its sensor out; every fault with file and
line.
"""

import math
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

from pydantic import BeforeValidator, Field, create_model

from flflab.description import Angle, Description, Length, Ratio, Time, check
from flflab.errors import InputError
from flflab.files.camera import read_camera
from flflab.files.target import target_from
from flflab.image.effects.dark_current import DarkCurrent
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.gamma import Gamma
from flflab.image.effects.quantisation import Quantisation
from flflab.image.effects.read_noise import ReadNoise
from flflab.image.effects.saturation import Saturation
from flflab.image.scene import Plane, Scene
from flflab.image.sensor.response import SensorResponse
from flflab.optics.camera import Camera
from flflab.units import parse_quantity
from flflab.yaml_file import Lines, read_yaml

Pair = tuple[Length, Length]
LIGHT = (100e-6, 20e-3)  # mm: shortest and longest wavelength


def _distance(given: object) -> float:
    """A length in front of the main lens."""
    try:
        away = parse_quantity(given, "length")
    except InputError as error:
        raise ValueError(str(error)) from error
    if not away > 0:
        raise ValueError(
            f"{given}: a distance in front of the main lens is above 0 mm, or infinity"
        )
    return away


def wavelength_from(given: object) -> float:
    """A wavelength in mm, of light that a camera sees.

    Raises:
        InputError: it is no length, or not within ``LIGHT``.
    """
    wavelength = parse_quantity(given, "length")
    if not LIGHT[0] <= wavelength <= LIGHT[1]:
        raise InputError(
            f"{given}: light has a wavelength from {1e6 * LIGHT[0]:g} nm to {1e3 * LIGHT[1]:g} um"
            " here"
        )
    return wavelength


def _wavelength(given: object) -> float | None:
    """A length, or ``none`` for light that does not bend."""
    if given is None or given == "none":
        return None
    try:
        return wavelength_from(given)
    except InputError as error:
        raise ValueError(f"{error}; or none for light that does not bend") from error


Distance = Annotated[float, Field(allow_inf_nan=True), BeforeValidator(_distance)]
Made = TypeVar("Made")
UNITS: dict[str, Any] = {"mm": Length, "s": Time}  # what is read with a unit, and counted in one
TargetData = str | dict[str, Any]


def _parts(kind: type, *others: str) -> dict[str, Any]:
    """The effects that a scene or a sensor may lack, by their fields, but for some."""
    hints = {name: get_args(hint) for name, hint in get_type_hints(kind).items()}
    return {
        name: kinds[0] for name, kinds in hints.items() if NoneType in kinds and name not in others
    }


def _described(effect: Any) -> tuple[Any, Any]:
    """A file's field for an effect that may be left out: its parameters, or the number where it has
    only one.
    """
    given: Any = {}
    for one in fields(effect):
        unit, kind = one.metadata.get("unit", ""), one.type
        if unit in UNITS:
            kind = UNITS[unit] if kind is float else Pair
        elif kind is float and (not unit or unit.startswith("of ")):
            kind = Ratio
        given[one.name] = kind, ... if one.default is MISSING else one.default
    if len(given) == 1:
        ((kind, _),) = given.values()
    else:
        kind = create_model(f"{effect.__name__}Description", __base__=Description, **given)
    return kind | None, None


def _with_parts(base: type[Description], parts: dict[str, Any], **others: Any) -> Any:
    """A description that has a field more for each of these effects."""
    described: Any = {name: _described(kind) for name, kind in parts.items()}
    return create_model(base.__name__, __base__=base, **others, **described)


class PlaneDescription(Description):
    """A flat target: what, how far, and how it stands; ``size`` is that of the opaque card that
    carries it.
    """

    target: TargetData
    distance: Distance
    offset: Pair = (0.0, 0.0)
    roll: Angle = 0.0
    tilt: tuple[Angle, Angle] = (0.0, 0.0)
    size: Pair | None = None


class SensorDescription(Description):
    """How light becomes numbers; electrons are plain numbers, ``white`` those at the white level.
    Its faults are fields of their own.
    """

    white: Annotated[float, Field(gt=0)] | None = None
    full_well: float | None = Saturation.full_well
    read_noise: float = ReadNoise.electrons
    bits: int = Quantisation.bits
    dn_per_electron: float = Quantisation.dn_per_electron
    offset_dn: float = Quantisation.offset_dn
    dark_current: float = 0.0
    exposure: Time = 0.01

    def response(self) -> SensorResponse:
        """The frozen sensor."""
        dark = DarkCurrent(self.dark_current, self.exposure) if self.dark_current else None
        return SensorResponse(
            read_noise=ReadNoise(self.read_noise) if self.read_noise else None,
            dark_current=dark,
            saturation=None if self.full_well is None else Saturation(self.full_well),
            quantisation=Quantisation(self.bits, self.dn_per_electron, self.offset_dn),
            **{name: _made(kind, getattr(self, name)) for name, kind in FAULTS.items()},
        )


class SceneDescription(Description):
    """A scene file; without a ``wavelength`` light is rays and nothing bends, ``camera`` is a
    camera file relative to this one. Other effects are fields of their own.
    """

    file_kind = "scene"

    camera: Path | None = None
    planes: list[PlaneDescription]
    wavelength: Annotated[float | None, BeforeValidator(_wavelength)] = None
    falloff: bool = True


EFFECTS = _parts(Scene, "diffraction", "falloff")
FAULTS = _parts(SensorResponse, "saturation", "shot_noise", "read_noise", "dark_current")
SENSOR = _with_parts(SensorDescription, FAULTS)
SCENE = _with_parts(SceneDescription, EFFECTS, sensor=(SENSOR, SENSOR()))


@dataclass(frozen=True)
class PicturedScene:
    """What a scene file describes: the scene, the sensor, and mean electrons at the white level
    (None: by the exposure rule).
    """

    scene: Scene
    response: SensorResponse
    electrons_at_white: float | None


def read_scene(file: Path, camera: Path | None = None) -> PicturedScene:
    """Read a scene file.

    Args:
        file: the scene.
        camera: a camera file that takes the place of the one the scene names.

    Raises:
        InputError: a field is missing, unknown, without a unit or impossible, or no camera is
            named; with file, line and field.
    """
    file = Path(file)
    data, lines = read_yaml(file)
    told = check(data, SCENE, str(file), lines)
    if camera is None and told.camera is None:
        raise InputError(
            f"{file}:1: camera: this field is missing; name a camera file here or on the command"
            " line"
        )
    planes = tuple(_plane(plane, index, file, lines) for index, plane in enumerate(told.planes))
    optics = read_camera(camera if camera is not None else file.parent / (told.camera or ""))
    effects: dict[str, Any] = {
        field: _at(
            lambda kind=kind, field=field: _made(kind, getattr(told, field)), file, lines, (field,)
        )
        for field, kind in EFFECTS.items()
    }
    response = _at(told.sensor.response, file, lines, ("sensor",))
    falloff = Falloff() if told.falloff else None
    bent = None if told.wavelength is None else Diffraction(told.wavelength)
    scene = _at(
        lambda: Scene(optics, planes, diffraction=bent, falloff=falloff, **effects),
        file,
        lines,
        ("planes",),
    )
    return PicturedScene(scene, response, told.sensor.white)


def short_scene(camera: Camera, plane: Plane, wavelength: float | None = None) -> Scene:
    """One target and nothing out of order: light falls off towards the border, and bends where it
    has a wavelength (mm).
    """
    return Scene(
        camera,
        (plane,),
        diffraction=None if wavelength is None else Diffraction(wavelength),
        falloff=Falloff(),
    )


def _made(kind: Callable[..., Made], given: Description | float | None) -> Made | None:
    """An effect from what a file says of it; None where that is the ideal."""
    if given is None or given == (1.0 if kind is Gamma else 0.0):
        return None
    return kind(**dict(given)) if isinstance(given, Description) else kind(given)


def _plane(told: PlaneDescription, index: int, file: Path, lines: Lines) -> Plane:
    under = ("planes", index)
    target = target_from(told.target, str(file), file.parent, lines, (*under, "target"))
    tilt = math.tan(told.tilt[0]), math.tan(told.tilt[1])
    return _at(
        lambda: Plane(target, told.distance, told.offset, told.roll, tilt, told.size),
        file,
        lines,
        under,
    )


def _at(make: Callable[[], Made], file: Path, lines: Lines, path: tuple[str | int, ...]) -> Made:
    """Make a part; what it refuses is told with file and line."""
    try:
        return make()
    except InputError as error:
        raise InputError(f"{file}:{lines.get(path, 1)}: {error}") from error
