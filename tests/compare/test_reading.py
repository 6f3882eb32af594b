import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from flflab.errors import InputError
from flflab.files.camera import read_camera
from flflab.observations.points import measure_points
from flflab.observations.reading import read_observations


@pytest.fixture
def copy(traced: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(traced, tmp_path / "copy"))


def edit(file: Path, change: Callable[[str], str]) -> None:
    file.write_text(change(file.read_text(encoding="utf-8")), encoding="utf-8")


def with_row(file: Path, row: str) -> int:
    """Append a row to a table and say its line."""
    edit(file, lambda text: text + row + "\n")
    return len(file.read_text(encoding="utf-8").splitlines())


def test_a_folder_is_read_whole(traced: Path) -> None:
    found = read_observations(traced)
    rows = (traced / "observations.csv").read_text().splitlines()[1:]
    assert len(found.frame) == len(rows)
    assert (found.board.columns, found.board.rows, found.board.spacing) == (5, 4, 4.0)
    assert found.frames == (0, 1, 3, 4)
    assert found.empty_frames == (2,)
    assert found.board.corners()[7].tolist() == [8.0, 4.0, 0.0]


@pytest.mark.parametrize(
    ("row", "field", "allowed"),
    [
        ("x,3,10,10,0,0,0", "k: 'x'", "whole number from 0"),
        ("3,-1,10,10,0,0,0", "l: '-1'", "whole number from 0"),
        ("3,3,nan,10,0,0,0", "u: 'nan'", "finite number"),
        ("3,3,10,ten,0,0,0", "v: 'ten'", "finite number"),
        ("3,3,10,10,0,20,0", "cluster: 20", "0 to 19"),
        ("3,3,10,10,0,1.5,0", "cluster: '1.5'", "whole number from 0"),
        ("3,3,10,10,0,0,2", "frame: 2 has no pose", r"\[0, 1, 3, 4\]"),
        ("3,3,10", "cluster: 'nothing'", "whole number from 0"),
    ],
)
def test_a_bad_cell_is_refused_with_file_line_and_field(
    copy: Path, row: str, field: str, allowed: str
) -> None:
    line = with_row(copy / "observations.csv", row)
    with pytest.raises(InputError, match=rf"observations\.csv:{line}: {field}.*{allowed}"):
        read_observations(copy)


def test_a_view_given_twice_is_refused_with_both_lines(copy: Path) -> None:
    table = copy / "observations.csv"
    line = with_row(table, table.read_text().splitlines()[1])
    with pytest.raises(
        InputError, match=rf"observations\.csv:{line}: this view stands in line 2 already"
    ):
        read_observations(copy)


def test_missing_columns_are_named(copy: Path) -> None:
    edit(copy / "observations.csv", lambda text: text.replace("cluster,frame", "corner,picture", 1))
    with pytest.raises(InputError, match=r"observations\.csv:1: no column cluster, frame"):
        read_observations(copy)


def test_a_table_without_views_is_refused(copy: Path) -> None:
    edit(copy / "observations.csv", lambda text: text.splitlines()[0] + "\n")
    with pytest.raises(InputError, match="no view below the header"):
        read_observations(copy)


@pytest.mark.parametrize("name", ["observations.csv", "poses.json", "camera.json"])
def test_a_missing_file_is_named(copy: Path, name: str) -> None:
    (copy / name).unlink()
    with pytest.raises(
        InputError,
        match=(
            rf"{copy}: lacks {name}; give a folder that holds observations\.csv, poses\.json and"
            r" camera"
        ),
    ):
        read_observations(copy)


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere: no such folder"):
        read_observations(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda text: text.replace('"rotation"', '"rotated"', 1),
            r"poses\.json:3: 0\.rotated: there is no such field",
        ),
        (
            lambda text: text.replace('"0"', '"first"', 1),
            r"poses\.json:2: first: a frame is a whole number",
        ),
        (lambda text: text[: len(text) // 2], r"poses\.json:\d+: not YAML"),
        (
            lambda text: text.replace('"translation_mm"', '"translation"', 1),
            r"0\.translation: there is no such field, did you mean translation_mm",
        ),
    ],
)
def test_a_bad_field_of_the_poses_is_refused(
    copy: Path, change: Callable[[str], str], said: str
) -> None:
    edit(copy / "poses.json", change)
    with pytest.raises(InputError, match=said):
        read_observations(copy)


@pytest.mark.parametrize("factor", [-1.0, 1.01])
def test_a_matrix_that_does_not_rotate_is_refused(copy: Path, factor: float) -> None:
    poses = json.loads((copy / "poses.json").read_text())
    poses["1"]["rotation"] = [[factor * value for value in row] for row in poses["1"]["rotation"]]
    (copy / "poses.json").write_text(json.dumps(poses, indent=1))
    with pytest.raises(InputError, match=r"poses\.json:\d+: 1\.rotation: not a rotation"):
        read_observations(copy)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            '"5 x 4"',
            '"5 by 4"',
            (
                r"camera\.json:3: target\.checkerboard_corners: two numbers are due, such as '8 x"
                r" 5', not '5 by 4'"
            ),
        ),
        ("4.0", "-4.0", r"camera\.json:4: target\.spacing_mm: .*greater than 0, not -4\.0"),
        ('"spacing_mm"', '"spacing"', r"target\.spacing_mm: this field is missing"),
    ],
)
def test_a_bad_board_is_refused(copy: Path, old: str, new: str, said: str) -> None:
    edit(copy / "camera.json", lambda text: text.replace(old, new))
    with pytest.raises(InputError, match=said):
        read_observations(copy)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        (
            "44,3,10,10,0,0,0",
            "k: 44 lies outside this camera, which has 44 columns of microlenses, 0 to 43",
        ),
        (
            "3,36,10,10,0,0,0",
            "l: 36 lies outside this camera, which has 36 rows of microlenses, 0 to 35",
        ),
        ("3,3,1600,10,0,0,0", "u: 1600 lies outside this camera, which has 1600 columns of pixels"),
        ("3,3,10,-2,0,0,0", "v: -2 lies outside this camera, which has 1150 rows of pixels"),
    ],
)
def test_observations_of_another_camera_are_refused(copy: Path, row: str, said: str) -> None:
    with_row(copy / "observations.csv", row)
    with pytest.raises(InputError, match=said):
        measure_points(read_observations(copy), read_camera(copy / "camera.yaml"))


def test_a_board_behind_the_lens_is_refused(copy: Path) -> None:
    poses = json.loads((copy / "poses.json").read_text())
    poses["3"]["translation_mm"][2] = 300.0
    (copy / "poses.json").write_text(json.dumps(poses))
    with pytest.raises(
        InputError, match=r"poses\.json: 3: point 0 of the board lies -.* mm in front of the lens"
    ):
        measure_points(read_observations(copy), read_camera(copy / "camera.yaml"))
