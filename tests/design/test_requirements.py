"""What a requirements file refuses, in one clear sentence each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from flflab.design.grid import make_grid
from flflab.design.requirements import Requirements, read_requirements
from flflab.errors import InputError

Wanted = Callable[..., Requirements]
LENS = {"name": "one", "focal_length": "50 mm", "f_number": 4}
ARRAY = {
    "name": "one",
    "count": [25, 25],
    "pitch": "400 um",
    "aperture": "336 um",
    "focal_length": "0.917 mm",
}
SENSOR = {"name": "one", "resolution": [3664, 2748], "pixel": "1.66 um"}


@pytest.mark.parametrize(
    ("section", "given", "says"),
    [
        ("measure", {"depth": ["320 mm", "280 mm"]}, "the nearer end comes first"),
        ("measure", {"depth": [280, 320]}, "has no unit"),
        ("measure", {}, "missing"),
        ("require", {"free_working_distance": "400 mm"}, "ask for less room"),
        ("require", {"views": 0}, "greater than 0"),
        ("require", {"contrast": {"at": "4 mm", "least": 0.2}}, "unit of length"),
        ("require", {"speed": "3 mm/s"}, "no such field"),
        ("parts", {"main_lenses": [], "arrays": [ARRAY], "sensors": [SENSOR]},
        "the list is empty; give at least one entry"),
        ("parts",
        {"main_lenses": [LENS], "arrays": [ARRAY | {"aperture": "500 um"}], "sensors": [SENSOR]},
        "wider than the pitch"),
        ("travel", {"array": ["50 mm", "90 mm"]}, "give the ranges array and gap"),
        ("travel", {"array": ["90 mm", "50 mm"], "gap": ["1 mm", "2 mm"]},
        "the smaller comes first"),
        ("maximise", ["area", "area"], "twice"),
        ("maximise", [], "the list is empty; give at least one entry"),
        ("maximise", ["beauty"], "beauty"),
        ("search", {"configurations": 0}, "greater than or equal to 1"),
    ],
)  # fmt: skip
def test_what_cannot_be_asked_for_is_refused_with_its_line(
    wanted: Wanted, section: str, given: Any, says: str
) -> None:
    with pytest.raises(InputError, match=says) as refused:
        wanted(**{section: given})
    assert "requirements.yaml:" in str(refused.value)


def test_an_empty_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.yaml").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="the file is empty"):
        read_requirements(tmp_path / "empty.yaml")


def test_to_maximise_contrast_its_frequency_is_needed(wanted: Wanted) -> None:
    with pytest.raises(InputError, match="at what frequency"):
        wanted(require={"views": 2})


def test_parts_that_make_more_configurations_than_asked_for_are_refused(wanted: Wanted) -> None:
    with pytest.raises(InputError, match="ask for at least 200"):
        make_grid(wanted(search={"configurations": 100}))


def test_a_benchs_stages_say_where_array_and_sensor_can_stand(
    root: Path, tmp_path: Path, described: Callable[..., dict[str, Any]]
) -> None:
    file = tmp_path / "requirements.yaml"
    travel = {"bench": str(root / "examples/benches/simulated.yaml"), "array": ["40 mm", "70 mm"]}
    file.write_text(yaml.safe_dump(described(travel=travel)), encoding="utf-8")
    found = read_requirements(file)
    assert found.travel.array is not None
    assert found.travel.gap is not None
    assert 40 <= found.travel.array[0] < found.travel.array[1] <= 70
    assert found.travel.gap[0] == pytest.approx(0.3)
    file.write_text(
        yaml.safe_dump(described(travel=travel | {"array": ["900 mm", "950 mm"]})), encoding="utf-8"
    )
    with pytest.raises(InputError, match="none of which the requirements allow"):
        read_requirements(file)
