"""The hidden truth: drawn from the bench file's uncertainties, once and for all, and what follows
from where the stages stand.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from flflab.bench import Bench, with_seed
from flflab.errors import InputError
from flflab.targets import Bars, Black, FourDot
from sim.clock import SteppedClock
from sim.motion import move, rest
from sim.world import WHEEL, Carriage, World, keyed, true_axis, true_optics, wheel_targets

WriteBench = Callable[..., Bench]


def test_the_same_seed_gives_the_same_truth_and_another_seed_another(
    write_bench_file: WriteBench,
) -> None:
    first, again, other = (
        World(write_bench_file(seed=seed), SteppedClock()).axes for seed in (5, 5, 6)
    )
    assert first == again
    assert all(first[name].zero != other[name].zero for name in first)


def test_one_axis_does_not_depend_on_which_others_are_there(write_bench_file: WriteBench) -> None:
    bench = write_bench_file(seed=5)
    world = World(bench, SteppedClock())
    alone = true_axis("sensor_stage", bench.description.axes["sensor_stage"], 61.15, 5, {})
    assert alone == world.axes["sensor_stage"]


def test_hidden_errors_have_the_stated_spread(write_bench_file: WriteBench) -> None:
    axis = write_bench_file().description.axes["array_stage"]
    drawn = [true_axis("array_stage", axis, 60.0, seed, {}) for seed in range(2000)]
    zeros = np.array([true.zero - axis.zero for true in drawn]) / axis.zero_uncertainty
    scales = np.array([true.scale for true in drawn]) / axis.scale_uncertainty
    assert stats.kstest(zeros, "norm").pvalue > 0.01
    assert stats.kstest(scales, "norm").pvalue > 0.01
    assert abs(np.corrcoef(zeros, scales)[0, 1]) < 0.07


def test_an_array_is_turned_by_as_much_as_it_is_said_to_be_unsure(
    write_bench_file: WriteBench,
) -> None:
    bench = write_bench_file()
    drawn = [true_optics(with_seed(bench, seed), {}).array for seed in range(1000)]
    for angles in (
        [one.roll for one in drawn],
        [math.atan(one.tilt[0]) for one in drawn],
        [math.atan(one.tilt[1]) for one in drawn],
    ):
        assert stats.kstest(np.array(angles) / 0.5e-3, "norm").pvalue > 0.01
    turning = write_bench_file("full").description.axes["rotation_stage"]
    zeros = [
        true_axis("rotation_stage", turning, 0.0, seed, {}, 0.5e-3).zero for seed in range(1000)
    ]
    assert (
        stats.kstest(np.array(zeros) / math.hypot(0.5e-3, math.radians(0.01)), "norm").pvalue > 0.01
    )


def test_the_lamp_is_another_in_every_setting_and_the_same_for_all_targets_shown_in_it(
    write_bench_file: WriteBench,
) -> None:
    world = World(write_bench_file(), SteppedClock())
    lamps = list[float]()
    for place in np.linspace(0.0, 100.0, 1000):
        world.carriages["target_stage"].motion = rest(float(place))
        lamps.append(world.lamp(world.scene(0.0)))
    assert stats.kstest((np.array(lamps) - 1) / 0.005, "norm").pvalue > 0.01
    world.wheel.motion = rest(WHEEL.index("bars"))
    assert world.lamp(world.scene(0.0)) == lamps[-1]


def test_a_keyed_generator_depends_on_every_part_of_its_key() -> None:
    draws = {
        keyed(*key).integers(2**63)
        for key in [(1, "a"), (1, "b"), (2, "a"), (1, "a", 0), ("1", "a"), (11, ""), (1, "1")]
    }
    assert len(draws) == 7


@pytest.mark.ci
def test_microlenses_that_touch_are_drawn_no_wider_than_there_is_room(
    write_bench_file: WriteBench,
) -> None:
    bench = write_bench_file()
    touching = replace(bench.optics, array=replace(bench.optics.array, aperture=0.4))
    doubt = bench.description.optics_uncertainty.model_copy(
        update={"microlens_aperture": 0.005, "pitch": 0.001}
    )
    drawn: list[float] = []
    for seed in range(40):
        simulated = bench.description.simulated.model_copy(update={"seed": seed})
        description = bench.description.model_copy(
            update={"optics_uncertainty": doubt, "simulated": simulated}
        )
        array = World(
            replace(bench, optics=touching, description=description), SteppedClock()
        ).optics.array
        drawn.append(array.aperture / min(array.pitch))
    assert max(drawn) == 1.0
    assert min(drawn) < 0.995


def test_an_array_that_no_stage_turns_can_be_tilted_on_purpose(
    write_bench_file: WriteBench,
) -> None:
    world = World(
        write_bench_file(
            truths={"microlens_array.yaw": "0.3 deg", "microlens_array.pitch": "-2 mrad"}
        ),
        SteppedClock(),
    )
    scene = world.scene(world.clock.now())
    assert scene.camera is not None
    assert scene.camera.array.tilt == pytest.approx((math.tan(math.radians(0.3)), math.tan(-2e-3)))


def test_the_camera_sees_where_the_stages_really_stand(write_bench_file: WriteBench) -> None:
    truths = {
        "main_lens_stage.zero": "10 um", "main_lens_stage.scale": 0, "array_stage.zero": "30 um",
        "array_stage.scale": "100 ppm",
        "sensor_stage.zero": 0, "sensor_stage.scale": 0, "target_stage.zero": "-1 mm",
        "target_stage.scale": 0, "iris.scale": "1 %",
        "microlens_array.roll": "0 deg", "microlens_array.yaw": "0 deg",
        "microlens_array.pitch": "0 deg",
    }  # fmt: skip
    clock = SteppedClock()
    world = World(write_bench_file(truths=truths), clock)
    for name, travel in (
        ("main_lens_stage", 10.0),
        ("array_stage", 20.0),
        ("sensor_stage", 18.0),
        ("target_stage", 90.0),
    ):
        world.carriages[name].motion = rest(travel)
    scene = world.scene(clock.now())
    assert scene.camera is not None
    # World z: lens 0.010, array 40.030 + 20 (1 + 1e-4) = 60.032, sensor 80 - 18 = 62, target -601 +
    # 90 = -511.
    assert scene.camera.array.distance == pytest.approx(60.032 - 0.010)
    assert scene.camera.gap == pytest.approx(62 - 60.032)
    assert scene.distance == pytest.approx(0.010 + 511)
    assert scene.camera.main_lens.f_number == pytest.approx(4 * 1.01)
    assert world.gap(clock.now()) == pytest.approx(62 - 60.032)


def test_axes_tilt_and_roll_the_array_that_the_camera_sees(write_bench_file: WriteBench) -> None:
    truths = {
        f"{name}.{what}": 0
        for name in ("rotation_stage", "goniometer")
        for what in ("zero", "scale")
    }
    world = World(
        write_bench_file("full", truths=truths | {"ring.zero": "0.2 deg", "ring.scale": 0}),
        SteppedClock(),
    )
    for name, degrees in (("rotation_stage", 2.0), ("goniometer", -1.0), ("ring", 30.0)):
        world.carriages[name].motion = rest(math.radians(degrees))
    assert world.angles(0.0) == pytest.approx(
        {f"array.{k}": math.radians(v) for k, v in (("yaw", 2), ("pitch", -1), ("roll", 30.2))}
    )
    camera = world.scene(0.0).camera
    assert camera is not None
    assert camera.array.tilt == pytest.approx(
        (math.tan(math.radians(2)), math.tan(math.radians(-1)))
    )
    assert camera.array.roll == pytest.approx(math.radians(30.2))


def test_the_gap_is_that_of_the_lowest_corner_of_a_rolled_plate(
    write_bench_file: WriteBench,
) -> None:
    """The corner at azimuth 45 + 45 degrees of a square plate: half its diagonal times the sine of
    the pitch.
    """
    world = World(
        write_bench_file(
            "full", truths={f"{name}.zero": 0 for name in ("rotation_stage", "goniometer", "ring")}
        ),
        SteppedClock(),
    )
    flat = world.gap(0.0)
    world.carriages["ring"].motion = rest(math.radians(45))
    world.carriages["goniometer"].motion = rest(math.radians(3))
    half_diagonal = (25 * 0.4 + 0.336) / math.sqrt(2)
    assert flat - world.gap(0.0) == pytest.approx(
        half_diagonal * math.sin(math.radians(3)), rel=1e-4
    )


def test_the_bench_wakes_up_as_the_camera_file_has_it(write_bench_file: WriteBench) -> None:
    world = World(write_bench_file(), SteppedClock())
    elements = world.elements(0.0)
    assert elements["main_lens.z"] == pytest.approx(0.0, abs=0.01)
    assert elements["array.z"] == pytest.approx(60.0, abs=0.01)
    assert elements["sensor.z"] == pytest.approx(61.15, abs=0.01)
    assert elements["target.z"] == pytest.approx(-506.7016, abs=0.5)


def test_a_sensor_in_the_array_sees_nothing(write_bench_file: WriteBench) -> None:
    world = World(write_bench_file(), SteppedClock())
    world.carriages["sensor_stage"].motion = rest(25.0)
    assert world.scene(0.0).camera is None
    assert world.gap(0.0) < 0


def test_between_two_places_of_the_wheel_there_is_no_target(write_bench_file: WriteBench) -> None:
    clock = SteppedClock()
    world = World(write_bench_file(), clock)
    world.wheel.motion = move(rest(WHEEL.index("white")), 0.0, WHEEL.index("four-dot"), 2.0, np.inf)
    clock.step(0.3)
    assert world.target_name(clock.now()) == ""
    assert isinstance(world.scene(clock.now()).target, Black)
    clock.step(1.0)
    assert isinstance(world.scene(clock.now()).target, FourDot)


def test_a_carriage_remembers_where_it_was_before_its_last_motion() -> None:
    clock = SteppedClock()
    carriage = Carriage(clock, 0.0)
    carriage.motion = move(rest(0.0), 0.0, 10.0, 1.0, np.inf)
    clock.step(4.0)
    carriage.motion = move(carriage.motion, 4.0, 0.0, 1.0, np.inf)
    clock.step(3.0)
    assert [carriage.at(instant) for instant in (2.0, 4.0, 7.0)] == pytest.approx([2.0, 4.0, 1.0])


def test_a_truth_that_nothing_heeds_is_refused(write_bench_file: WriteBench) -> None:
    with pytest.raises(InputError, match=r"array_stage\.zeroo.*allowed here: .*array_stage\.zero,"):
        World(write_bench_file(truths={"array_stage.zeroo": "1 um"}), SteppedClock())
    with pytest.raises(InputError, match=r"array_stage\.zero: .*no unit"):
        World(write_bench_file(truths={"array_stage.zero": 3}), SteppedClock())


def test_the_wheel_holds_the_targets_that_the_bench_file_describes(
    write_bench_file: WriteBench,
) -> None:
    bench = write_bench_file(targets={"four-dot": {"diameter": "0.5 mm", "spacing": "4 mm"}})
    assert wheel_targets(bench)["four-dot"] == FourDot(0.5, 4.0)
    assert wheel_targets(bench)["bars"] == Bars()


def test_a_target_that_is_not_on_the_wheel_is_refused(write_bench_file: WriteBench) -> None:
    with pytest.raises(InputError, match="no 'star' on the wheel; allowed: four-dot"):
        wheel_targets(write_bench_file(targets={"star": {}}))


def test_a_stage_that_drifts_is_elsewhere_an_hour_later(write_bench_file: WriteBench) -> None:
    clock = SteppedClock()
    world = World(write_bench_file(drift={"sensor_stage": "2 um/h"}), clock)
    before = world.elements(clock.now())
    clock.step(3600)
    after = world.elements(clock.now())
    assert after["sensor.z"] - before["sensor.z"] == pytest.approx(0.002, abs=1e-9)
    assert after["array.z"] == before["array.z"]
    with pytest.raises(InputError, match=r"drift.iris: nothing drifts there; allowed: main"):
        World(write_bench_file(drift={"iris": "2 um/h"}), clock)
    with pytest.raises(InputError, match=r"drift.sensor_stage: .*'um' is a unit of length"):
        World(write_bench_file(drift={"sensor_stage": "2 um"}), clock)
