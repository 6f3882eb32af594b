"""The camera file: YAML in, a frozen ``Camera`` out; what is given twice and disagrees is said in
one sentence.
"""

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PositiveInt, model_validator

from flflab.description import Angle, Description, Length, Ratio, load
from flflab.errors import InputError
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Substrate, Useful
from flflab.optics.distortion import BrownDistortion

PositiveLength = Annotated[Length, Field(gt=0)]
Share = Annotated[Ratio, Field(ge=0, le=1)]
MicrolensCount = Annotated[
    int, Field(ge=1, le=1000)
]  # a side: the model of a million takes 0.9 GB, and the memory grows as the square


def _as_list(given: object) -> object:
    return given if isinstance(given, list) else [given]


def _as_pair(given: object) -> object:
    return given if isinstance(given, list) else [given, given]


def _not_zero(focal: float) -> float:
    if focal == 0:
        raise ValueError("0 mm is no focal length; give that of the microlens")
    return focal


def _coefficient(unit: str) -> BeforeValidator:
    """A validator of a number in the one unit that a coefficient of distortion has."""

    def read(given: object) -> float:
        if isinstance(given, (int, float)) and given == 0:
            return 0.0
        number, _, rest = str(given).strip().partition(" ")
        try:
            value = float(number) if rest.strip() == unit else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(f"{given!r} given; a number and {unit} is due, such as '1e-6 {unit}'")
        return value

    return BeforeValidator(read)


class DistortionDescription(Description):
    """Distortion of the main lens, of its image points in mm (see ``BrownDistortion``)."""

    radial: tuple[
        Annotated[float, _coefficient("1/mm^2")],
        Annotated[float, _coefficient("1/mm^4")],
        Annotated[float, _coefficient("1/mm^6")],
    ]
    tangential: tuple[
        Annotated[float, _coefficient("1/mm")], Annotated[float, _coefficient("1/mm")]
    ] = (0.0, 0.0)


class MainLensDescription(Description):
    """Main lens: focal length, f-number and, for a thick one, how far its rear principal plane lies
    behind its front one.
    """

    focal_length: PositiveLength
    f_number: Annotated[float, Field(gt=0)]
    principal_separation: Length = 0.0
    distortion: DistortionDescription | None = None


class SubstrateDescription(Description):
    """The plate that carries the microlenses: thickness, refractive index, and which way it faces
    from them.
    """

    thickness: Annotated[Length, Field(ge=0)]
    refractive_index: Annotated[float, Field(ge=1)]
    side: Literal["sensor", "main lens"] = "sensor"


class ArrayDescription(Description):
    """Microlens array: layout, lattice, and its lenses by focal length, by radius and index, or by
    numerical aperture.
    """

    layout: Literal["square", "hexagonal"]
    count: tuple[MicrolensCount, MicrolensCount]
    pitch: Annotated[tuple[PositiveLength, PositiveLength], BeforeValidator(_as_pair)]
    aperture: PositiveLength | None = None
    focal_length: (
        Annotated[
            list[Annotated[Length, AfterValidator(_not_zero)]],
            BeforeValidator(_as_list),
            Field(min_length=1),
        ]
        | None
    ) = None
    pattern: list[list[int]] = Field(default=[[0]])
    radius_of_curvature: PositiveLength | None = None
    refractive_index: Annotated[float, Field(gt=1)] | None = None
    numerical_aperture: Annotated[float, Field(gt=0, lt=1)] | None = None
    distance: PositiveLength
    offset: tuple[Length, Length] = (0.0, 0.0)
    roll: Angle = 0.0
    tilt: tuple[Angle, Angle] = (0.0, 0.0)
    substrate: SubstrateDescription | None = None

    @model_validator(mode="after")
    def _needs_a_focal_length(self) -> "ArrayDescription":
        by_curvature = self.radius_of_curvature is not None and self.refractive_index is not None
        by_aperture = self.numerical_aperture is not None and self.aperture is not None
        if self.focal_length is None and not by_curvature and not by_aperture:
            raise ValueError(
                "give focal_length, or radius_of_curvature with refractive_index, or"
                " numerical_aperture with aperture"
            )
        if self.aperture is None and self.numerical_aperture is None:
            raise ValueError(
                "give aperture (the clear diameter of one microlens), or numerical_aperture"
            )
        return self

    def lenses(self) -> tuple[tuple[float, ...], float, tuple[str, ...]]:
        """Focal lengths and clear aperture in mm, and one sentence for each surplus figure that
        disagrees.

        f = R / (n - 1); NA = sin(atan(d / 2f)) so d = 2 f tan(asin NA).
        """
        curved = None
        if self.radius_of_curvature is not None and self.refractive_index is not None:
            curved = self.radius_of_curvature / (self.refractive_index - 1)
        slope = (
            None
            if self.numerical_aperture is None
            else math.tan(math.asin(self.numerical_aperture))
        )
        by_aperture = (
            None if slope is None or self.aperture is None else self.aperture / (2 * slope)
        )
        ways = {
            "focal_length": self.focal_length[0] if self.focal_length else None,
            "radius_of_curvature and refractive_index": curved,
            "numerical_aperture and aperture": by_aperture,
        }
        given = {name: value for name, value in ways.items() if value is not None}
        used, focal = next(iter(given.items()))
        remarks = tuple(
            f"the microlens focal length by {name} is {value:.4g} mm; {focal:.4g} mm by {used} was"
            " used"
            for name, value in given.items()
            if abs(value / focal - 1) > 0.005
        )
        aperture = self.aperture if self.aperture is not None else 2 * focal * (slope or 0.0)
        return tuple(self.focal_length or [focal]), aperture, remarks


MOST_PIXELS = 500_000_000  # twice as many as any sensor that is sold


def _a_sensor_s(given: tuple[int, int]) -> tuple[int, int]:
    columns, rows = given
    if columns * rows > MOST_PIXELS:
        raise ValueError(
            f"{columns:,} x {rows:,} are more pixels than any sensor has; at most"
            f" {MOST_PIXELS:,} are allowed"
        )
    return given


class SensorDescription(Description):
    """Sensor: (columns, rows), pixel size, distance behind the main lens."""

    resolution: Annotated[tuple[PositiveInt, PositiveInt], AfterValidator(_a_sensor_s)]
    pixel: PositiveLength
    distance: PositiveLength
    offset: tuple[Length, Length] = (0.0, 0.0)


class UsefulDescription(Description):
    """Which part of a micro-image counts."""

    minimum_illumination: Share = 0.0
    maximum_crosstalk: Share = 0.0


class CameraDescription(Description):
    """A camera file."""

    file_kind = "camera"

    main_lens: MainLensDescription
    microlens_array: ArrayDescription
    sensor: SensorDescription
    aperture_shape: Literal["round", "square"] = "round"
    useful: UsefulDescription = UsefulDescription()

    @model_validator(mode="after")
    def _is_a_camera(self) -> "CameraDescription":
        try:
            self.camera()
        except InputError as error:
            raise ValueError(str(error).removeprefix("camera: ")) from error
        return self

    @model_validator(mode="after")
    def _sees_a_micro_image(self) -> "CameraDescription":
        """Sizes that no one camera has are units meant otherwise; what is computed may look at a
        part of a sensor, however small.
        """
        sensor, pitches = self.sensor, self.microlens_array.pitch
        columns, rows = (count * sensor.pixel for count in sensor.resolution)
        if max(pitches) > max(columns, rows):
            raise ValueError(
                f"microlens_array.pitch is {max(pitches):g} mm, more than the whole sensor of"
                f" {columns:g} mm x {rows:g} mm; its longer side at most is allowed: check the"
                " units of pitch and pixel"
            )
        if sensor.pixel > min(pitches):
            raise ValueError(
                f"sensor.pixel is {sensor.pixel:g} mm, more than the {min(pitches):g} mm from"
                " microlens to microlens; the pitch at most is allowed: check the units of pixel"
                " and pitch"
            )
        return self

    def camera(self) -> Camera:
        """The frozen camera this file describes."""
        array, plate = self.microlens_array, self.microlens_array.substrate
        focal_lengths, aperture, _ = array.lenses()
        bent = self.main_lens.distortion
        return Camera(
            MainLens(
                self.main_lens.focal_length,
                self.main_lens.f_number,
                self.main_lens.principal_separation,
                None if bent is None else BrownDistortion(bent.radial, bent.tangential),
            ),
            MicrolensArray(
                layout=array.layout,
                count=array.count,
                pitch=array.pitch,
                aperture=aperture,
                focal_lengths=focal_lengths,
                distance=array.distance,
                pattern=tuple(tuple(row) for row in array.pattern),
                offset=array.offset,
                roll=array.roll,
                tilt=array.tilt,
                substrate=(
                    None
                    if plate is None
                    else Substrate(plate.thickness, plate.refractive_index, plate.side)
                ),
            ),
            Sensor(
                self.sensor.resolution, self.sensor.pixel, self.sensor.distance, self.sensor.offset
            ),
            self.aperture_shape,
            Useful(self.useful.minimum_illumination, self.useful.maximum_crosstalk),
        )

    def remarks(self) -> tuple[str, ...]:
        """Sentences about figures that were given twice and disagree, or that first order leaves
        out.
        """
        remarks = self.microlens_array.lenses()[2]
        if self.main_lens.distortion is not None:
            remarks += (
                "main_lens.distortion is left out: the model is of first order; only flflab"
                " compare uses it",
            )
        return remarks


def read_camera(file: Path) -> Camera:
    """Read a camera file.

    Raises:
        InputError: a field is missing, unknown, without a unit or impossible; the message names
            file, line and field.
    """
    return load(file, CameraDescription).camera()
