"""The scene file: YAML in, a frozen ``Scene`` and its sensor out; every fault with file and
line.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, Field

from flflab.description import Angle, Description, Length, Ratio, Time, check
from flflab.errors import InputError
from flflab.files.camera import read_camera
from flflab.files.target import target_from
from flflab.image.effects.colour_filter import ColourFilter
from flflab.image.effects.columns import Columns
from flflab.image.effects.dark_current import DarkCurrent
from flflab.image.effects.dead_pixels import DeadPixels
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.fixed_pattern import FixedPattern
from flflab.image.effects.gamma import Gamma
from flflab.image.effects.halo import Halo
from flflab.image.effects.hot_pixels import HotPixels
from flflab.image.effects.motion import Motion
from flflab.image.effects.quantisation import Quantisation
from flflab.image.effects.read_noise import ReadNoise
from flflab.image.effects.saturation import Saturation
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.second_stop import SecondStop
from flflab.image.effects.shading import Shading
from flflab.image.effects.soft_rims import SoftRims
from flflab.image.effects.stray_light import StrayLight
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
EFFECTS: dict[str, Callable[..., Any]] = {
    "wavelength": Diffraction,
    "distortion": Distortion,
    "scatter": Scatter,
    "motion": Motion,
    "second_stop": SecondStop,
    "soft_rims": SoftRims,
    "shading": Shading,
    "halo": Halo,
    "stray_light": StrayLight,
    "colour_filter": ColourFilter,
    "columns": Columns,
    "gamma": Gamma,
}  # by the fields of a scene file
TargetData = str | dict[str, Any]


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


class ScatterDescription(Description):
    """Scatter of the microlenses: standard deviations of focal lengths (of themselves), places,
    brightness, and of apertures against their lenses.
    """

    focal_length: Ratio = 0.0
    position: Length = 0.0
    seed: int = 0
    brightness: Ratio = 0.0
    aperture_decentre: Length = 0.0


class ColourFilterDescription(Description):
    """The mosaic of the sensor."""

    pattern: str = ColourFilter.pattern
    red: Ratio = ColourFilter.red
    green: Ratio = ColourFilter.green
    blue: Ratio = ColourFilter.blue


class MotionDescription(Description):
    """What the targets do while light is gathered: the whole drift, the amplitude of the
    vibration.
    """

    drift: Pair = (0.0, 0.0)
    vibration: Pair = (0.0, 0.0)


class HaloDescription(Description):
    """A share of all light in a Gaussian spot, whose standard deviation is ``radius``."""

    share: Ratio
    radius: Length


class SecondStopDescription(Description):
    """A ring: how far behind the main lens, and how wide."""

    distance: Length
    diameter: Length


class ColumnsDescription(Description):
    """Scatter of the gains of columns, and of blocks of columns that are read together."""

    column: Ratio = 0.0
    tap: Ratio = 0.0
    taps: int = 2
    seed: int = 0


class FixedPatternDescription(Description):
    """Scatter of the pixels' gains, and of their offsets in electrons."""

    gain: Ratio = 0.0
    offset: float = 0.0
    seed: int = 0


class DeadPixelsDescription(Description):
    """Share of the pixels that are stuck."""

    share: Ratio
    seed: int = 0


class HotPixelsDescription(Description):
    """Share of the pixels that gather more electrons in the dark, and how many on average."""

    share: Ratio
    electrons: float
    seed: int = 0


class SensorDescription(Description):
    """How light becomes numbers; electrons are plain numbers, ``white`` those at the white
    level.
    """

    white: Annotated[float, Field(gt=0)] | None = None
    full_well: float | None = Saturation.full_well
    read_noise: float = ReadNoise.electrons
    bits: int = Quantisation.bits
    dn_per_electron: float = Quantisation.dn_per_electron
    offset_dn: float = Quantisation.offset_dn
    dark_current: float = 0.0
    exposure: Time = 0.01
    fixed_pattern: FixedPatternDescription | None = None
    hot_pixels: HotPixelsDescription | None = None
    dead_pixels: DeadPixelsDescription | None = None

    def response(self) -> SensorResponse:
        """The frozen sensor."""
        dark = DarkCurrent(self.dark_current, self.exposure) if self.dark_current else None
        return SensorResponse(
            read_noise=ReadNoise(self.read_noise) if self.read_noise else None,
            dark_current=dark,
            fixed_pattern=_made(FixedPattern, self.fixed_pattern),
            hot_pixels=_made(HotPixels, self.hot_pixels),
            dead_pixels=_made(DeadPixels, self.dead_pixels),
            saturation=None if self.full_well is None else Saturation(self.full_well),
            quantisation=Quantisation(self.bits, self.dn_per_electron, self.offset_dn),
        )


class SceneDescription(Description):
    """A scene file; without a ``wavelength`` light is rays and nothing bends, ``camera`` is a
    camera file relative to this one.
    """

    file_kind = "scene"

    camera: Path | None = None
    planes: list[PlaneDescription]
    wavelength: Annotated[float | None, BeforeValidator(_wavelength)] = None
    falloff: bool = True
    distortion: float = 0.0
    scatter: ScatterDescription | None = None
    motion: MotionDescription | None = None
    second_stop: SecondStopDescription | None = None
    soft_rims: Length = 0.0
    shading: Ratio = 0.0
    halo: HaloDescription | None = None
    stray_light: Ratio = 0.0
    colour_filter: ColourFilterDescription | None = None
    columns: ColumnsDescription | None = None
    gamma: float = 1.0
    sensor: SensorDescription = SensorDescription()


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
    told = check(data, SceneDescription, str(file), lines)
    if camera is None and told.camera is None:
        raise InputError(
            f"{file}:1: camera: this field is missing; name a camera file here or on the command"
            " line"
        )
    planes = tuple(_plane(plane, index, file, lines) for index, plane in enumerate(told.planes))
    optics = read_camera(camera if camera is not None else file.parent / (told.camera or ""))
    effects = {
        field: _at(
            lambda kind=kind, field=field: _made(kind, getattr(told, field)), file, lines, (field,)
        )
        for field, kind in EFFECTS.items()
    }
    response = _at(told.sensor.response, file, lines, ("sensor",))
    effects["diffraction"] = effects.pop("wavelength")
    falloff = Falloff() if told.falloff else None
    scene = _at(lambda: Scene(optics, planes, falloff=falloff, **effects), file, lines, ("planes",))
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
