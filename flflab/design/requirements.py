"""What a user wants of a camera, in the user's terms: the requirements file, YAML in and a frozen
description out.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, PositiveInt, model_validator

from flflab.bench import read_bench
from flflab.description import Angle, Description, Frequency, Length, Ratio, check
from flflab.errors import InputError
from flflab.yaml_file import read_yaml

PositiveLength = Annotated[Length, Field(gt=0)]
Objective = Literal["area", "elr", "contrast", "light"]
OBJECTIVES: tuple[Objective, ...] = ("area", "elr", "contrast", "light")


def _as_list(given: object) -> object:
    return given if isinstance(given, list) else [given]


class MeasureDescription(Description):
    """What is to be measured: a range of distances from the main lens, and how wide the scene is in
    all of it.
    """

    depth: tuple[PositiveLength, PositiveLength]
    width: PositiveLength | None = None

    @model_validator(mode="after")
    def _near_comes_first(self) -> "MeasureDescription":
        near, far = self.depth
        if near >= far:
            raise ValueError(
                f"depth runs from {near:g} mm to {far:g} mm; the nearer end comes first, the"
                " farther one lies beyond it"
            )
        return self


class ContrastDescription(Description):
    """Least contrast of a sine of this frequency on the target."""

    at: Annotated[Frequency, Field(gt=0)]
    least: Annotated[Ratio, Field(gt=0, lt=1)]


class RequireDescription(Description):
    """What must hold in all of the depth; what is left out is not asked for."""

    views: PositiveInt = 2
    blur_px: Annotated[float, Field(gt=0)] = 1.0
    resolution: PositiveLength | None = None
    contrast: ContrastDescription | None = None
    marginal_angle: Annotated[Angle, Field(gt=0)] | None = None
    free_working_distance: PositiveLength | None = None


class LensPart(Description):
    """A main lens that exists, and the f-numbers it is used at."""

    name: str
    focal_length: PositiveLength
    f_number: Annotated[
        list[Annotated[float, Field(gt=0)]], BeforeValidator(_as_list), Field(min_length=1)
    ]


class ArrayPart(Description):
    """A square microlens array that exists."""

    name: str
    count: tuple[PositiveInt, PositiveInt]
    pitch: PositiveLength
    aperture: PositiveLength
    focal_length: PositiveLength

    @model_validator(mode="after")
    def _fits(self) -> "ArrayPart":
        if self.aperture > self.pitch:
            raise ValueError(
                f"aperture is {self.aperture:g} mm, wider than the pitch of {self.pitch:g} mm; the"
                " pitch at most is allowed"
            )
        return self


class SensorPart(Description):
    """A sensor that exists."""

    name: str
    resolution: tuple[PositiveInt, PositiveInt]
    pixel: PositiveLength


class PartsDescription(Description):
    """The parts to choose from."""

    main_lenses: Annotated[list[LensPart], Field(min_length=1)]
    arrays: Annotated[list[ArrayPart], Field(min_length=1)]
    sensors: Annotated[list[SensorPart], Field(min_length=1)]


class TravelDescription(Description):
    """Where the array can stand behind the main lens, and how far the sensor behind the array; a
    bench file may say both.
    """

    array: tuple[PositiveLength, PositiveLength] | None = None
    gap: tuple[PositiveLength, PositiveLength] | None = None
    bench: Path | None = None

    @model_validator(mode="after")
    def _has_room(self) -> "TravelDescription":
        if self.bench is None and (self.array is None or self.gap is None):
            raise ValueError(
                "give the ranges array and gap, or a bench file that has stages for array and"
                " sensor"
            )
        for name, span in (("array", self.array), ("gap", self.gap)):
            if span is not None and span[0] >= span[1]:
                raise ValueError(
                    f"{name} runs from {span[0]:g} mm to {span[1]:g} mm; the smaller comes first"
                )
        return self


class TolerancesDescription(Description):
    """How far each dimension may be off what is asked for, either way, every value in between being
    as likely; relative for the lenses.
    """

    gap: Annotated[Length, Field(ge=0)] = 0.0
    tilt: Annotated[Angle, Field(ge=0)] = 0.0
    array_distance: Annotated[Length, Field(ge=0)] = 0.0
    focal_length: Annotated[Ratio, Field(ge=0, lt=1)] = 0.0
    aperture: Annotated[Ratio, Field(ge=0, lt=1)] = 0.0
    pitch: Annotated[Ratio, Field(ge=0, lt=1)] = 0.0
    main_lens_focal_length: Annotated[Ratio, Field(ge=0, lt=1)] = 0.0
    f_number: Annotated[Ratio, Field(ge=0, lt=1)] = 0.0


class SearchDescription(Description):
    """How many configurations are tried, at how many focus distances, and how fine the front is."""

    configurations: Annotated[int, Field(ge=1, le=10**10)] = 1_000_000
    focus_steps: Annotated[int, Field(ge=1, le=1000)] = 25
    epsilon: Annotated[Ratio, Field(ge=0, lt=1)] = 0.01
    farthest: PositiveLength = 2000.0


class Requirements(Description):
    """A requirements file."""

    file_kind = "requirements"

    measure: MeasureDescription
    require: RequireDescription = RequireDescription()
    parts: PartsDescription
    travel: TravelDescription
    maximise: Annotated[list[Objective], Field(min_length=1)] = list(OBJECTIVES)
    search: SearchDescription = SearchDescription()
    tolerances: TolerancesDescription = TolerancesDescription()
    minimum_illumination: Annotated[Ratio, Field(ge=0, le=1)] = 0.5

    @model_validator(mode="after")
    def _does_not_contradict_itself(self) -> "Requirements":
        near, far = self.measure.depth
        free = self.require.free_working_distance
        if free is not None and free > near:
            raise ValueError(
                f"require.free_working_distance is {free:g} mm but measure.depth begins {near:g} mm"
                f" before the main lens; begin the depth at {free:g} mm or farther, or ask for less"
                " room"
            )
        if far > self.search.farthest:
            raise ValueError(
                f"measure.depth ends at {far:g} mm, beyond search.farthest,"
                f" {self.search.farthest:g} mm; raise the latter"
            )
        if len(set(self.maximise)) < len(self.maximise):
            raise ValueError("maximise names an objective twice; keep one of each")
        if "contrast" in self.maximise and self.require.contrast is None:
            raise ValueError(
                "maximise names contrast, but require.contrast, which says at what frequency, is"
                " missing"
            )
        return self


def read_requirements(file: Path) -> Requirements:
    """Read a requirements file; ranges of travel that a bench file gives are filled in.

    Raises:
        InputError: a field is missing, unknown, without a unit, impossible or contradicts another;
            file, line and field are named.
    """
    data, lines = read_yaml(file)
    found = check(data, Requirements, str(file), lines)
    if found.travel.bench is None:
        return found
    travel = _bench_travel(
        Path(file).parent / found.travel.bench,
        found.travel,
        f"{file}:{lines.get(('travel', 'bench'), 1)}",
    )
    return found.model_copy(update={"travel": travel})


def _bench_travel(bench_file: Path, given: TravelDescription, place: str) -> TravelDescription:
    """The ranges a bench's stages allow, narrowed by those given; z counts from the main lens."""
    bench = read_bench(bench_file)
    spans: dict[str, tuple[float, float]] = {}
    for axis in bench.description.axes.values():
        ends = [axis.zero + axis.sign * limit for limit in axis.limits]
        spans[axis.moves] = (min(ends), max(ends))
    if "array.z" not in spans or "sensor.z" not in spans:
        raise InputError(
            f"{place}: travel.bench: {bench_file} has no stages that move array.z and sensor.z;"
            " give travel.array and travel.gap"
        )
    array, sensor = spans["array.z"], spans["sensor.z"]
    gap = (
        bench.description.minimum_gap,
        max(sensor[1] - array[0], bench.description.minimum_gap * 2),
    )
    return given.model_copy(
        update={
            "array": _both(array, given.array, place, "array"),
            "gap": _both(gap, given.gap, place, "gap"),
        }
    )


def _both(
    stage: tuple[float, float], asked: tuple[float, float] | None, place: str, name: str
) -> tuple[float, float]:
    """What two ranges share, mm."""
    low, high = (max(stage[0], asked[0]), min(stage[1], asked[1])) if asked else stage
    low = max(low, 1e-3)
    if low >= high:
        raise InputError(
            f"{place}: travel.{name}: the stages reach {stage[0]:g} to {stage[1]:g} mm, none of"
            " which the requirements allow; widen the range"
        )
    return low, high
