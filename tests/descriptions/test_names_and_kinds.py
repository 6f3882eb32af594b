"""Names of axes and fields, and files given in the place of others."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flflab.bench import read_bench
from flflab.design.requirements import read_requirements
from flflab.errors import InputError
from flflab.files.camera import read_camera
from flflab.files.target import load_target
from flflab.image.scene_file import read_scene
from flflab.study import read_study

EXAMPLES = Path(__file__).parents[2] / "examples"
CAMERA = EXAMPLES / "cameras" / "osinski.yaml"
BENCH = EXAMPLES / "benches" / "simulated.yaml"
STUDY = EXAMPLES / "studies" / "first.yaml"


def changed(source: Path, folder: Path, old: str, new: str) -> tuple[Path, int]:
    """A copy with one replacement, and the line it stands on."""
    text = source.read_text(encoding="utf-8")
    assert text.count(old) >= 1
    place = text.index(old)
    file = folder / source.name
    file.write_text(
        (text[:place] + new + text[place + len(old) :]).replace(
            "../cameras/", f"{EXAMPLES / 'cameras'}/"
        ),
        encoding="utf-8",
    )
    return file, text[:place].count("\n") + 1


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("array.z", r"'array\.z' cannot be an axis's name: '\.' has no place in it"),
        ("array/z", r"'array/z' cannot be an axis's name: '/' has no place in it"),
        ("''", "'' cannot be an axis's name: it is empty"),
        ("' array'", "' array' cannot be an axis's name: ' ' has no place in it"),
        ("-array", "'-array' cannot be an axis's name: '-' has no place in it"),
        ("camera", "'camera' is the name of something else of the bench"),
        ("iris", "'iris' is the name of something else of the bench"),
        ("target", "'target' is the name of something else of the bench"),
        ("world_array_z", "'world_array_z' is the name of something else of the bench"),
    ],
)
def test_an_axis_whose_name_no_record_could_hold_is_refused_with_its_line(
    tmp_path: Path, name: str, says: str
) -> None:
    file, line = changed(BENCH, tmp_path, "array_stage:", f"{name}:")
    with pytest.raises(InputError, match=rf"yaml:{line}: axes\.[^:]*: {says}") as refusal:
        read_bench(file)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", ["array stage", "Größe", "z2", "[red]x", "a_b-c"])
def test_other_names_of_axes_are_names(tmp_path: Path, name: str) -> None:
    file, _ = changed(BENCH, tmp_path, "array_stage:", f"{json.dumps(name)}:")
    assert name in read_bench(file).description.axes


EACH_KIND: dict[str, tuple[Path | None, Callable[[Path], Any]]] = {
    "camera": (CAMERA, read_camera),
    "bench": (BENCH, read_bench),
    "study": (STUDY, lambda file: read_study(file, read_camera(CAMERA))),
    "requirements": (EXAMPLES / "requirements" / "osinski.yaml", read_requirements),
    "scene": (None, read_scene),
    "target": (None, load_target),
}


@pytest.mark.parametrize("due", EACH_KIND)
@pytest.mark.parametrize("given", ["camera", "bench", "study", "requirements", "scene", "target"])
def test_a_file_of_another_kind_is_named_in_one_sentence(
    due: str, given: str, tmp_path: Path
) -> None:
    file = EACH_KIND[given][0]
    if file is None:
        file = tmp_path / "mine.yaml"
        file.write_text("kind: white" if given == "target" else "planes: []", encoding="utf-8")
    if due == given:
        return
    with pytest.raises(InputError) as refusal:
        EACH_KIND[due][1](file)
    assert str(refusal.value) == f"{file} is a {given} file; a {due} file is expected here"


def test_a_misspelt_field_is_told_with_the_one_it_is_likely_to_be(tmp_path: Path) -> None:
    file, line = changed(CAMERA, tmp_path, "f_number:", "f_numbr:")
    with pytest.raises(
        InputError,
        match=rf"yaml:{line}: main_lens\.f_numbr: .* did you mean f_number\?",
    ) as refusal:
        read_camera(file)
    assert "missing" not in str(refusal.value)  # it is not said a second time
