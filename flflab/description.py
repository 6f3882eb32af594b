"""YAML descriptions: read with line numbers, checked by pydantic, refused with file, line, field
and what is allowed.
"""

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import yaml
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError

from flflab.errors import InputError
from flflab.units import Dimension, parse_quantity

Path_ = tuple[str | int, ...]
Lines = dict[Path_, int]

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


Length = Annotated[float, quantity("length")]
Angle = Annotated[float, quantity("angle")]
Time = Annotated[float, quantity("time")]
Frequency = Annotated[float, quantity("frequency")]
Speed = Annotated[float, quantity("speed")]
Ratio = Annotated[float, quantity("ratio")]


class Description(BaseModel):
    """A frozen part of a description; a field it does not know is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)


Part = TypeVar("Part", bound=BaseModel)


class _UniqueKeyLoader(yaml.SafeLoader):
    """A safe loader; numbers such as 1e-5 are numbers, a key given twice is an error."""


_UniqueKeyLoader.add_implicit_resolver(  # pyright: ignore[reportUnknownMemberType]
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+0123456789."),
)


def _collect_lines(node: yaml.Node, path: Path_, lines: Lines, file: str) -> None:
    lines[path] = node.start_mark.line + 1
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            name = str(key.value)
            if name in seen:
                raise InputError(
                    f"{file}:{key.start_mark.line + 1}: the field '{name}' is given twice; keep one"
                )
            seen.add(name)
            _collect_lines(value, (*path, name), lines, file)
            lines[(*path, name)] = key.start_mark.line + 1
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            _collect_lines(value, (*path, index), lines, file)


def read_yaml(file: Path) -> tuple[dict[str, Any], Lines]:
    """Read a YAML mapping and the line each field stands on.

    Raises:
        InputError: the file is missing, unreadable, not in UTF-8, not YAML, or not a mapping of
            fields.
    """
    try:
        text = Path(file).read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"{file}: cannot be read ({error.strerror or error}); give the path of a YAML file"
        ) from error
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputError(f"{file}:{line}: not text in UTF-8; save the file as UTF-8") from error
    try:
        node = yaml.compose(text, Loader=_UniqueKeyLoader)
        # the loader is a SafeLoader
        data: Any = yaml.load(text, Loader=_UniqueKeyLoader)  # noqa: S506
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark else 1
        raise InputError(f"{file}:{line}: not YAML: {getattr(error, 'problem', error)}") from error
    lines: Lines = {}
    if node is not None:
        _collect_lines(node, (), lines, str(file))
    if data is None:
        raise InputError(
            f"{file}:1: the file is empty; fields are due, `flflab new` writes a file to begin from"
        )
    if not isinstance(data, dict):
        raise InputError(f"{file}:1: a mapping of fields is due here, not {type(data).__name__}")
    return cast(dict[str, Any], data), lines


def line_of(path: Path_, lines: Mapping[Path_, int]) -> int:
    """The line of a field, or of the nearest one around it that the file has."""
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path, 1)


def check(
    data: object, kind: type[Part], file: str, lines: Mapping[Path_, int], under: Path_ = ()
) -> Part:
    """Check data against a description's model; every fault in one message, each with file, line
    and field.

    Raises:
        InputError: at least one field is missing, unknown, of the wrong kind or impossible.
    """
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
        for fault in error.errors():
            path = _given((*under, *fault["loc"]), lines)
            message = fault["msg"].removeprefix("Value error, ")
            if (about := (*path, *message.partition(" ")[0].split("."))) in lines:
                path = about  # a rule between fields begins with the one to change
            field = ".".join(str(part) for part in path) or "(file)"
            if fault["type"] == "missing" and isinstance(fault["loc"][-1], int):
                message = f"fewer values than are due here: {fault['input']!r}"
            elif fault["type"] == "missing":
                message = "this field is missing"
            elif fault["type"] == "extra_forbidden":
                message = (
                    "there is no such field; allowed here:"
                    f" {', '.join(_fields_at(kind, fault['loc'][:-1]))}"
                )
            elif fault["type"] in ("model_type", "model_attributes_type", "dict_type"):
                allowed = ", ".join(_fields_at(kind, fault["loc"]))
                message = (
                    f"fields are due here{f' ({allowed})' if allowed else ''}, not"
                    f" {fault['input']!r}"
                )
            elif fault["type"] in ("tuple_type", "list_type"):
                message = f"values in brackets are due here, [..., ...], not {fault['input']!r}"
            elif fault["type"] == "too_long":
                message = f"more values than are allowed here: {fault['input']!r}"
            elif fault["type"] == "too_short" and not fault["input"]:
                message = "the list is empty; give at least one entry"
            elif fault["type"] in NUMBERS:
                message = f"{NUMBERS[fault['type']]} is due here, not {fault['input']!r}"
            elif fault["type"] != "value_error":
                message = f"{message[0].lower()}{message[1:]}, not {fault['input']!r}"
            faults.append(f"{file}:{line_of(path, lines)}: {field}: {message}")
        raise InputError("\n".join(dict.fromkeys(faults))) from error


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
