"""The bench file: what stands on the bench, where, how far it may go, how well zeros are known."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    model_validator,
)

from flflab.bench_clearance import EnvelopesDescription, MinimumGaps, of_array_and_sensor
from flflab.bench_simulated import SimulatedDescription
from flflab.bench_uncertainty import (
    LightDescription,
    MeasurementFloorDescription,
    ModelUncertaintyDescription,
    OpticsUncertaintyDescription,
    RepeatabilityDescription,
    TargetUncertaintyDescription,
    TemperatureDescription,
    WorkmanshipDescription,
)
from flflab.description import Angle, Day, Description, Length, Ratio, check, line_of
from flflab.errors import InputError
from flflab.optics.light import Spectrum
from flflab.units import Dimension, parse_quantity
from flflab.yaml_file import read_yaml

if TYPE_CHECKING:
    from flflab.optics.camera import Camera

Element = Literal["main_lens.z", "array.z", "sensor.z", "target.z"]
Turn = Literal["array.pitch", "array.yaw", "array.roll"]
Moved = Literal[Element, Turn]
Own = TypeVar("Own", bound=BaseModel)
OTHER_NAMES = ("camera", "iris", "target")  # of what stands on a bench beside axes


@dataclass(frozen=True)
class Coordinate:
    """What an axis counts in: lengths in mm, angles in rad, which people are shown in degrees.

    Args:
        dimension: of readings.
        rate: of speeds.
        unit: of readings inside and in records.
        shown: the unit people are shown.
        per_unit: how many shown units one unit inside is.
    """

    dimension: Dimension
    rate: Dimension
    unit: Literal["mm", "rad"]
    shown: Literal["mm", "deg"]
    per_unit: float

    def show(self, value: float, form: str = ".6f") -> str:
        """A reading for people: ``12.500000 mm``, ``1.500000 deg``."""
        return f"{value * self.per_unit:{form}} {self.shown}"

    def column(self, name: str) -> str:
        """The column of records in which the readings of an axis stand."""
        return f"{name}_{self.unit}"


LENGTH = Coordinate("length", "speed", "mm", "mm", 1.0)
ANGLE = Coordinate("angle", "angular speed", "rad", "deg", 180 / math.pi)


class DeviceDescription(BaseModel):
    """Any device: the driver's name, where the device is reached, and the serial number that it is
    to have there; further keys belong to its driver.
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    driver: str
    address: str = ""
    serial: Annotated[str, BeforeValidator(lambda given: str(given))] = ""


def coordinate_of(moves: Moved) -> Coordinate:
    """Whether what is moved is shifted or turned."""
    return ANGLE if moves in get_args(Turn) else LENGTH


def _quantity_of_the_axis(rate: bool) -> BeforeValidator:
    """Reads lengths of an axis that shifts, angles of one that turns; where ``moves`` is wrong only
    that is told.
    """

    def read(given: object, info: ValidationInfo) -> float:
        if "moves" not in info.data:
            return 1.0
        coordinate = coordinate_of(info.data["moves"])
        try:
            return parse_quantity(given, coordinate.rate if rate else coordinate.dimension)
        except InputError as error:
            raise ValueError(str(error)) from error

    return BeforeValidator(read)


Place = Annotated[float, _quantity_of_the_axis(rate=False)]
Rate = Annotated[float, _quantity_of_the_axis(rate=True)]


class FixedPlace(Description):
    """Where something stands that no axis shifts, world z, and its standard uncertainty."""

    at: Length
    uncertainty: Annotated[Length, Field(ge=0)]


class FixedTurn(Description):
    """How the array is turned where no axis turns it, and the standard uncertainty."""

    at: Annotated[Angle, Field(gt=-math.pi / 2, lt=math.pi / 2)]
    uncertainty: Annotated[Angle, Field(ge=0)]


class FixedDescription(Description):
    """What no axis moves, by the name that an axis's ``moves`` has for it."""

    main_lens_z: FixedPlace | None = Field(None, alias="main_lens.z")
    array_z: FixedPlace | None = Field(None, alias="array.z")
    sensor_z: FixedPlace | None = Field(None, alias="sensor.z")
    target_z: FixedPlace | None = Field(None, alias="target.z")
    array_pitch: FixedTurn | None = Field(None, alias="array.pitch")
    array_yaw: FixedTurn | None = Field(None, alias="array.yaw")
    array_roll: FixedTurn | None = Field(None, alias="array.roll")

    def stated(self) -> dict[Moved, FixedPlace | FixedTurn]:
        """Those that the file states."""
        names: tuple[Moved, ...] = (*get_args(Element), *get_args(Turn))
        places: dict[Moved, FixedPlace | FixedTurn | None] = {
            name: getattr(self, name.replace(".", "_")) for name in names
        }
        return {name: place for name, place in places.items() if place is not None}


class AxisDescription(DeviceDescription):
    """An axis: the place of what it moves = zero + sign * reading, in mm, or in rad for one that
    turns the array.

    ``array.pitch`` turns about the world's x axis, its positive sense takes the edge at +y away
    from the main lens; ``array.yaw`` turns about y and takes the edge at +x away, both where the
    main axis meets the array; ``array.roll`` turns from x towards y. Limits are readings of the
    axis. The standard uncertainty of the zero is a length or an angle, that of the scale a share of
    the reading.
    """

    moves: Moved
    sign: Literal[1, -1] = 1
    zero: Place = 0.0
    zero_uncertainty: Annotated[Place, Field(ge=0)] = 0.0
    scale_uncertainty: Annotated[Ratio, Field(ge=0)] = 0.0
    limits: tuple[Place, Place]
    speed: Annotated[Rate, Field(gt=0)]
    home_towards: Literal["-z", "+z", "-pitch", "+pitch", "-yaw", "+yaw", "-roll", "+roll"]
    vertical: bool = False

    @model_validator(mode="after")
    def _limits_rise(self) -> "AxisDescription":
        if not self.limits[0] < self.limits[1]:
            low, high = (self.coordinate.show(limit, "g") for limit in self.limits)
            raise ValueError(f"limits are {low} to {high}; the first must be below the second")
        if self.home_towards[1:] != self.moves.partition(".")[2]:
            coordinate = self.moves.partition(".")[2]
            raise ValueError(
                f"home_towards is {self.home_towards}, but this axis moves {self.moves}; give"
                f" -{coordinate} or +{coordinate}"
            )
        return self

    @property
    def coordinate(self) -> Coordinate:
        """Whether it counts in lengths or in angles."""
        return coordinate_of(self.moves)

    @property
    def homes_up(self) -> bool:
        """Whether it looks for its reference towards higher readings."""
        return (self.home_towards[0] == "+") == (self.sign == 1)

    @property
    def cut_its_power(self) -> str:
        """What an operator does with an axis that did not stop."""
        if self.vertical is True:  # a file whose axis is wrong elsewhere is stopped too
            return (
                "it may still move; hold up what it carries, then cut its power: without current"
                " it falls"
            )
        return "it may still move, cut its power"

    def world(self, reading: float) -> float:
        """Place in the world, mm or rad, of a reading."""
        return self.zero + self.sign * reading

    def reading(self, world: float) -> float:
        """Reading that puts what it moves at a place in the world, mm or rad."""
        return self.sign * (world - self.zero)

    def uncertainty(self, reading: float) -> float:
        """Standard uncertainty of the place in the world at a reading, mm or rad."""
        return math.hypot(self.zero_uncertainty, self.scale_uncertainty * reading)


def _axis_name(given: str) -> str:
    """A name that can stand in every record, on a command line, and for nothing else."""
    if found := re.search(r"[./]|^\s|\s$|^$|^-", given):
        what = f"{found[0]!r} has no place in it" if found[0] else "it is empty"
        raise ValueError(f"{given!r} cannot be an axis's name: {what}; give words, digits, _ and -")
    if given in OTHER_NAMES or given.startswith("world_"):
        raise ValueError(f"{given!r} is the name of something else of the bench; give another")
    return given


AxisName = Annotated[str, AfterValidator(_axis_name)]


class BenchDescription(Description):
    """A bench file."""

    file_kind = "bench"

    axes: dict[AxisName, AxisDescription]
    camera: DeviceDescription
    iris: DeviceDescription
    target: DeviceDescription
    gaps: Annotated[MinimumGaps, BeforeValidator(of_array_and_sensor)] = Field(alias="minimum_gap")
    envelopes: EnvelopesDescription = EnvelopesDescription()
    fixed: FixedDescription = Field(default_factory=lambda: FixedDescription.model_validate({}))
    optics: str
    optics_uncertainty: OpticsUncertaintyDescription = OpticsUncertaintyDescription()
    model_uncertainty: ModelUncertaintyDescription = ModelUncertaintyDescription()
    workmanship: WorkmanshipDescription = WorkmanshipDescription()
    measurement_floor: MeasurementFloorDescription = MeasurementFloorDescription()
    target_uncertainty: TargetUncertaintyDescription = TargetUncertaintyDescription()
    repeatability: RepeatabilityDescription = RepeatabilityDescription()
    temperature: TemperatureDescription = TemperatureDescription()
    light: LightDescription | None = None
    light_uncertainty: Annotated[Ratio, Field(ge=0, lt=1)] = 0.005
    calibrated: Day | None = None
    simulated: SimulatedDescription = SimulatedDescription()

    @model_validator(mode="after")
    def _elements_are_moved_once(self) -> "BenchDescription":
        moved = [axis.moves for axis in self.axes.values()]
        apart = {self.axes[name].moves for name in self.simulated_beside_real()}
        for element in moved:
            if moved.count(element) > 1:
                raise ValueError(f"two axes move {element}; one axis moves one element")
            if element in self.fixed.stated() and element not in apart:
                raise ValueError(
                    f"fixed states where {element} stands, but an axis moves it; keep one of both"
                )
        array, sensor = self.axis_of("array.z"), self.axis_of("sensor.z")
        if array and sensor and array[1].home_towards == "+z" and sensor[1].home_towards == "-z":
            raise ValueError(
                f"axes {array[0]} and {sensor[0]} home towards each other; the array may home"
                " towards -z or the sensor towards +z only"
            )
        return self

    @property
    def spectrum(self) -> Spectrum | None:
        """The light's lines; None where light is rays."""
        return None if self.light is None else self.light.lines

    @property
    def mean_wavelength(self) -> float | None:
        """Of the light, mm; None where light is rays."""
        return None if self.light is None else self.light.lines.mean

    @property
    def minimum_gap(self) -> float:
        """The smallest gap allowed between array and sensor, mm."""
        return self.gaps.array_sensor

    def axis_of(self, element: Moved) -> tuple[str, AxisDescription] | None:
        """Name and description of the axis that moves an element or turns the array, or None where
        nothing does.
        """
        return next(
            ((name, axis) for name, axis in self.axes.items() if axis.moves == element), None
        )

    def simulated_beside_real(self) -> frozenset[str]:
        """The simulated axes where others are real; ``fixed`` may state where what they move is."""
        names = [name for name, axis in self.axes.items() if axis.address == "simulated"]
        return frozenset(names if len(names) < len(self.axes) else ())

    def turns_the_array(self) -> bool:
        """Whether an axis turns the array in any way."""
        return any(axis.moves in get_args(Turn) for axis in self.axes.values())


@dataclass(frozen=True)
class Bench:
    """A bench file as read, with the line of every field for later faults."""

    description: BenchDescription
    file: Path
    lines: Mapping[tuple[str | int, ...], int]
    optics: "Camera"

    def where(self, *path: str | int) -> str:
        """Where a field stands, as errors begin: file, line and field."""
        return f"{self.file}:{line_of(path, self.lines)}: {'.'.join(map(str, path))}"

    def own_keys(self, kind: type[Own], *path: str) -> Own:
        """The keys that belong to one device's driver, checked by the driver's model.

        Args:
            kind: the driver's pydantic model.
            path: where the device stands in the file, such as ``"axes", "array_stage"``.

        Raises:
            InputError: a key is missing, unknown or impossible, with file, line and field.
        """
        device: Any = self.description
        for part in path:
            device = device[part] if isinstance(device, dict) else getattr(device, part)
        return check(dict(device.model_extra or {}), kind, str(self.file), self.lines, path)


def read_bench(file: Path) -> Bench:
    """Read a bench file and the camera file it names (relative to the bench file).

    Raises:
        InputError: a field is missing, unknown, without a unit or impossible; the message names
            file, line and field.
    """
    file = Path(file)
    data, lines = read_yaml(file)
    description = check(data, BenchDescription, str(file), lines)
    optics = file.parent / description.optics
    if not optics.exists():
        raise InputError(
            f"{file}:{lines.get(('optics',), 1)}: optics: there is no camera file {optics}; give"
            " its path relative to the bench file"
        )
    from flflab.files.camera import read_camera  # numpy, which who only stops a stage does not need

    bench = Bench(description, file, lines, read_camera(optics))
    _require_one_attitude(bench)
    return bench


def _require_one_attitude(bench: Bench) -> None:
    """Refuse a fixed turn of the array that the camera file has otherwise: the model reads the
    camera file, the rule of the gap the bench file.

    Raises:
        InputError: with file, line and field.
    """
    array = bench.optics.array
    yaw, pitch = (math.atan(slope) for slope in array.tilt)
    described = {"array.yaw": yaw, "array.pitch": pitch, "array.roll": array.roll}
    for moved, place in bench.description.fixed.stated().items():
        if moved not in described or bench.description.axis_of(moved):  # simulated: the model's
            continue
        if abs(place.at - described[moved]) > 3 * place.uncertainty + 1e-9:
            raise InputError(
                f"{bench.where('fixed', moved, 'at')}: {ANGLE.show(place.at, 'g')}, but the camera"
                f" file has {ANGLE.show(described[moved], 'g')}; make both the same"
            )


def seeded(bench: Bench, seed: int | None) -> Bench:
    """As ``with_seed``, for a bench that is to be connected.

    Raises:
        InputError: a seed is given, and nothing of the bench is simulated by who connects to it:
            nobody would obey the seed.
    """
    description = bench.description
    devices = (*description.axes.values(), description.camera, description.iris, description.target)
    if seed is not None and not any(device.address == "simulated" for device in devices):
        raise InputError(
            f"{bench.file}: seed {seed} would have no effect, since no device there has"
            " the address simulated; give the seed where the bench is served"
            f" (`flflab sim BENCH --seed {seed}`)"
        )
    return with_seed(bench, seed)


def with_seed(bench: Bench, seed: int | None) -> Bench:
    """A bench whose simulated errors and noise have another seed than its file says; the same where
    none is given.
    """
    if seed is None:
        return bench
    simulated = bench.description.simulated.model_copy(update={"seed": seed})
    return replace(bench, description=bench.description.model_copy(update={"simulated": simulated}))


def fields_of(bench: Bench) -> dict[str, Any]:
    """What a bench's file says, with the seed that the bench has; raises as ``read_yaml``."""
    data, _ = read_yaml(bench.file)
    simulated, seed = data.get("simulated") or {}, bench.description.simulated.seed
    return (
        data
        if simulated.get("seed", 0) == seed
        else data | {"simulated": simulated | {"seed": seed}}
    )
