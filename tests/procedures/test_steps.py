"""Plans as data: what they hold, in which order, and what they refuse before anything moves."""

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from flflab.bench import Bench, FixedDescription
from flflab.bench_uncertainty import MeasurementFloorDescription
from flflab.errors import InputError, InterlockError, LimitError
from flflab.study import Study
from procedures.durations import SETTLE_S, durations
from procedures.steps import (
    Capture,
    CaptureDark,
    Expose,
    Home,
    Move,
    SetIris,
    ShowTarget,
    homed_readings,
    most_frames,
    steps,
    sweep_steps,
)  # fmt: skip

Described = Callable[..., tuple[Study, Bench]]
GRID = {
    "configurations": [
        {"f_number": [5.6, 2.8], "distance": ["500 mm", "515 mm"]},
        {"f_number": 2.8, "distance": "507 mm"},
    ]
}


def test_a_person_acts_as_seldom_as_the_irises_allow(described: Described) -> None:
    study, bench = described(study=GRID)
    to_do = steps(study, bench)
    assert [step.f_number for step in to_do if isinstance(step, SetIris)] == [2.8, 5.6]
    assert [step.kind for step in to_do if isinstance(step, ShowTarget)] == [
        *("white", "four-dot", "bars") * 2,
        "black",
    ]
    assert isinstance(to_do[-1], CaptureDark)


def test_every_point_is_taken_once_and_its_exposure_is_found_before(described: Described) -> None:
    study, bench = described(study=GRID | {"exposure": {"frames": 2}})
    points = [step.key for step in steps(study, bench) if isinstance(step, (Expose, Capture))]
    assert len(points) == len(set(points)) == 5 * 3 * 2
    for index in range(5):
        mine = [key for key in points if key.startswith(f"c{index}/")]
        assert mine[0] == f"c{index}/white/0"
    assert most_frames(steps(study, bench)) == 5 * 3 * 2 + 5 * 2


def test_what_homes_away_from_its_neighbours_homes_first_and_together(
    described: Described,
) -> None:
    homes = [step.axes for step in steps(*described()) if isinstance(step, Home)]
    assert homes == [("sensor_stage", "main_lens_stage"), ("array_stage",), ("target_stage",)]


def test_what_homes_towards_its_neighbour_homes_after_it(described: Described) -> None:
    homes = [
        step.axes
        for step in steps(*described(axes={"sensor_stage": {"home_towards": "-z"}}))
        if isinstance(step, Home)
    ]
    assert homes == [("main_lens_stage",), ("array_stage",), ("sensor_stage",), ("target_stage",)]


def test_axes_stand_where_the_configuration_asks(described: Described) -> None:
    study, bench = described(study=GRID)
    now = homed_readings(bench)
    assert now == {"main_lens_stage": 0, "array_stage": 0, "sensor_stage": 0, "target_stage": 0}
    checked = 0
    for step in steps(study, bench):
        if isinstance(step, Move):
            now |= {name: mm for group in step.groups for name, mm in group.items()}
        if isinstance(step, (Expose, Capture)):
            # zero + sign * reading, from the bench file
            lens, array = now["main_lens_stage"] - 10, now["array_stage"] + 40
            sensor, target = 80 - now["sensor_stage"], now["target_stage"] - 600
            wanted = step.configuration
            assert (array - lens, sensor - lens, lens - target) == pytest.approx(
                (wanted.array, wanted.sensor, wanted.distance), abs=1e-9
            )
            checked += 1
    assert checked == 15


def test_array_and_sensor_never_come_nearer_than_the_minimum_gap_on_the_way(
    described: Described,
) -> None:
    places = [
        {"f_number": 4, "distance": f"{d} mm", "array": f"{a} mm"}
        for d, a in itertools.product((500, 520), (58, 63, 60.2, 66))
    ]
    study, bench = described(study={"configurations": places})
    now = homed_readings(bench)
    moved_both = 0
    for step in sweep_steps(study, bench, now):
        if not isinstance(step, Move):
            continue
        moved_both += {"array_stage", "sensor_stage"} <= {
            name for group in step.groups for name in group
        }
        for group in step.groups:
            assert len(group.keys() & {"array_stage", "sensor_stage"}) <= 1
            now |= group
            assert (80 - now["sensor_stage"]) - (40 + now["array_stage"]) > 0.3
    assert moved_both >= 3


def test_a_configuration_out_of_reach_is_refused(described: Described) -> None:
    study, bench = described(
        study={"configurations": [{"f_number": 4, "distance": ["507 mm", "700 mm"]}]}
    )
    with pytest.raises(
        LimitError,
        match=(
            r"configuration 1: target_stage .* -100\.0000 mm, outside its limits, 0 mm to 150 mm:"
            r" target\.z at -700 mm is due, it reaches -600 mm to -450 mm; nothing moved"
        ),
    ):
        steps(study, bench)


def test_a_gap_that_is_too_small_is_refused(described: Described) -> None:
    study, bench = described(
        study={"configurations": [{"f_number": 4, "distance": "507 mm", "sensor": "60.2 mm"}]}
    )
    with pytest.raises(InterlockError, match=r"configuration 0: .*at least 0\.3 mm"):
        steps(study, bench)


def test_an_element_that_nothing_moves_must_stand_where_the_study_wants_it(
    described: Described,
) -> None:
    study, bench = described(study=GRID)
    axes = {
        name: axis
        for name, axis in bench.description.axes.items()
        if axis.moves not in ("array.z", "main_lens.z")
    }
    stated = FixedDescription.model_validate(
        {
            "array.z": {"at": "60 mm", "uncertainty": "1 um"},
            "main_lens.z": {"at": "0 mm", "uncertainty": "1 um"},
        }
    )
    partial, fixed = (
        Bench(
            bench.description.model_copy(update={"axes": axes} | update),
            bench.file,
            bench.lines,
            bench.optics,
        )
        for update in ({}, {"fixed": stated})
    )
    with pytest.raises(InterlockError, match=r"`fixed: \{array\.z: \{at: 60 mm, uncertainty"):
        steps(study, partial)
    assert any(isinstance(step, Move) for step in steps(study, fixed))
    elsewhere, _ = described(
        study={"configurations": [{"f_number": 4, "distance": "507 mm", "array": "59 mm"}]}
    )
    with pytest.raises(
        InputError,
        match=re.escape("configuration 0 needs array.z at 59 mm, but it stands at 60 mm"),
    ):
        steps(elsewhere, fixed)


def test_a_step_lasts_as_long_as_its_longest_axis(described: Described) -> None:
    study, bench = described()
    to_do = steps(study, bench)
    lasting = durations(to_do, bench)
    moves: list[tuple[Any, float]] = [
        (step, seconds)
        for step, seconds in zip(to_do, lasting, strict=True)
        if isinstance(step, Move)
    ]
    first, seconds = moves[0]
    # target 100 mm at 25 mm/s beside the main lens, 10 mm at 10 mm/s; then array and sensor at 10
    # mm/s, one after the other
    sensor = first.groups[2]["sensor_stage"]
    assert seconds == pytest.approx(100 / 25 + 20 / 10 + sensor / 10 + 3 * SETTLE_S)


def test_an_accuracy_below_the_measurement_s_floor_is_refused_before_anything_moves(
    described: Described,
) -> None:
    asked = GRID | {"mtf_standard_uncertainty": 0.002}
    study, bench = described(study=asked)

    def with_floor(contrast: float) -> Bench:
        floor = MeasurementFloorDescription(contrast=contrast)
        stated = bench.description.model_copy(update={"measurement_floor": floor})
        return replace(bench, description=stated)

    with pytest.raises(
        InputError, match=r"0\.002, which no number of frames reaches: .*floor\.contrast is 0\.002"
    ):
        steps(study, with_floor(0.002))
    assert steps(study, with_floor(0.001))


def test_a_study_that_repeats_takes_every_setting_again_after_all_others(
    described: Described,
) -> None:
    study, bench = described(study=GRID | {"repeats": 3})
    to_do = steps(study, bench)
    assert study.settings == 5
    assert [step.f_number for step in to_do if isinstance(step, SetIris)] == [2.8, 5.6] * 3
    exposed = [step.configuration for step in to_do if isinstance(step, Expose)]
    assert len(exposed) == 15
    assert {one.index for one in exposed} == set(range(15))
    for time in range(3):
        assert {one.index % 5 for one in exposed[5 * time : 5 * time + 5]} == set(range(5))
        assert {one.repetition for one in exposed[5 * time : 5 * time + 5]} == {time}


def test_a_setting_is_left_and_approached_again_from_the_side_to_which_its_stages_home(
    described: Described,
) -> None:
    one = {"configurations": [{"f_number": 4, "distance": "507 mm"}]}
    study, bench = described(study=one | {"repeats": 2, "reapproach": True})
    now = homed_readings(bench)
    for step in steps(study, bench):
        if isinstance(step, Move):
            for group in step.groups:
                now = {**now, **group}
                sensor, array = (
                    bench.description.axes[name].world(now[name])
                    for name in ("sensor_stage", "array_stage")
                )
                assert sensor - array >= bench.description.minimum_gap
        elif isinstance(step, (Expose, Capture)):
            for name, axis in bench.description.axes.items():
                world = {
                    "main_lens.z": 0.0, "array.z": 60.0, "target.z": -507.0,
                    "sensor.z": study.configurations[0].sensor,
                }[axis.moves]  # fmt: skip
                assert now[name] == pytest.approx(axis.reading(world))
    moves = [step for step in steps(study, bench) if isinstance(step, Move)]
    assert len(moves) == 2 * 2 * 3  # aside and back, twice, for each of three targets
    for aside, there in zip(moves[::2], moves[1::2], strict=True):
        from_, to = (
            {name: mm for group in step.groups for name, mm in group.items()}
            for step in (aside, there)
        )
        assert set(from_) == set(to) == set(bench.description.axes)
        for name, axis in bench.description.axes.items():
            side = 1 if axis.homes_up else -1
            assert from_[name] - to[name] == pytest.approx(0.2 * side)
