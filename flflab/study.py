"""The study file: which configurations to set, which targets to show, how to expose, and against
what to compare.
"""

import itertools
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, Field, model_validator

from flflab.description import Angle, Description, Length, Ratio, check, written_as
from flflab.errors import InputError
from flflab.files.target import target_from
from flflab.optics.camera import Camera
from flflab.optics.focus import vergence_of
from flflab.property_names import PROPERTY_NAMES
from flflab.targets import Bars, BarsAlongY, FourDot, Texture
from flflab.yaml_file import Lines, read_yaml


def _as_list(given: object) -> object:
    return given if isinstance(given, list) else [given]


Kind = TypeVar("Kind", FourDot, Bars, Texture)
MOST_CONFIGURATIONS = 100_000
Places = Annotated[list[Length], BeforeValidator(_as_list), Field(min_length=1)]
Lengths = Annotated[
    list[Annotated[Length, Field(gt=0)]], BeforeValidator(_as_list), Field(min_length=1)
]
Angles = Annotated[list[Angle], BeforeValidator(_as_list), Field(min_length=1)]
Numbers = Annotated[
    list[Annotated[float, Field(gt=0, strict=True)]], BeforeValidator(_as_list), Field(min_length=1)
]


class ConfigurationsDescription(Description):
    """A grid of configurations: every combination of what is listed; the sensor refocused unless
    told otherwise.

    Target, array and sensor are placed by their distances from where the main lens stands at 0;
    ``main_lens`` moves the lens alone along the axis, away from the target. ``pitch``, ``yaw`` and
    ``roll`` turn the array; a bench without a stage for it must have it turned so in its camera
    file.
    """

    f_number: Numbers
    distance: Lengths
    focused_at: Lengths | None = None
    main_lens: Places | None = None
    array: Lengths | None = None
    sensor: Lengths | None = None
    pitch: Angles | None = None
    yaw: Angles | None = None
    roll: Angles | None = None

    @model_validator(mode="after")
    def _one_way_to_place_the_sensor(self) -> "ConfigurationsDescription":
        if self.focused_at is not None and self.sensor is not None:
            raise ValueError(
                "give focused_at (the distance the sensor is focused for) or sensor (its position),"
                " not both"
            )
        return self


class ExposureDescription(Description):
    """Exposure rule: the brightest view at this share of full scale; so many frames a point, where
    an accuracy is asked for up to most.
    """

    level: Annotated[Ratio, Field(gt=0, lt=1)] = 0.7
    frames: Annotated[int, Field(ge=1, le=64)] = 1
    most_frames: Annotated[int, Field(ge=1, le=1024)] = 64

    @model_validator(mode="after")
    def _frames_within_most(self) -> "ExposureDescription":
        if self.frames > self.most_frames:
            raise ValueError(
                f"frames is {self.frames}, above most_frames, {self.most_frames}; raise most_frames"
            )
        return self


class StudyDescription(Description):
    """A study file."""

    file_kind = "study"

    name: Annotated[
        str,
        written_as(
            r"[A-Za-z0-9][A-Za-z0-9_-]*",
            "a name of letters, digits, - and _ is due, for it names folders",
        ),
    ]
    configurations: Annotated[list[ConfigurationsDescription], Field(min_length=1)]
    reference: Annotated[int, Field(ge=0)] = 0
    dots: dict[str, Any] = {"kind": "four-dot"}
    bars: dict[str, Any] = {"kind": "bars"}
    texture: dict[str, Any] = {"kind": "texture"}
    targets: Annotated[list[Literal["dots", "bars", "bars-y", "texture"]], Field(min_length=1)] = [
        "dots",
        "bars",
    ]
    exposure: ExposureDescription = ExposureDescription()
    mtf_standard_uncertainty: Annotated[Ratio, Field(gt=0, lt=1)] | None = None
    repeats: Annotated[int, Field(ge=1, le=100)] = 1
    reapproach: bool = False
    draws: Annotated[int, Field(ge=100, le=100000)] = 1000
    significance: Annotated[Ratio, Field(ge=1e-4, lt=0.5)] = 0.05

    @model_validator(mode="after")
    def _draws_tell_the_significance(self) -> "StudyDescription":
        # Half the draws are the distribution that a p-value is a share of, and every property has
        # its part of the significance.
        judged = len(PROPERTY_NAMES) - ("texture" not in self.targets)  # depth maps are of those
        least = 2 * math.ceil(judged / self.significance)
        if self.draws < least:
            raise ValueError(
                f"draws is {self.draws}, but {judged} properties share the"
                f" significance of {self.significance:g}; at least {least} draws resolve"
                " that, 1000 are usual"
            )
        return self


@dataclass(frozen=True)
class Configuration:
    """One setting of the bench.

    Attributes:
        index: its number in the study.
        f_number: of the iris.
        distance: main lens to target, mm; the lengths that follow are in mm too.
        array: main lens to array.
        sensor: main lens to sensor.
        main_lens: where the main lens stands on the bench's axis.
        pitch: angle of the array in rad, as the other two; None as in the camera file.
        yaw: the same.
        roll: the same.
        repetition: how often the setting was taken before.
    """

    index: int
    f_number: float
    distance: float
    array: float
    sensor: float
    main_lens: float = 0.0
    pitch: float | None = None
    yaw: float | None = None
    roll: float | None = None
    repetition: int = 0

    @property
    def besides(self) -> str:
        """What is set beside f-number and distances, in words; empty where nothing is."""
        turned = {"pitch": self.pitch, "yaw": self.yaw, "roll": self.roll}
        lens = [f"main lens at {self.main_lens:g} mm"] if self.main_lens else []
        return ", ".join(
            [
                *lens,
                *(
                    f"{name} {math.degrees(angle):g} deg"
                    for name, angle in turned.items()
                    if angle is not None
                ),
            ]
        )

    def camera(self, optics: Camera) -> Camera:
        """The bench's camera in this configuration."""
        array = optics.array
        tilt = (
            array.tilt[0] if self.yaw is None else math.tan(self.yaw),
            array.tilt[1] if self.pitch is None else math.tan(self.pitch),
        )
        return replace(
            optics,
            main_lens=replace(optics.main_lens, f_number=self.f_number),
            array=replace(
                array,
                distance=self.array,
                tilt=tilt,
                roll=array.roll if self.roll is None else self.roll,
            ),
            sensor=replace(optics.sensor, distance=self.sensor),
        )


@dataclass(frozen=True)
class Study:
    """A study ready to be planned: its description, configurations and targets; ``texture`` is None
    where none is shown.
    """

    description: StudyDescription
    configurations: tuple[Configuration, ...]
    dots: FourDot
    bars: Bars
    texture: Texture | None = None

    @property
    def settings(self) -> int:
        """How many settings there are, each taken as often as the study repeats."""
        return len(self.configurations) // self.description.repeats

    @property
    def bars_y(self) -> BarsAlongY:
        """The chart of bars, turned by a quarter turn."""
        return BarsAlongY(self.bars.cycles_per_mm, self.bars.width, self.bars.height)

    @property
    def targets(self) -> tuple[FourDot | Bars | Texture, ...]:
        """The targets that are shown after the white one."""
        known = {
            "dots": self.dots,
            "bars": self.bars,
            "bars-y": self.bars_y,
            "texture": self.texture,
        }
        found = (known[name] for name in self.description.targets)
        return tuple(one for one in found if one is not None)

    @property
    def shown(self) -> tuple[str, ...]:
        """Their kinds."""
        return tuple(one.kind for one in self.targets)


def focused_sensor(optics: Camera, array: float, distance: float) -> float:
    """Where the sensor must stand, mm behind the main lens, to see a target sharply through the
    microlenses.

    b = x / ((1 - x)/L + x/f) with x = L (V - 1/F + 1/L): the focus condition kappa x = b/L solved
    for the gap.

    Raises:
        InputError: no real sensor position behind the array focuses on that distance.
    """
    length = array + optics.optical_distance - optics.array.distance
    x = length * (vergence_of(distance) - 1 / optics.main_lens.focal_length + 1 / length)
    focal = optics.array.focal_lengths[0]
    gap = (x / ((1 - x) / length + x / focal) if x != 0 else 0.0) - (
        optics.optical_gap - optics.gap
    )
    if not gap > 0:
        raise InputError(
            f"no sensor position behind an array at {array:g} mm sees a target at {distance:g} mm"
            " sharply; move the array or the target"
        )
    return array + gap


def count(description: StudyDescription) -> int:
    """How many configurations the grids of a study have, without making them."""
    listed = (
        (
            g.f_number,
            g.distance,
            g.main_lens,
            g.array,
            g.sensor or g.focused_at,
            g.pitch,
            g.yaw,
            g.roll,
        )
        for g in description.configurations
    )
    settings = sum(math.prod(len(values) for values in grid if values) for grid in listed)
    return settings * description.repeats


def expand(description: StudyDescription, optics: Camera) -> tuple[Configuration, ...]:
    """All configurations of a study in the order of the file, numbered from 0; of a grid the last
    thing listed changes fastest.
    """
    found: list[Configuration] = []
    for grid in description.configurations:
        turns = list(
            itertools.product(*(angles or [None] for angles in (grid.pitch, grid.yaw, grid.roll)))
        )
        places = itertools.product(
            grid.f_number,
            grid.distance,
            grid.main_lens or [0.0],
            grid.array or [optics.array.distance],
            turns,
        )
        for f_number, distance, lens, array, turned in places:
            sensors = (
                [place - lens for place in grid.sensor]
                if grid.sensor
                else [
                    focused_sensor(optics, array - lens, lens + target)
                    for target in grid.focused_at or [distance]
                ]
            )
            found += [
                Configuration(
                    len(found) + k,
                    f_number,
                    lens + distance,
                    array - lens,
                    sensor,
                    lens,
                    pitch=turned[0],
                    yaw=turned[1],
                    roll=turned[2],
                )
                for k, sensor in enumerate(sensors)
            ]
    return tuple(found)


def repeated(settings: tuple[Configuration, ...], repeats: int) -> tuple[Configuration, ...]:
    """Every setting once, then all of them again, numbered on."""
    return tuple(
        replace(one, index=one.index + time * len(settings), repetition=time)
        for time in range(repeats)
        for one in settings
    )


def read_study(file: Path, optics: Camera) -> Study:
    """Read a study file for a bench's camera.

    Raises:
        InputError: a field is missing, unknown, without a unit or impossible; the message names
            file, line and field.
    """
    data, lines = read_yaml(Path(file))
    description = check(data, StudyDescription, str(file), lines)
    if (many := count(description)) > MOST_CONFIGURATIONS:
        raise InputError(
            f"{file}:{lines.get(('configurations',), 1)}: configurations: every value with every"
            f" other makes {many} configurations; at most {MOST_CONFIGURATIONS} are allowed, list"
            " fewer values or give the settings one by one"
        )
    try:
        configurations = expand(description, optics)
        for configuration in configurations:
            configuration.camera(optics)
    except InputError as error:
        raise InputError(
            f"{file}:{lines.get(('configurations',), 1)}: configurations: {error}"
        ) from error
    if description.reference >= len(configurations):
        raise InputError(
            f"{file}:{lines.get(('reference',), 1)}: reference: {description.reference} is no"
            f" configuration; allowed: 0 to {len(configurations) - 1}"
        )
    configurations = repeated(configurations, description.repeats)
    dots = _target(description.dots, FourDot, Path(file), lines, "dots")
    bars = _target(description.bars, Bars, Path(file), lines, "bars")
    texture = None
    if "texture" in description.targets:
        texture = _target(description.texture, Texture, Path(file), lines, "texture")
    return Study(description, configurations, dots, bars, texture)


def _target(data: dict[str, Any], kind: type[Kind], file: Path, lines: Lines, field: str) -> Kind:
    target = target_from(data, str(file), file.parent, lines, (field,))
    if not isinstance(target, kind) or target.kind != kind.kind:
        raise InputError(
            f"{file}:{lines.get((field,), 1)}: {field}: a {target.kind} target; allowed here:"
            f" {kind.kind}"
        )
    return target
