"""YAML descriptions: read with line numbers, checked by pydantic, refused with file, line, field
and what is allowed.
"""

import math
import re
from collections.abc import Iterator, Mapping
from datetime import date
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar, cast

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError

from flflab.errors import InputError
from flflab.printable import nearest, shortened
from flflab.units import Dimension, parse_quantity
from flflab.yaml_file import Path_, read_yaml

LEAST, MOST = (
    1e-15,
    1e12,
)  # mm, rad, s and whatever else is a number in a file, wide of anything that is built
PHYSICAL = (
    f"0 and {LEAST:g} to {MOST:g} are allowed, in mm, rad, s and 1/mm: see its unit and exponent"
)

NUMBERS = {  # in words, by pydantic's kinds of faults
    **dict.fromkeys(("float_parsing", "float_type"), "a number"),
    **dict.fromkeys(("int_parsing", "int_type", "int_from_float"), "a whole number"),
    **dict.fromkeys(("bool_parsing", "bool_type"), "true or false"),
}


def quantity(dimension: Dimension) -> BeforeValidator:
    """A pydantic validator that reads a quantity with its unit."""

    def read(given: object) -> float:
        try:
            return parse_quantity(given, dimension)
        except InputError as error:
            raise ValueError(str(error)) from error

    return BeforeValidator(read)


def written_as(pattern: str, words: str) -> AfterValidator:
    """A pydantic validator of a text; what a pattern allows is told in words."""

    def look(given: str) -> str:
        if re.fullmatch(pattern, given) is None:
            raise ValueError(f"{words}, not {given!r}")
        return given

    return AfterValidator(look)


def _day(given: str) -> str:
    """A day of the calendar, ``2026-11-29``."""
    try:
        return date.fromisoformat(given).isoformat()
    except ValueError as error:
        raise ValueError(f"{given!r} is no day; write it as 2026-11-29") from error


Day = Annotated[str, AfterValidator(_day)]
Length = Annotated[float, quantity("length")]
Angle = Annotated[float, quantity("angle")]
Time = Annotated[float, quantity("time")]
Frequency = Annotated[float, quantity("frequency")]
Speed = Annotated[float, quantity("speed")]
Ratio = Annotated[float, quantity("ratio")]


KINDS = {  # of files, by fields that no other kind has
    "camera": ("main_lens", "microlens_array"),
    "bench": ("axes", "optics"),
    "study": ("name", "configurations"),
    "scene": ("planes",),
    "requirements": ("measure", "parts"),
    "target": ("kind",),
}


class Description(BaseModel):
    """A frozen part of a description; a field it does not know is an error.

    ``file_kind`` is one of ``KINDS`` where the description is a whole file.
    """

    file_kind: ClassVar[str] = ""
    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)


Part = TypeVar("Part", bound=BaseModel)


def line_of(path: Path_, lines: Mapping[Path_, int]) -> int:
    """The line of a field, or of the nearest one around it that the file has."""
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path, 1)


def require_kind(data: object, due: str, file: str) -> None:
    """Refuse a file of another kind, in one sentence instead of one for each of its fields.

    Raises:
        InputError: its fields are those of another kind than is due.
    """
    fields = cast(dict[str, Any], data) if isinstance(data, dict) else {}
    looks = [kind for kind, own in KINDS.items() if all(field in fields for field in own)]
    if due and looks and due not in looks:
        raise InputError(f"{file} is a {looks[0]} file; a {due} file is expected here")


def check(
    data: object, kind: type[Part], file: str, lines: Mapping[Path_, int], under: Path_ = ()
) -> Part:
    """Check data against a description's model; every fault in one message, each with file, line
    and field.

    Raises:
        InputError: at least one field is missing, unknown, of the wrong kind or impossible, or the
            file is one of another kind.
    """
    if not under and issubclass(kind, Description):
        require_kind(data, kind.file_kind, file)
    try:
        found = kind.model_validate(data)
        wrong = [
            (path, "yes, no, true and false are no number; give a number")
            for path in _counted(data, found, under)
        ]
        wrong += [
            (_given(path, lines), f"{value:g} is no size that a thing has; {PHYSICAL}")
            for path, value in _unphysical(found, under)
        ]
        if wrong:
            raise InputError(
                "\n".join(
                    f"{file}:{line_of(path, lines)}: {'.'.join(map(str, path))}: {why}"
                    for path, why in wrong
                )
            )
        return found
    except ValidationError as error:
        faults: list[str] = []
        meant = _meant(error, kind)
        for fault in error.errors():
            if fault["type"] == "missing" and fault["loc"] in meant:
                continue  # it is there under another name, which is said
            place = tuple(part for part in fault["loc"] if part != "[key]")  # of a field's name
            path, given = _given((*under, *place), lines), shortened(fault["input"])
            message = fault["msg"].removeprefix("Value error, ")
            if (about := (*path, *message.partition(" ")[0].split("."))) in lines:
                path = about  # a rule between fields begins with the one to change
            field = ".".join(str(part) for part in path) or "(file)"
            if fault["type"] == "missing" and isinstance(fault["loc"][-1], int):
                message = f"fewer values than are due here: {given}"
            elif fault["type"] == "missing":
                message = "this field is missing"
            elif fault["type"] == "extra_forbidden":
                allowed = _fields_at(kind, fault["loc"][:-1])
                near = nearest(str(fault["loc"][-1]), allowed)
                message = (
                    f"there is no such field{f', did you mean {near}?' if near else ';'} allowed"
                    f" here: {', '.join(allowed)}"
                )
            elif fault["type"] in ("model_type", "model_attributes_type", "dict_type"):
                allowed = ", ".join(_fields_at(kind, fault["loc"]))
                message = f"fields are due here{f' ({allowed})' if allowed else ''}, not {given}"
            elif fault["type"] in ("tuple_type", "list_type"):
                message = f"values in brackets are due here, [..., ...], not {given}"
            elif fault["type"] == "too_long":
                message = f"more values than are allowed here: {given}"
            elif fault["type"] == "too_short" and not fault["input"]:
                message = "the list is empty; give at least one entry"
            elif fault["type"] in NUMBERS:
                message = f"{NUMBERS[fault['type']]} is due here, not {given}"
            elif fault["type"] != "value_error":
                message = f"{message[0].lower()}{message[1:]}, not {given}"
            faults.append(f"{file}:{line_of(path, lines)}: {field}: {message}")
        raise InputError("\n".join(dict.fromkeys(faults))) from error


def _meant(error: ValidationError, kind: type[BaseModel]) -> set[tuple[int | str, ...]]:
    """Fields that unknown ones were probably meant to be."""
    unknown = [one["loc"] for one in error.errors() if one["type"] == "extra_forbidden"]
    near = [(*loc[:-1], nearest(str(loc[-1]), _fields_at(kind, loc[:-1]))) for loc in unknown]
    return {(*place, name) for *place, name in near if name}


def _given(path: Path_, lines: Mapping[Path_, int]) -> Path_:
    """The path of what the file has: of one number given for a pair that of the pair."""
    while path and isinstance(path[-1], int) and path not in lines:
        path = path[:-1]
    return path


def _counted(given: Any, found: Any, path: Path_) -> Iterator[Path_]:
    """Where what was given as true or false was read as a number."""
    if isinstance(given, bool):
        if not isinstance(found, bool):
            yield path
    elif isinstance(given, dict):
        for name, value in cast(dict[str, Any], given).items():
            read = (
                cast(dict[str, Any], found).get(name)
                if isinstance(found, dict)
                else getattr(found, name, value)
            )
            yield from _counted(value, read, (*path, name))
    elif isinstance(given, list):
        for place, (value, read) in enumerate(zip(cast(list[Any], given), found, strict=True)):
            yield from _counted(value, read, (*path, place))


def _unphysical(found: Any, path: Path_) -> Iterator[tuple[Path_, float]]:
    """Numbers, in the units used inside, that would overflow or vanish in what is computed of
    them.
    """
    if isinstance(found, float):
        if 0 < abs(found) < LEAST or MOST < abs(found) < math.inf:
            yield path, found
    elif isinstance(found, (BaseModel, dict)):
        for name, value in cast(
            Iterator[tuple[str, Any]],
            iter(found) if isinstance(found, BaseModel) else found.items(),
        ):
            yield from _unphysical(value, (*path, name))
    elif isinstance(found, (list, tuple)):
        for place, value in enumerate(cast(list[Any], found)):
            yield from _unphysical(value, (*path, place))


def _fields_at(kind: type[BaseModel], path: Path_) -> list[str]:
    """The fields allowed at a place of a model, through nested models, optionals and unions."""
    current: Any = kind
    for part in path:
        if (
            isinstance(part, str)
            and hasattr(current, "model_fields")
            and part in current.model_fields
        ):
            current = _model_in(current.model_fields[part].annotation)
    fields = current.model_fields if hasattr(current, "model_fields") else {}
    return [field.alias or name for name, field in fields.items()]


def _model_in(annotation: Any) -> Any:
    if hasattr(annotation, "model_fields"):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _model_in(inner)
        if found is not None:
            return found
    return None


def load(file: Path, kind: type[Part]) -> Part:
    """Read a YAML file into a frozen description; see ``read_yaml`` and ``check`` for the
    errors.
    """
    data, lines = read_yaml(file)
    return check(data, kind, str(file), lines)
