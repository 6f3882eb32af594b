"""Files that are no descriptions, by accident or on purpose: refused at once in one sentence."""

import os
import sys
import threading
from pathlib import Path

import pytest

from flflab.bench import read_bench
from flflab.errors import InputError
from flflab.files.camera import read_camera
from flflab.yaml_file import MOST_DEPTH, MOST_NODES, read_yaml

CAMERA = (Path(__file__).parents[2] / "examples" / "cameras" / "osinski.yaml").read_text(
    encoding="utf-8"
)


def laughs(first: str, each: str) -> str:
    """Nine aliases of nine aliases of ..., nine times."""
    lines = [f"a0: &a0 {first}"]
    for number in range(1, 10):
        lines.append(f"a{number}: &a{number} {each.replace('@', f'*a{number - 1}')}")
    return "\n".join(lines) + "\n" + CAMERA


NINE = ", ".join("@" for _ in range(9))
NINE_FIELDS = ", ".join(f"k{place}: @" for place in range(9))
NINE_MERGED = f"{{<<: [{NINE}]}}"

HOSTILE = {
    "lists of lists": (laughs("[x, x, x]", f"[{NINE}]"), r":\d+: more than 50,000 values, aliases"),
    "fields of fields": (laughs("{x: 1}", f"{{{NINE_FIELDS}}}"), r":\d+: more than 50,000 values"),
    "merged fields": (laughs("{x: 1}", NINE_MERGED), r":\d+: more than 50,000 values"),
    "a list in itself": ("main_lens: &a [*a]\n", r":1: a value within a value more than 50 deep"),
    "fields in themselves": ("main_lens: &a {b: *a}\n", ":1: a value within a value more than 50"),
    "a name in itself": ("main_lens: &a {? *a : 1}\n", ":1: the name of a field is due"),
    "deep brackets": ("main_lens: " + "[" * 3000 + "]" * 3000, r":1: a value within a value more"),
    "brackets that never end": ("main_lens: " + "[" * 500_000, r":1: a value within a value more"),
    "deep braces": ("main_lens: " + "{a: " * 1500 + "1" + "}" * 1500, ":1: a value within a value"),
    "deep blocks": (
        "\n".join(" " * level + "a:" for level in range(200)),
        ":50: a value within a value",
    ),
    "many values": ("a: [" + "1," * 60_000 + "]", ":1: more than 50,000 values"),
    "many fields": ("\n".join(f"a{k}: 1" for k in range(30_000)), r":2\d{4}: more than 50,000 va"),
    "a long value": (
        f'{CAMERA}notes: "{"x" * 100_000}"\n',
        r":\d+: a value of 100,000 characters; at",
    ),
    "a long name": (f"{'x' * 1010}: 1\n", ":1: a value of 1,010 characters; at most 1,000 are"),
    "two megabytes": (CAMERA + "# so on\n" * 262_144, ": longer than 1 MB, which no description"),
    "half a character": (CAMERA + 'name: "\\ud800"\n', r":\d+: '\\ud800' holds half a character"),
    "NUL": (CAMERA + "\0", r":\d+: the character U\+0000 has no place in a text; remove it"),
    "DEL": ("a: 1\nb: \x7f\n", r":2: the character U\+007F has no place in a text; remove it"),
    "an escape in a name": (
        CAMERA + '"\\e]0;PWNED\\a": 1\n',
        r":\d+: the field's name '\\x1b\]0;PWNED\\x07' holds characters that do not show",
    ),
    "writing turned around in a name": (
        CAMERA + '"a\\u202eb": 1\n',
        r":\d+: the field's name 'a\\u202eb' holds characters that do not show",
    ),
    "a list for a name": ("? [a, b]\n: 1\n", ":1: the name of a field is due, a single word"),
    "fields for a name": ("? {a: b}\n: 1\n", ":1: the name of a field is due, a single word"),
    "Python": (
        'main_lens: !!python/object/apply:os.system ["true"]\n',
        ":1: not YAML: could not",
    ),
    "a number without digits": ('a: !!int ""\n', ":1: '' cannot be read as int"),
    "a moment that is none": ("a: !!timestamp x\n", ":1: 'x' cannot be read as timestamp"),
    "a truth that is none": ("a: !!bool maybe\n", ":1: 'maybe' cannot be read as bool"),
    "two documents": (f"{CAMERA}\n---\n{CAMERA}", r":\d+: not YAML: but found another document"),
    "a set": ("!!set {a, b}\n", ":1: a mapping of fields is due here, not set"),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.full if name == "many values" else pytest.mark.ci)
        if name.startswith("many")
        else name
        for name in HOSTILE
    ],
)
def test_what_no_description_is_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    text, says = HOSTILE[name]
    file = tmp_path / "odd.yaml"
    file.write_text(text, encoding="utf-8")
    for read in (read_camera, read_bench, read_yaml):
        with pytest.raises(InputError, match=rf"odd\.yaml{says}") as refusal:
            read(file)
        assert "\n" not in str(refusal.value)
        assert len(str(refusal.value)) < 400 + len(str(file))


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("9" * 999, "f_number: "),
        ("1e400", "f_number: "),
        (".nan", "f_number: "),
        ("2001-01-01", "f_number: a number is due here, not '2001-01-01'"),
        ("2001-13-45", "f_number: a number is due here, not '2001-13-45'"),
        ("1:30", "f_number: a number is due here, not '1:30'"),
        ("!!binary AAA", "not YAML: failed to decode base64 data"),
    ],
)
def test_numbers_that_are_none_are_refused_with_their_line(
    value: str, says: str, tmp_path: Path
) -> None:
    file = tmp_path / "odd.yaml"
    file.write_text(CAMERA.replace("f_number: 4", f"f_number: {value}"), encoding="utf-8")
    line = 1 + CAMERA.partition("f_number: 4")[0].count("\n")
    with pytest.raises(InputError, match=rf"odd\.yaml:{line}: (main_lens\.)?{says}") as refusal:
        read_camera(file)
    assert "\n" not in str(refusal.value)


def test_numbers_are_numbers_in_every_way_of_writing_them(tmp_path: Path) -> None:
    given = "1, -2, +3, 0x1F, 1.5, .5, 1., -1e5, 1e-5, 1.5E+3, 2e3, .inf, -.inf, 1_000"
    (tmp_path / "a.yaml").write_text(f"a: [{given}]\n", encoding="utf-8")
    assert read_yaml(tmp_path / "a.yaml")[0]["a"] == [
        1, -2, 3, 31, 1.5, 0.5, 1.0, -1e5, 1e-5, 1.5e3, 2e3, float("inf"), -float("inf"), 1000,
    ]  # fmt: skip


def test_names_are_words_whatever_else_yaml_takes_them_for(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(
        "1: a\ntrue: b\n~: c\non: d\n2001-01-01: e\n", encoding="utf-8"
    )
    assert read_yaml(tmp_path / "a.yaml")[0] == {
        "1": "a", "true": "b", "~": "c", "on": "d", "2001-01-01": "e",
    }  # fmt: skip


def test_a_description_within_the_bounds_is_read_with_its_aliases(tmp_path: Path) -> None:
    rows = "".join(f"  - {{<<: *first, k: {number}}}\n" for number in range(2000))
    (tmp_path / "a.yaml").write_text(f"first: &first {{x: 1e-5}}\nrows:\n{rows}", encoding="utf-8")
    data, lines = read_yaml(tmp_path / "a.yaml")
    assert data["rows"][1999] == {"x": 1e-5, "k": 1999}
    assert lines["rows", 1999, "k"] == 2002
    assert MOST_NODES > 5 * 2000
    nested = "[" * (MOST_DEPTH - 2) + "]" * (MOST_DEPTH - 2)
    (tmp_path / "a.yaml").write_text(f"a: {nested}", encoding="utf-8")
    assert read_yaml(tmp_path / "a.yaml")[0]["a"]


def test_a_byte_order_mark_is_no_part_of_the_first_name(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("\ufeffa: 1\n", encoding="utf-8")
    assert read_yaml(tmp_path / "a.yaml")[0] == {"a": 1}


@pytest.mark.skipif(sys.platform == "win32", reason="has no such files")
@pytest.mark.parametrize(
    ("place", "says"),
    [
        ("/dev/zero", "longer than 1 MB, which no description is"),
        ("/dev/null", "the file is empty"),
        ("/proc/self/mem", "cannot be read"),
        ("/", "cannot be read"),
        ("a\0b", "no path of a file"),
    ],
)
def test_what_is_no_file_is_refused(place: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_yaml(Path(place))


@pytest.mark.skipif(sys.platform == "win32", reason="has no such pipes")
def test_a_pipe_is_read_to_its_end_and_not_waited_for_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=lambda: pipe.write_text("a: [1, 2]\n", encoding="utf-8"))
    writer.start()
    assert read_yaml(pipe)[0] == {"a": [1, 2]}
    writer.join()
    monkeypatch.setattr("flflab.yaml_file.PATIENCE_S", 0.1)
    with pytest.raises(InputError, match=r"cannot be read \(nothing comes out of it for 0\.1 s\)"):
        read_yaml(pipe)
