"""The bench file: what stands on the bench, where it is reached, how far it may go, and how well its zeros are known."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, model_validator

from flflab.camera_file import read_camera
from flflab.description import Description, Length, Ratio, Speed, check, read_yaml
from flflab.errors import InputError
from flflab.optics.camera import Camera

Element = Literal["main_lens.z", "array.z", "sensor.z", "target.z"]
Own = TypeVar("Own", bound=BaseModel)


class DeviceDescription(BaseModel):
    """Any device: the driver's name and where the device is reached; further keys belong to its driver."""

    model_config = ConfigDict(extra="allow", frozen=True)

    driver: str
    address: str = ""


class AxisDescription(DeviceDescription):
    """A linear axis: world z of its element = zero + sign * reading, in mm.

    Limits are readings of the axis. The standard uncertainty of the zero is a length, that of the scale a share of the reading.
    """

    moves: Element
    sign: Literal[1, -1] = 1
    zero: Length = 0.0
    zero_uncertainty: Annotated[Length, Field(ge=0)] = 0.0
    scale_uncertainty: Annotated[Ratio, Field(ge=0)] = 0.0
    limits: tuple[Length, Length]
    speed: Annotated[Speed, Field(gt=0)]
    home_towards: Literal["-z", "+z"]

    @model_validator(mode="after")
    def _limits_rise(self) -> "AxisDescription":
        if not self.limits[0] < self.limits[1]:
            raise ValueError(f"limits are {self.limits[0]:g} mm to {self.limits[1]:g} mm; the first must be below the second")
        return self

    def world(self, reading: float) -> float:
        """World z in mm of a reading in mm."""
        return self.zero + self.sign * reading

    def reading(self, world: float) -> float:
        """Reading in mm that puts the element at a world z in mm."""
        return self.sign * (world - self.zero)

    def uncertainty(self, reading: float) -> float:
        """Standard uncertainty in mm of the world position at a reading in mm."""
        return math.hypot(self.zero_uncertainty, self.scale_uncertainty * reading)


class FaultDescription(Description):
    """A fault that the simulated bench shows on purpose: on which device, which one, after how many commands."""

    device: str
    fault: str
    after: Annotated[int, Field(ge=0)] = 0


class SimulatedDescription(Description):
    """What only a simulated bench reads: seed, clock rate, planted truths and faults, its targets by kind, its light and sensor."""

    seed: Annotated[int, Field(ge=0)] = 0
    clock: Annotated[float, Field(gt=0)] = 1.0
    truths: dict[str, str | float] = {}
    faults: list[FaultDescription] = []
    targets: dict[str, dict[str, Any]] = {}
    electrons_per_second: Annotated[float, Field(gt=0)] = 1e6
    full_well_electrons: Annotated[float, Field(gt=0)] = 12000.0
    read_noise_electrons: Annotated[float, Field(ge=0)] = 3.0
    bits: Annotated[int, Field(ge=8, le=16)] = 12
    black_level: Annotated[float, Field(ge=0)] = 64.0


class BenchDescription(Description):
    """A bench file."""

    axes: dict[str, AxisDescription]
    camera: DeviceDescription
    iris: DeviceDescription
    target: DeviceDescription
    minimum_gap: Annotated[Length, Field(gt=0)]
    optics: str
    simulated: SimulatedDescription = SimulatedDescription()

    @model_validator(mode="after")
    def _elements_are_moved_once(self) -> "BenchDescription":
        moved = [axis.moves for axis in self.axes.values()]
        for element in moved:
            if moved.count(element) > 1:
                raise ValueError(f"two axes move {element}; one axis moves one element")
        array, sensor = self.axis_of("array.z"), self.axis_of("sensor.z")
        if array and sensor and array[1].home_towards == "+z" and sensor[1].home_towards == "-z":
            raise ValueError(
                f"axes {array[0]} and {sensor[0]} home towards each other; the array may home towards -z or the sensor towards +z only"
            )
        return self

    def axis_of(self, element: Element) -> tuple[str, AxisDescription] | None:
        """Name and description of the axis that moves an element, or None where nothing moves it."""
        return next(((name, axis) for name, axis in self.axes.items() if axis.moves == element), None)


@dataclass(frozen=True)
class Bench:
    """A bench file as read, with the line of every field for later faults."""

    description: BenchDescription
    file: Path
    lines: Mapping[tuple[str | int, ...], int]
    optics: Camera

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
        InputError: a field is missing, unknown, without a unit or impossible; the message names file, line and field.
    """
    file = Path(file)
    data, lines = read_yaml(file)
    description = check(data, BenchDescription, str(file), lines)
    optics = file.parent / description.optics
    if not optics.exists():
        raise InputError(
            f"{file}:{lines.get(('optics',), 1)}: optics: there is no camera file {optics}; give its path relative to the bench file"
        )
    return Bench(description, file, lines, read_camera(optics))
