"""YAML files read within bounds: size, depth and count of values are checked before anything else
reads them, so that no file takes long, much memory, or ends the program.
"""

import io
import json
import os
import re
import select
import stat
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import yaml

from flflab.errors import InputError
from flflab.printable import shortened

Path_ = tuple[str | int, ...]
Lines = dict[Path_, int]

MOST_BYTES = 1 << 20  # the longest description here has some 10,000
MOST_NODES = 50_000  # aliases counted as what they stand for
MOST_DEPTH = 50
MOST_CHARACTERS = 1000  # of one value
PATIENCE_S = 5.0  # for a pipe; nothing else makes anybody wait
STRING = "tag:yaml.org,2002:str"


def read_yaml(file: Path) -> tuple[dict[str, Any], Lines]:
    """Read a YAML mapping and the line each field stands on.

    Raises:
        InputError: the file is missing, unreadable, not in UTF-8, not YAML, not a mapping of
            fields, or larger than any description.
    """
    return parse_yaml(_text_of(Path(file)), str(file))


def edit_yaml(text: str, file: str, change: Callable[[Any], None]) -> str:
    """The text of a YAML mapping after a change of its values; comments, order, quotes and
    indentation stay.

    Args:
        text: of the file.
        file: its name, for messages.
        change: sets and removes values of the mapping that it is given, in place.

    Raises:
        InputError: an anchor would change other values as well; or as ``read_yaml``.
    """
    from ruamel.yaml import YAML, YAMLError  # only who writes a file back waits for it
    from ruamel.yaml.util import load_yaml_guess_indent

    wanted = json.loads(json.dumps(parse_yaml(text, file)[0]))  # anchors share nothing any more
    change(wanted)
    both_ways: Any = YAML()
    both_ways.preserve_quotes = True
    both_ways.width = MOST_BYTES  # no line is folded
    written = io.StringIO()
    try:
        data, sequence, offset = load_yaml_guess_indent(text, yaml=both_ways)
        indented = re.search(r"(?m)^( +)[^ #\-]", text)
        both_ways.indent(
            mapping=len(indented[1]) if indented else None,
            sequence=sequence if offset is not None else None,
            offset=offset,
        )
        change(data)
        both_ways.dump(data, written)
        changed = parse_yaml(written.getvalue(), file)[0] == wanted
    except YAMLError:
        changed = False
    if not changed:
        raise InputError(
            f"{file}: cannot be changed without changing other values as well (an anchor?); change"
            " it by hand"
        )
    return written.getvalue()


def put(mapping: Any, key: str, value: Any) -> None:
    """Set a value of a mapping that ``edit_yaml`` gives; a new one comes first, since a comment
    behind the last one may be about what follows.
    """
    if key not in mapping and hasattr(mapping, "insert"):
        mapping.insert(0, key, value)
    else:
        mapping[key] = value


def parse_yaml(text: str, file: str) -> tuple[dict[str, Any], Lines]:
    """As ``read_yaml``, of a text; ``file`` is what messages call it."""
    loader: _Loader | None = None
    try:
        loader = _Loader(text)
        loader.name = file
        node = loader.get_single_node()
        lines: Lines = {}
        if node is None:
            raise InputError(
                f"{file}:1: the file is empty; fields are due, `flflab new` writes a file to begin"
                " from"
            )
        _Walk(str(file), lines).visit(node, ())
        data: Any = loader.construct_document(node)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise InputError(
            f"{file}:{line}: the character U+{cast(int, error.character):04X} has no place in"
            " a text; remove it"
        ) from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark else 1
        raise InputError(f"{file}:{line}: not YAML: {getattr(error, 'problem', error)}") from error
    finally:
        if loader is not None:
            loader.dispose()
    if data is None:
        raise InputError(
            f"{file}:1: the file is empty; fields are due, `flflab new` writes a file to begin from"
        )
    if not isinstance(data, dict):
        raise InputError(f"{file}:1: a mapping of fields is due here, not {type(data).__name__}")
    return cast(dict[str, Any], data), lines


def _text_of(file: Path) -> str:
    try:
        content = _bytes_of(file)
    except OSError as error:
        raise InputError(
            f"{file}: cannot be read ({error.strerror or error}); give the path of a YAML file"
        ) from error
    except ValueError as error:  # a path with NUL in it
        raise InputError(f"{str(file)!r}: no path of a file ({error})") from error
    if len(content) > MOST_BYTES:
        raise InputError(
            f"{file}: longer than {MOST_BYTES >> 20} MB, which no description is; give the path of"
            " a YAML file"
        )
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(f"{file}:{line}: not text in UTF-8; save the file as UTF-8") from error


def _bytes_of(file: Path) -> bytes:
    """What a file holds, a byte more than is allowed at most; a pipe is waited for a while."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
    descriptor = os.open(file, flags | getattr(os, "O_BINARY", 0))
    try:
        waits = sys.platform != "win32" and not stat.S_ISREG(os.fstat(descriptor).st_mode)
        ends = time.monotonic() + PATIENCE_S
        content = bytearray()
        while len(content) <= MOST_BYTES:
            if (
                waits
                and not select.select([descriptor], [], [], max(0.0, ends - time.monotonic()))[0]
            ):
                raise OSError(f"nothing comes out of it for {PATIENCE_S:g} s")
            more = os.read(descriptor, MOST_BYTES + 1 - len(content))
            if not more:
                break
            content += more
        return bytes(content)
    finally:
        os.close(descriptor)


class _Loader(yaml.SafeLoader):
    """A safe loader; numbers such as 1e-5 are numbers, dates and times are text, and what it cannot
    make of a value is said with its line.
    """

    depth = nodes = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """The next node, as long as there are neither too many nor too deep ones."""
        self.depth, self.nodes = self.depth + 1, self.nodes + 1
        line = self.peek_event().start_mark.line + 1  # pyright: ignore[reportUnknownMemberType]
        if self.depth > MOST_DEPTH:
            raise _too_deep(f"{self.name}:{line}")
        if self.nodes > MOST_NODES:
            raise _too_many(f"{self.name}:{line}")
        node: Any = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        """The value of a node."""
        try:
            return super().construct_object(node, deep)  # pyright: ignore[reportUnknownMemberType]
        except (ValueError, TypeError, AttributeError, LookupError, OverflowError) as error:
            raise InputError(
                f"{self.name}:{node.start_mark.line + 1}: {shortened(node.value)} cannot be read as"
                f" {node.tag.rpartition(':')[2]} ({error})"
            ) from error


_NUMBERS = {  # without YAML 1.1's base 60, which takes 1:30 for 90
    "int": r"[-+]?(0b[01_]+|0[0-7_]+|0|[1-9][0-9_]*|0x[0-9a-fA-F_]+)",
    "float": (
        r"[-+]?(\d[\d_]*\.[\d_]*|\.\d[\d_]*)([eE][-+]?\d+)?|[-+]?\d+[eE][-+]?\d+"
        r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
    ),
}
_Loader.yaml_implicit_resolvers = {
    first: [
        (tag, pattern)
        for tag, pattern in known
        if tag.rpartition(":")[2] not in ("timestamp", *_NUMBERS)
    ]
    for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _kind, _pattern in _NUMBERS.items():
    _Loader.add_implicit_resolver(  # pyright: ignore[reportUnknownMemberType]
        f"tag:yaml.org,2002:{_kind}", re.compile(f"^({_pattern})$"), list("-+0123456789.")
    )


class _Walk:
    """A look at every value of a file, aliases unfolded: notes the lines of fields, makes their
    names texts, refuses what is too much.
    """

    def __init__(self, file: str, lines: Lines) -> None:
        self._file = file
        self._lines = lines
        self._nodes = 0

    def visit(self, node: yaml.Node, path: Path_) -> None:
        """Look at a node and what is below it."""
        line = node.start_mark.line + 1
        self._nodes += 1
        self._lines[path] = line
        if len(path) > MOST_DEPTH:
            raise _too_deep(f"{self._file}:{line}")
        if self._nodes > MOST_NODES:
            raise _too_many(f"{self._file}:{line}")
        if isinstance(node, yaml.MappingNode):
            self._visit_fields(node, path)
        elif isinstance(node, yaml.SequenceNode):
            for index, value in enumerate(node.value):
                self.visit(value, (*path, index))
        else:
            self._look_at(str(node.value), line)

    def _visit_fields(self, node: yaml.MappingNode, path: Path_) -> None:
        seen: set[str] = set()
        for key, value in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                raise InputError(f"{self._file}:{line}: the name of a field is due, a single word")
            name = str(key.value)
            self._look_at(name, line)
            if not name.isprintable():
                raise InputError(
                    f"{self._file}:{line}: the field's name {name!a} holds characters that do"
                    " not show; remove them"
                )
            if name in seen:
                raise InputError(
                    f"{self._file}:{line}: the field '{name}' is given twice; keep one"
                )
            seen.add(name)
            if key.tag != "tag:yaml.org,2002:merge":
                key.tag = STRING
            self.visit(value, (*path, name))
            self._lines[(*path, name)] = line

    def _look_at(self, text: str, line: int) -> None:
        if len(text) > MOST_CHARACTERS:
            raise InputError(
                f"{self._file}:{line}: a value of {len(text):,} characters; at most"
                f" {MOST_CHARACTERS:,} are allowed"
            )
        if any("\ud800" <= one <= "\udfff" for one in text):
            raise InputError(
                f"{self._file}:{line}: {text!a} holds half a character; write it whole"
            )


def _too_deep(where: str) -> InputError:
    return InputError(
        f"{where}: a value within a value more than {MOST_DEPTH} deep, or one that holds itself;"
        " no description needs that"
    )


def _too_many(where: str) -> InputError:
    return InputError(
        f"{where}: more than {MOST_NODES:,} values, aliases unfolded; no description needs that"
    )
