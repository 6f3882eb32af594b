"""What a bench file states about how well things are known: sizes of the optics, first order, how
microlenses differ, a floor of every measurement, and the light.
"""

import math
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from flflab.description import Angle, Description, Length, Ratio
from flflab.optics.light import Spectrum

SHORTEST, LONGEST = 100e-6, 20e-3
"""Wavelengths of light that a camera sees, mm."""
MOST_LINES = 20


class OpticsUncertaintyDescription(Description):
    """How well the sizes in the camera file are known: standard uncertainties, each the same in
    every configuration.

    Sizes as shares. Angles of the array, where no axis turns it or beside what its axis states, are
    those of an array set by eye against the micro-images' rows.
    """

    main_lens_focal_length: Annotated[Ratio, Field(ge=0, lt=0.2)] = 0.0
    f_number: Annotated[Ratio, Field(ge=0, lt=0.2)] = 0.0
    microlens_focal_length: Annotated[Ratio, Field(ge=0, lt=0.2)] = 0.0
    microlens_aperture: Annotated[Ratio, Field(ge=0, lt=0.2)] = 0.0
    pitch: Annotated[Ratio, Field(ge=0, lt=0.2)] = 0.0
    array_roll: Annotated[Angle, Field(ge=0, lt=0.1)] = 5e-4
    array_tilt: Annotated[Angle, Field(ge=0, lt=0.1)] = 5e-4


class ModelUncertaintyDescription(Description):
    """How far a model of first order may be off for the bench's real lenses: standard
    uncertainties, shares of what it says.

    Each is the same in every configuration. ``flflab accuracy model`` shows their size for lenses
    like yours.
    """

    contrast: Annotated[Ratio, Field(ge=0, lt=0.5)] = 0.0
    widths: Annotated[Ratio, Field(ge=0, lt=0.5)] = 0.0
    pitch: Annotated[Ratio, Field(ge=0, lt=0.5)] = 0.0
    distance: Annotated[Ratio, Field(ge=0, lt=0.5)] = 0.0


class WorkmanshipDescription(Description):
    """How microlenses differ from one another: standard deviations from lens to lens, and ``scale``
    of the whole array.

    ``microlens_position`` is that of each coordinate of a lens with its aperture,
    ``aperture_decentre`` that of each coordinate of the aperture against its lens.
    """

    microlens_position: Annotated[Length, Field(ge=0, le=0.02)] = 0.0
    aperture_decentre: Annotated[Length, Field(ge=0, le=0.02)] = 0.0
    microlens_focal_length: Annotated[Ratio, Field(ge=0, le=0.1)] = 0.0
    microlens_brightness: Annotated[Ratio, Field(ge=0, le=0.2)] = 0.0
    scale: Annotated[Ratio, Field(ge=0, lt=0.01)] = 0.0


def _counted_in(due: str, words: str, example: str) -> BeforeValidator:
    """A number in one unit, such as ``0.02 px``; 0 needs no unit."""

    def read(given: object) -> object:
        if isinstance(given, (int, float)) and given == 0:
            return 0.0
        number, _, unit = str(given).strip().partition(" ")
        try:
            value = float(number) if unit.strip() == due else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(f"{given!r} given; {words} is due, such as '{example}'")
        return value

    return BeforeValidator(read)


Pixels = Annotated[float, _counted_in("px", "a number of pixels", "0.02 px"), Field(ge=0, le=10)]
Kelvins = Annotated[float, _counted_in("K", "a number of kelvins", "0.5 K"), Field(ge=0, le=100)]
Celsius = Annotated[float, _counted_in("degC", "a temperature", "19 degC"), Field(ge=-50, le=100)]
PerKelvin = Annotated[
    float,
    _counted_in("1/K", "a coefficient of expansion", "23e-6 1/K"),
    Field(ge=0, le=1e-3),
]


class MeasurementFloorDescription(Description):
    """What no frame and no pixel averages away of a measurement: standard uncertainties (type B),
    fully correlated within a frame and quantity, independent from frame to frame.
    """

    contrast: Annotated[Ratio, Field(ge=0, lt=0.5)] = 0.0
    position: Pixels = 0.0
    radius: Pixels = 0.0


class TargetUncertaintyDescription(Description):
    """What the targets' certificates state and how they are set: standard uncertainties, as shares
    of the length or frequency, and angles; dots and bars are two plates with lengths of their own.

    The angles are those of a target set by eye against the sensor's rows and a level.
    """

    dot_spacing: Annotated[Ratio, Field(ge=0, lt=0.1)] = 0.0
    bar_frequency: Annotated[Ratio, Field(ge=0, lt=0.1)] = 0.0
    roll: Annotated[Angle, Field(ge=0, lt=0.1)] = 5e-3
    tilt: Annotated[Angle, Field(ge=0, lt=0.1)] = 5e-3


class RepeatabilityDescription(Description):
    """How well a setting is reached again: standard deviations of the place at which a stage
    stops, where its reading is the same, and of the f-number.
    """

    stages: Annotated[Length, Field(ge=0, le=1)] = 0.0
    f_number: Annotated[Ratio, Field(ge=0, lt=0.1)] = 0.0


class TemperatureDescription(Description):
    """How well the bench's temperature is known over that of its calibration (standard
    uncertainty), by how much its distances grow with it, and in which range frames are admitted.
    """

    uncertainty: Kelvins = 0.0
    expansion: PerKelvin = 0.0
    range: tuple[Celsius, Celsius] | None = None

    @property
    def scale(self) -> float:
        """Standard uncertainty of all distances along the bench, as a share."""
        return self.uncertainty * self.expansion


def _of_light(wavelength: float) -> float:
    if not SHORTEST <= wavelength <= LONGEST:
        raise ValueError(
            f"{1e6 * wavelength:g} nm given; light has a wavelength from {1e6 * SHORTEST:g} nm to"
            f" {1e3 * LONGEST:g} um"
        )
    return wavelength


Wavelength = Annotated[Length, AfterValidator(_of_light)]
Weight = Annotated[float, Field(gt=0)]


class LightDescription(Description):
    """The light: one ``wavelength``, or a ``spectrum`` of wavelengths with what the sensor counts
    of each; the weights need not add up to 1.
    """

    wavelength: Wavelength | None = None
    spectrum: (
        Annotated[list[tuple[Wavelength, Weight]], Field(min_length=1, max_length=MOST_LINES)]
        | None
    ) = None

    @model_validator(mode="after")
    def _is_one_light(self) -> "LightDescription":
        if (self.wavelength is None) == (self.spectrum is None):
            given = "neither" if self.wavelength is None else "both"
            raise ValueError(
                f"{given} of wavelength and spectrum given; one of them is due, such as"
                " {wavelength: 550 nm} or {spectrum: [[450 nm, 0.2], [550 nm, 0.8]]}"
            )
        lengths = [wavelength for wavelength, _ in self.spectrum or []]
        if len(set(lengths)) < len(lengths):
            raise ValueError("spectrum holds a wavelength twice; give each once")
        return self

    @property
    def lines(self) -> Spectrum:
        """The light as the model takes it."""
        if self.wavelength is not None:
            return Spectrum((self.wavelength,), (1.0,))
        lines = sorted(self.spectrum or [])
        total = sum(weight for _, weight in lines)
        return Spectrum(
            tuple(wavelength for wavelength, _ in lines),
            tuple(weight / total for _, weight in lines),
        )
