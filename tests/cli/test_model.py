"""The command ``flflab model``: every answer is a number or null with a reason; figures with
captions; a fast start.
"""

import json
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from flflab.cli.app import app

ROOT = Path(__file__).resolve().parent.parent.parent
CAMERAS = ROOT / "examples" / "cameras"


def run(*words: str) -> dict[str, Any]:
    result = CliRunner().invoke(app, ["model", *words, "--json"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return json.loads(result.output)


def nulls(part: Any, path: str) -> list[str]:
    """The path of every null outside ``reasons``."""
    if part is None:
        return [path]
    if isinstance(part, dict):
        return [
            found
            for key, value in part.items()
            for found in nulls(value, f"{path}.{key}".lstrip("."))
        ]  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    if isinstance(part, list):
        return [
            found for index, value in enumerate(part) for found in nulls(value, f"{path}[{index}]")
        ]  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    return []


@pytest.fixture
def camera_file(tmp_path: Path) -> Any:
    """Writes the laboratory's camera with some fields changed."""

    def write(**changes: Any) -> str:
        data = yaml.safe_load((CAMERAS / "osinski.yaml").read_text())
        for path, value in changes.items():
            part, field = path.split("__")
            data[part][field] = value
        file = tmp_path / "camera.yaml"
        file.write_text(yaml.safe_dump(data))
        return str(file)

    return write


@pytest.mark.parametrize(
    "name", ["osinski", "osinski-galilean", pytest.param("r12a", marks=pytest.mark.ci)]
)
def test_every_null_has_its_reason(name: str) -> None:
    distances = ("infinity", "50 mm", "300 mm", "506.7016 mm")
    answer = run(
        str(CAMERAS / f"{name}.yaml"), *(word for one in distances for word in ("--distance", one))
    )
    reasons = answer.pop("reasons")
    unexplained = [
        path
        for path in nulls(answer, "")
        if not any(path == key or path.startswith((f"{key}.", f"{key}[")) for key in reasons)
    ]
    assert unexplained == []


@pytest.mark.parametrize(
    "changes",
    [
        {"main_lens__f_number": 16},
        {"main_lens__f_number": 1.0},
        {"microlens_array__distance": "55 mm", "sensor__distance": "56 mm"},
        {"sensor__distance": "60.917 mm"},
        {"sensor__distance": f"{60 + 60 * 0.917 / (60 - 0.917)!r} mm"},
        {"microlens_array__layout": "hexagonal"},
        {"microlens_array__tilt": ["1 deg", "0 deg"], "microlens_array__roll": "5 deg"},
        {
            "microlens_array__focal_length": ["0.917 mm", "0.95 mm"],
            "microlens_array__pattern": [[0, 1]],
        },
    ],
)
def test_unusual_cameras_are_answered_in_full(changes: dict[str, Any], camera_file: Any) -> None:
    answer = run(camera_file(**changes), "--distance", "506.7 mm", "--distance", "infinity")
    reasons = answer.pop("reasons")
    unexplained = [
        path
        for path in nulls(answer, "")
        if not any(path == key or path.startswith((f"{key}.", f"{key}[")) for key in reasons)
    ]
    assert unexplained == []


def test_square_apertures_are_answered_as_well() -> None:
    answer = run(str(CAMERAS / "osinski.yaml"))
    assert answer["useful_pixels"]["sensor"] == 2601548


def test_square_micro_images_hold_more_useful_pixels_than_round_ones(tmp_path: Path) -> None:
    file = tmp_path / "square.yaml"
    file.write_text(
        (CAMERAS / "osinski.yaml")
        .read_text()
        .replace("aperture_shape: round", "aperture_shape: square")
    )
    answer = run(str(file), "--distance", "506.7016 mm")
    assert answer["useful_pixels"]["row"] == 2164
    assert answer["useful_pixels"]["sensor"] > 2601548
    assert answer["distances"][0]["views"]["sensor"]["chief"] == 9


def test_every_answer_says_from_which_plane_it_is_measured(camera_file: Any) -> None:
    assert (
        "measured from the main lens, positive in front"
        in run(str(CAMERAS / "osinski.yaml"))["reference_planes"]
    )
    thick = camera_file(
        main_lens__principal_separation="-3 mm",
        microlens_array__substrate={"thickness": "0.6 mm", "refractive_index": 1.5},
        sensor__distance="60.75 mm",
    )
    answer = run(thick)
    assert "front principal plane" in answer["reference_planes"]
    assert "-3 mm behind" in answer["reference_planes"]
    assert "0.75 mm of air, 1.15 mm optically" in answer["reference_planes"]
    assert answer["sharp_distance_mm"] == pytest.approx(506.7016, abs=1e-3)
    table = CliRunner().invoke(app, ["model", thick]).output
    assert "front principal plane" in " ".join(table.split())


def test_each_microlens_type_has_its_own_sharp_distance(camera_file: Any) -> None:
    answer = run(
        camera_file(
            microlens_array__focal_length=["0.917 mm", "0.95 mm"], microlens_array__pattern=[[0, 1]]
        )
    )
    first, second = answer["types"]
    for one, focal in ((first, 0.917), (second, 0.95)):
        a = 1 / (1 / focal - 1 / 1.15)
        image = 60 - a
        assert one["sharp_distance_mm"] == pytest.approx(1 / (1 / 50 - 1 / image), rel=1e-9)
        near, far = one["depth_of_field_mm"][0]
        assert near < one["sharp_distance_mm"] < far
    assert len(answer["depth_of_field_mm"]) == 2


def test_the_area_s_corners_stand_in_the_json() -> None:
    answer = run(str(CAMERAS / "osinski.yaml"))
    corners = answer["measurement_area"]["total"]["polygons"][0]
    assert min(z for z, _ in corners) == pytest.approx(-514.314, abs=1e-3)
    for (z, y), (_, w, v) in zip(
        corners, answer["measurement_area"]["total"]["homogeneous"][0], strict=True
    ):
        assert (z, y) == pytest.approx((-1 / v, w / v))
    lens = answer["microlenses"][12]
    parallel = lens["boundary_rays"]["parallel upper"]
    assert parallel["main_lens_mm"] == 6.25
    assert parallel["microlens_mm"] == pytest.approx(0.168)
    assert {abs(round(ray["sensor_mm"], 9)) for ray in lens["boundary_rays"].values()} == {
        round(abs(edge), 9) for edge in (*lens["inside_mm"], *lens["outside_mm"])
    }


@pytest.mark.ci
@pytest.mark.parametrize(
    "name", ["osinski", pytest.param("osinski-galilean", marks=pytest.mark.ci)]
)
def test_nine_figures_each_say_what_to_see(name: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(
        app,
        ["model", str(CAMERAS / f"{name}.yaml"), "--figures", str(tmp_path)],
        catch_exceptions=False,
    )
    assert result.exit_code == 0, result.output
    captions = (tmp_path / "captions.md").read_text()
    for number in range(1, 10):
        assert (tmp_path / f"figure-{number}.png").stat().st_size > 20_000
        assert f"Figure {number}. " in captions
    fitted = captions.split("Near the axis they fall as cos^")[1].replace("cos^", "").split()
    assert float(fitted[0]) == pytest.approx(2.0, abs=0.2)
    if name == "osinski":
        assert "at F/2" in captions.split("Figure 3")[1][:120]


def test_the_model_loads_nothing_but_numbers_descriptions_and_the_command_line() -> None:
    """What else is installed would make its start slower; benchmarks/bench_model.py measures it."""
    command = [
        sys.executable,
        "-v",
        "-m",
        "flflab",
        "model",
        str(CAMERAS / "osinski.yaml"),
        "--json",
    ]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stderr
    loaded = {name.split(".")[0] for name in re.findall(r"^import '([^']+)'", told, re.MULTILINE)}
    packages = {name for name in loaded - sys.stdlib_module_names if not name.startswith("_")}
    descriptions = {
        "pydantic",
        "pydantic_core",
        "annotated_types",
        "typing_extensions",
        "typing_inspection",
        "yaml",
    }
    assert packages <= {
        "flflab",
        "numpy",
        *descriptions,
        "typer",
        "annotated_doc",
        "click",
        "shellingham",
        "rich",
    }
    assert packages >= {"flflab", "numpy", "pydantic", "yaml"}


def test_the_table_explains_its_headings_within_80_columns() -> None:
    told = (
        CliRunner()
        .invoke(app, ["model", str(CAMERAS / "osinski.yaml")], env={"COLUMNS": "80"})
        .output
    )
    assert max(map(len, told.splitlines())) <= 80
    for word in (
        "virtual depth: ",
        "magnification: ",
        "ELR: effective lateral resolution",
        "(eq. (3) of the paper)",
    ):
        assert word in told


@pytest.mark.parametrize("width", [80, 120])
def test_footnotes_are_wrapped_once_and_no_cell_is_cut(width: int) -> None:
    distances = [word for one in ("40 mm", "507 mm", "1e300 m") for word in ("--distance", one)]
    told = (
        CliRunner()
        .invoke(
            app, ["model", str(CAMERAS / "osinski.yaml"), *distances], env={"COLUMNS": str(width)}
        )
        .output
    )
    table, notes = told.split("virtual depth: ")
    lines = [line.rstrip() for line in f"virtual depth: {notes}".splitlines()]
    sentences = re.sub(r" (magnification|views|ELR): ", r"\n\1: ", " ".join(lines)).splitlines()
    assert lines == [line for sentence in sentences for line in textwrap.wrap(sentence, width)]
    assert "…" not in table
    assert all(word in table for word in ("keplerian", "5.75e-303", "in or"))


@pytest.mark.parametrize("words", [[], ["bench"]])
def test_the_help_says_of_every_command_what_it_does_in_a_whole_line_of_80_columns(
    words: list[str],
) -> None:
    told = CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "80"}).output
    commands = told.split("Commands:\n")[1].splitlines()
    assert len(commands) > 5
    assert all(line.endswith(".") and "..." not in line and len(line) <= 80 for line in commands)
