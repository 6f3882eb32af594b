"""The scene file: YAML in, a frozen ``Scene`` and its sensor out; every fault with file and
line.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, Field

from flflab.description import Angle, Description, Length, Ratio, Time, check
from flflab.errors import InputError
from flflab.files.camera import read_camera
from flflab.files.target import target_from
from flflab.image.effects.colour_filter import ColourFilter
from flflab.image.effects.dark_current import DarkCurrent
from flflab.image.effects.dead_pixels import DeadPixels
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.fixed_pattern import FixedPattern
from flflab.image.effects.gamma import Gamma
from flflab.image.effects.halo import Halo
from flflab.image.effects.motion import Motion
from flflab.image.effects.quantisation import Quantisation
from flflab.image.effects.read_noise import ReadNoise
from flflab.image.effects.saturation import Saturation
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.shading import Shading
from flflab.image.effects.shot_noise import ShotNoise
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


class FixedPatternDescription(Description):
    """Scatter of the pixels' gains, and of their offsets in electrons."""

    gain: Ratio = 0.0
    offset: float = 0.0
    seed: int = 0


class DeadPixelsDescription(Description):
    """Share of the pixels that are stuck."""

    share: Ratio
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
    dead_pixels: DeadPixelsDescription | None = None

    def response(self) -> SensorResponse:
        """The frozen sensor."""
        pattern, dead = self.fixed_pattern, self.dead_pixels
        return SensorResponse(
            quantisation=Quantisation(self.bits, self.dn_per_electron, self.offset_dn),
            saturation=None if self.full_well is None else Saturation(self.full_well),
            shot_noise=ShotNoise(),
            read_noise=ReadNoise(self.read_noise) if self.read_noise else None,
            dark_current=(
                DarkCurrent(self.dark_current, self.exposure) if self.dark_current else None
            ),
            fixed_pattern=(
                None
                if pattern is None
                else FixedPattern(pattern.gain, pattern.offset, pattern.seed)
            ),
            dead_pixels=None if dead is None else DeadPixels(dead.share, dead.seed),
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
    stray_light: Ratio = 0.0
    colour_filter: ColourFilterDescription | None = None
    motion: MotionDescription | None = None
    shading: Ratio = 0.0
    halo: HaloDescription | None = None
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
    made: dict[str, Any] = {}
    for field, make in _makers(told).items():
        made[field] = _at(make, file, lines, (field,))
    scene = _at(lambda: _scene(optics, planes, told, made), file, lines, ("planes",))
    return PicturedScene(scene, made["sensor"], told.sensor.white)


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


def _makers(told: SceneDescription) -> dict[str, Callable[[], object]]:
    """For each field that can be impossible, how its effect is made."""
    scatter, mosaic, motion = told.scatter, told.colour_filter, told.motion
    return {
        "wavelength": lambda: None if told.wavelength is None else Diffraction(told.wavelength),
        "distortion": lambda: Distortion(told.distortion) if told.distortion else None,
        "scatter": lambda: (
            None
            if scatter is None
            else Scatter(
                scatter.focal_length,
                scatter.position,
                scatter.seed,
                scatter.brightness,
                scatter.aperture_decentre,
            )
        ),
        "stray_light": lambda: StrayLight(told.stray_light) if told.stray_light else None,
        "colour_filter": lambda: (
            None
            if mosaic is None
            else ColourFilter(mosaic.pattern, mosaic.red, mosaic.green, mosaic.blue)
        ),
        "motion": lambda: None if motion is None else Motion(motion.drift, motion.vibration),
        "shading": lambda: Shading(told.shading) if told.shading else None,
        "halo": lambda: None if told.halo is None else Halo(told.halo.share, told.halo.radius),
        "gamma": lambda: Gamma(told.gamma) if told.gamma != 1 else None,
        "sensor": told.sensor.response,
    }


def _scene(
    camera: Camera, planes: tuple[Plane, ...], told: SceneDescription, made: Mapping[str, Any]
) -> Scene:
    return Scene(
        camera,
        planes,
        diffraction=made["wavelength"],
        falloff=Falloff() if told.falloff else None,
        distortion=made["distortion"],
        scatter=made["scatter"],
        stray_light=made["stray_light"],
        colour_filter=made["colour_filter"],
        motion=made["motion"],
        shading=made["shading"],
        halo=made["halo"],
        gamma=made["gamma"],
    )


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
