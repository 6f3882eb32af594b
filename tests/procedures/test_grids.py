"""Grids and lists over every stage position and the f-number on the whole bench of the paper's Fig.
10, and what of them is refused.
"""

import itertools
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from flflab.bench import Bench, read_bench
from flflab.errors import FlflabError
from flflab.study import Study, read_study
from procedures.steps import Capture, Expose, Move, SetIris, homed_readings, steps

Describe = Callable[..., tuple[Study, Bench]]
EXAMPLES = Path(__file__).parents[2] / "examples"
FULL, SIMPLE = (EXAMPLES / "benches" / name for name in ("full.yaml", "simulated.yaml"))
# Where an axis stands by its bench file: place = zero + sign * reading, mm or degrees.
PLACES: dict[str, Callable[[float], float]] = {
    "main_lens_stage": lambda mm: mm - 10,
    "array_stage": lambda mm: 40 + mm,
    "sensor_stage": lambda mm: 80 - mm,
    "target_stage": lambda mm: mm - 600,
    "rotation_stage": math.degrees,
    "goniometer": math.degrees,
    "ring": math.degrees,
}


@pytest.fixture
def describe(tmp_path: Path) -> Describe:
    """A study of these configurations on a bench of the examples."""

    def read(
        *configurations: dict[str, Any], bench: Path = FULL, **more: Any
    ) -> tuple[Study, Bench]:
        file = tmp_path / "study.yaml"
        file.write_text(
            yaml.safe_dump({"name": "grids", "configurations": list(configurations)} | more)
        )
        described = read_bench(bench)
        return read_study(file, described.optics), described

    return read


def settings_of_the_points(study: Study, bench: Bench) -> list[tuple[float, ...]]:
    """F-number and places of all axes at every point, in the order taken, by the readings that the
    steps send.
    """
    now, f_number, found = homed_readings(bench), 0.0, list[tuple[float, ...]]()
    for step in steps(study, bench):
        match step:
            case SetIris(value):
                f_number = value
            case Move(_, groups):
                now |= {name: reading for group in groups for name, reading in group.items()}
            case Expose() | Capture():
                found.append(
                    (f_number, *(round(place(now[name]), 6) for name, place in PLACES.items()))
                )
            case _:
                pass
    return found


def test_a_grid_runs_over_every_stage_and_the_f_number(describe: Describe) -> None:
    study, bench = describe(
        {
            "f_number": [2.8, 4], "distance": ["500 mm", "515 mm"], "main_lens": ["-1 mm", "0 mm"],
            "array": ["59.8 mm", "60 mm"],
            "sensor": ["61.1 mm", "61.2 mm"], "yaw": ["-0.2 deg", "0.2 deg"],
            "pitch": ["0 deg", "0.1 deg"], "roll": ["0 deg", "1 deg"],
        },
        targets=["bars"],
    )  # fmt: skip
    assert (
        study.configurations[0].besides
        == "main lens at -1 mm, pitch 0 deg, yaw -0.2 deg, roll 0 deg"
    )
    every = itertools.product(
        (2.8, 4), (-1, 0), (59.8, 60), (61.1, 61.2), (-500, -515), (-0.2, 0.2), (0, 0.1), (0, 1)
    )
    assert Counter(settings_of_the_points(study, bench)) == Counter(
        2 * [tuple(float(value) for value in one) for one in every]
    )


def test_a_list_of_settings_is_taken_as_it_stands(describe: Describe) -> None:
    listed = [
        (4, "507 mm", "60 mm", "61.15 mm", "0 deg"),
        (2.8, "490 mm", "58 mm", "59.3 mm", "0.3 deg"),
        (8, "555 mm", "63 mm", "64 mm", "0 deg"),
    ]
    names = "f_number", "distance", "array", "sensor", "yaw"
    study, bench = describe(
        *(dict(zip(names, one, strict=True)) for one in listed), targets=["dots"]
    )
    assert [(one.f_number, one.distance, one.array,
    one.sensor) for one in study.configurations] == [
        (4, 507, 60, 61.15), (2.8, 490, 58, 59.3), (8, 555, 63, 64),
    ]  # fmt: skip
    assert set(settings_of_the_points(study, bench)) == {
        (4, 0, 60, 61.15, -507, 0, 0, 0), (2.8, 0, 58, 59.3, -490, 0.3, 0, 0),
        (8, 0, 63, 64, -555, 0, 0, 0),
    }  # fmt: skip


def test_the_main_lens_moves_alone_and_is_followed_where_the_sensor_is_refocused(
    describe: Describe,
) -> None:
    still, moved = (
        describe({"f_number": 4, "distance": "507 mm", "main_lens": ["0 mm", "0.5 mm"]} | more)[
            0
        ].configurations[1]
        for more in ({"sensor": "61.15 mm"}, {})
    )
    assert (still.distance, still.array, still.sensor) == pytest.approx(
        (507.5, 59.5, 60.65), abs=1e-9
    )
    # refocused: 1/a' = 1/50 - 1/507.5 puts the image a' - 59.5 mm behind the array, and the
    # microlens images it, f = 0.917 mm
    behind = 1 / (1 / 50 - 1 / 507.5) - 59.5
    assert moved.sensor - moved.array == pytest.approx(1 / (1 / 0.917 + 1 / behind), abs=1e-9)
    study, bench = describe(
        {"f_number": 4, "distance": "507 mm", "main_lens": ["0 mm", "0.5 mm"], "sensor": "61.15 mm"}
    )
    later = [step for step in steps(study, bench) if isinstance(step, Move)][1:]
    assert [set(group) for step in later for group in step.groups] == [{"main_lens_stage"}] * 3


REFUSALS = [
    (
        FULL,
        {"main_lens": "16 mm"},
        "main_lens_stage would have to go to 26.0000 mm, outside its limits, 0 mm to 25 mm",
    ),
    (
        FULL,
        {"distance": "601 mm"},
        "target_stage would have to go to -1.0000 mm, outside its limits, 0 mm to 150 mm",
    ),
    (
        FULL,
        {"array": "39 mm", "sensor": "61 mm"},
        "array_stage would have to go to -1.0000 mm, outside its limits, 0 mm to 50 mm",
    ),
    (
        FULL,
        {"sensor": "80.5 mm"},
        "sensor_stage would have to go to -0.5000 mm, outside its limits, 0 mm to 50 mm",
    ),
    (
        FULL,
        {"yaw": "10.5 deg"},
        "rotation_stage would have to go to 10.5000 deg, outside its limits, -10 deg to 10 deg",
    ),
    (
        FULL,
        {"pitch": "-11 deg"},
        "goniometer would have to go to -11.0000 deg, outside its limits, -10 deg to 10 deg",
    ),
    (
        SIMPLE,
        {"yaw": "0.2 deg"},
        (
            "needs array.yaw at 0.2 deg, but no axis of .*simulated.yaml turns it and the camera"
            " file has 0 deg"
        ),
    ),
    (
        SIMPLE,
        {"pitch": "0.2 deg"},
        (
            "needs array.pitch at 0.2 deg, but no axis of .*simulated.yaml turns it and the camera"
            " file has 0 deg"
        ),
    ),
    (
        SIMPLE,
        {"roll": "1 deg"},
        (
            "needs array.roll at 1 deg, but no axis of .*simulated.yaml turns it and the camera"
            " file has 0 deg"
        ),
    ),
]


@pytest.mark.parametrize(
    ("bench", "asked", "says"),
    REFUSALS,
    ids=[f"{bench.stem}-{'-'.join(asked)}" for bench, asked, _ in REFUSALS],
)
def test_what_the_bench_cannot_do_is_refused_before_anything_connects(
    bench: Path, asked: dict[str, str], says: str, describe: Describe
) -> None:
    study, described = describe(
        {"f_number": 4, "distance": "507 mm"},
        {"f_number": 4, "distance": "507 mm", "sensor": "61.15 mm"} | asked,
        bench=bench,
    )
    with pytest.raises(
        FlflabError,
        match=(
            rf"configuration 1:? .*{says}(: .*; nothing moved\. Change|; give the axis or change)"
            r" the study"
        ),
    ):
        steps(study, described)
