"""The real drivers on the simulated benches: whatever is asked, array and sensor never meet in
truth, tilted or not.
"""

import contextlib
import re
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from drivers.base import Axis, wait_all
from drivers.bench import connect
from flflab.bench import Bench, read_bench
from flflab.errors import DeviceError, InterlockError, MotionError
from flflab.optics.smms import camera_smms
from procedures.steps import home_steps
from sim.serve import Served, serve, write_bench

WriteBench = Callable[..., Bench]


@pytest.mark.parametrize("error", [pytest.param("3 um", marks=pytest.mark.full), "-3 um"])
def test_the_true_gap_is_kept_through_homing_and_any_moves(
    write_bench_file: WriteBench, tmp_path: Path, error: str
) -> None:
    truths = {
        "array_stage.zero": error,
        "sensor_stage.zero": "-3 um" if error == "3 um" else "3 um",
    }
    bench = write_bench_file(truths=truths, clock=100)
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        world = served.world
        begun = world.clock.now()
        refused = 0
        with connect(tmp_path / "served.yaml") as connected:
            array, sensor = connected.axes["array_stage"], connected.axes["sensor_stage"]
            with contextlib.suppress(DeviceError):
                sensor.move_to(25.0).wait(10)
            for axis in (array, sensor):
                axis.home().wait(10)
            generator = np.random.default_rng(7)
            for _ in range(25):
                axis = (array, sensor)[generator.integers(2)]
                try:
                    axis.move_to(float(generator.uniform(5, 45))).wait(10)
                except DeviceError:
                    refused += 1
        instants = np.linspace(begun, world.clock.now(), 20_000)
        gaps = [world.gap(float(instant)) for instant in instants]
    assert refused > 3
    assert min(gaps) >= bench.description.minimum_gap


@pytest.mark.ci
def test_the_true_gap_is_kept_by_a_tilting_array_whose_axes_move_together(
    write_bench_file: WriteBench, tmp_path: Path
) -> None:
    """Four axes by three makers; each is told to go on while the others are still under way, and is
    stopped now and then.
    """
    truths = {
        "array_stage.zero": "3 um",
        "sensor_stage.zero": "-3 um",
        "goniometer.zero": "0.03 deg",
        "rotation_stage.zero": "-0.03 deg",
    }
    bench = write_bench_file("full", truths=truths | {"rotation_stage.start": "5 deg"}, clock=20)
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        world = served.world
        begun = world.clock.now()
        refused, tilted = 0, 0
        with connect(tmp_path / "served.yaml") as connected:
            under_way = {
                name: connected.axes[name].home() for name in ("array_stage", "sensor_stage")
            }
            wait_all(*under_way.values(), timeout=20)
            under_way |= {
                name: connected.axes[name].home() for name in ("goniometer", "rotation_stage")
            }
            generator = np.random.default_rng(11)
            for _ in range(60):
                name = list(under_way)[generator.integers(4)]
                axis = connected.axes[name]
                with contextlib.suppress(MotionError):
                    under_way[name].wait(10)
                low, high = (17.0, 21.0) if axis.coordinate.unit == "mm" else axis.limits
                try:
                    under_way[name] = axis.move_to(float(generator.uniform(low, high)))
                except InterlockError:
                    refused += 1
                    continue
                tilted += axis.coordinate.unit == "rad"
                if generator.random() < 0.1:
                    axis.stop()
            connected.stop()
        instants = np.linspace(begun, world.clock.now(), 20_000)
        least = min(world.gap(float(instant)) for instant in instants)
    assert refused > 3
    assert tilted > 3
    assert bench.description.minimum_gap <= least < 3


def edited(bench: Bench, array: dict[str, Any], **fields: Any) -> Bench:
    """The bench with another array in its camera file, far from the sensor, and other fields in its
    own.
    """
    optics = bench.file.parent / bench.description.optics
    camera, own = (yaml.safe_load(file.read_text()) for file in (optics, bench.file))
    camera["microlens_array"] |= array
    camera["sensor"]["distance"] = "65 mm"
    optics.write_text(yaml.safe_dump(camera))
    bench.file.write_text(yaml.safe_dump(own | fields, sort_keys=False))
    return read_bench(bench.file)


@pytest.mark.parametrize(
    ("array", "doubt", "truths"),
    [
        ({"offset": ["3 mm", "-4 mm"], "tilt": ["6 deg", "-8 deg"]}, {}, {}),
        (
            {},
            {"array_tilt": "20 mrad"},
            {"microlens_array.yaw": "-50 mrad", "microlens_array.pitch": "55 mrad"},
        ),
        ({"tilt": ["8 deg", "8 deg"]}, {"pitch": 0.1, "microlens_aperture": 0.01}, {}),
    ],
    ids=[
        "decentred and tilted",
        "tilted by as much as the file doubts",
        "larger by as much as the file doubts",
    ],
)
def test_a_sensor_that_goes_as_far_as_it_may_keeps_the_gap_to_every_microlens_that_the_camera_sees(
    write_bench_file: WriteBench,
    tmp_path: Path,
    array: dict[str, Any],
    doubt: dict[str, Any],
    truths: dict[str, str],
) -> None:
    write_bench_file(
        clock=1000,
        truths={f"{axis}_stage.zero": "0 mm" for axis in ("array", "sensor")} | truths,
        seed=203,
    )
    bench = edited(
        read_bench(tmp_path / "bench.yaml"),
        array,
        optics_uncertainty={"array_tilt": "0 rad"} | doubt,
    )
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        with connect(tmp_path / "served.yaml") as connected:
            array_stage, sensor_stage = connected.array_stage, connected.sensor_stage
            wait_all(array_stage.home(), sensor_stage.home())
            array_stage.move_to(10.0).wait()
            with pytest.raises(InterlockError) as refused:
                sensor_stage.move_to(29.99)
            far = re.search(r"Farthest allowed: (\d+\.\d+) mm", str(refused.value))
            assert far is not None
            sensor_stage.move_to(float(far[1])).wait()
        now = served.world.clock.now()
        camera = served.world.scene(now).camera
        gap = served.world.gap(now)
    assert camera is not None
    lenses = float(camera_smms(camera).gap.min())
    assert bench.description.minimum_gap <= gap <= lenses


def without(file: Path, *names: str, **fixed: Any) -> Path:
    """A copy of a bench file that leaves out axes, and states where things stand."""
    data = yaml.safe_load(file.read_text(encoding="utf-8"))
    for name in names:
        del data["axes"][name]
    other = file.with_name("partial.yaml")
    other.write_text(yaml.safe_dump(data | {"fixed": fixed}, sort_keys=False), encoding="utf-8")
    return other


@pytest.mark.parametrize(
    ("example", "missing", "moved", "towards"),
    [
        ("simulated", ["sensor_stage"], "array_stage", 19.0),
        ("simulated", ["array_stage"], "sensor_stage", 25.0),
        ("full", ["goniometer"], "sensor_stage", 15.2),
    ],
    ids=["no sensor axis", "no array axis", "no axis of a tilt"],
)
def test_what_a_bench_file_leaves_out_may_be_anywhere_until_it_is_stated(
    write_bench_file: WriteBench,
    tmp_path: Path,
    example: str,
    missing: list[str],
    moved: str,
    towards: float,
) -> None:
    """The whole file puts the element that the partial one leaves out into the way."""
    bench = write_bench_file(example, clock=100)
    with serve(bench) as served:
        file = tmp_path / "served.yaml"
        write_bench(bench, served, file)
        with connect(file) as whole:
            wait_all(*(whole.axes[name].home() for name in ("array_stage", "sensor_stage")))
            if example == "full":
                whole.goniometer.home().wait(20)
                whole.array_stage.move_to(22.5).wait(20)
                whole.goniometer.move_to(whole.goniometer.limits[1]).wait(20)
            else:
                other = "sensor_stage" if moved == "array_stage" else "array_stage"
                whole.axes[other].move_to(25.0).wait(20)
        with connect(without(file, *missing)) as partial:
            with pytest.raises(InterlockError, match=r"state where it stands in .* `fixed: \{"):
                partial.axes[moved].move_to(towards)
            partial.axes[moved].move_to(0.0).wait(20)
        assert served.world.gap(served.world.clock.now()) >= bench.description.minimum_gap


@contextlib.contextmanager
def served_with_sensor_at(place: float, bench: Bench, file: Path) -> Generator[Served]:
    """A bench served, its file written, its sensor's stage moved to a place (mm)."""
    with serve(bench) as served:
        write_bench(bench, served, file)
        with connect(file) as whole:
            wait_all(*(whole.axes[name].home() for name in ("array_stage", "sensor_stage")))
            whole.sensor_stage.move_to(place).wait(20)
        yield served


def test_what_is_stated_to_stand_somewhere_is_kept_clear_of_with_its_uncertainty(
    write_bench_file: WriteBench, tmp_path: Path
) -> None:
    bench, file = write_bench_file(clock=100), tmp_path / "served.yaml"
    with served_with_sensor_at(20.2, bench, file) as served:  # 59.8 mm, stated 0.2 mm off
        stated = without(
            file, "sensor_stage", **{"sensor.z": {"at": "60 mm", "uncertainty": "0.1 mm"}}
        )
        with connect(stated) as partial:
            with pytest.raises(InterlockError) as refused:
                partial.array_stage.move_to(19.8)
            far = re.search(r"Farthest allowed: (\d+\.\d+) mm", str(refused.value))
            assert far is not None
            partial.array_stage.move_to(float(far[1])).wait(20)
        gap = served.world.gap(served.world.clock.now())
    assert bench.description.minimum_gap <= gap < 0.6


@pytest.mark.ci
def test_beside_real_axes_a_simulated_one_keeps_nothing_out_of_the_way(
    write_bench_file: WriteBench, tmp_path: Path
) -> None:
    """The sensor's stage is out for repair and simulated meanwhile; the sensor is in the way."""
    bench, file = write_bench_file(clock=100), tmp_path / "served.yaml"
    with served_with_sensor_at(25.0, bench, file) as served:
        data = yaml.safe_load(file.read_text(encoding="utf-8"))
        data["axes"]["sensor_stage"]["address"] = "simulated"
        mixed = tmp_path / "mixed.yaml"
        mixed.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
        with connect(mixed) as partial:
            partial.sensor_stage.home().wait(20)
            with pytest.raises(
                InterlockError,
                match=r"sensor_stage is simulated, and nothing says where sensor\.z really stands",
            ):
                partial.array_stage.move_to(19.0)
            partial.array_stage.move_to(0.0).wait(20)
        stated = data | {"fixed": {"sensor.z": {"at": "55 mm", "uncertainty": "0.1 mm"}}}
        mixed.write_text(yaml.safe_dump(stated, sort_keys=False), encoding="utf-8")
        with connect(mixed) as partial:
            partial.sensor_stage.home().wait(20)
            partial.sensor_stage.move_to(1.0).wait(20)
            with pytest.raises(InterlockError, match="the sensor, which nothing moves"):
                partial.array_stage.move_to(15.0)
            partial.array_stage.move_to(14.0).wait(20)
        gap = served.world.gap(served.world.clock.now())
    assert bench.description.minimum_gap <= gap < 1.1


def changed(file: Path, **fields: Any) -> Bench:
    """The bench file with other fields; an axis keeps what is not given of it."""
    data = yaml.safe_load(file.read_text(encoding="utf-8"))
    for name, axis in fields.pop("axes", {}).items():
        data["axes"][name] |= axis
    file.write_text(yaml.safe_dump(data | fields, sort_keys=False), encoding="utf-8")
    return read_bench(file)


LONG = {"main_lens_stage": {"limits": ["0 mm", "75 mm"]}}  # its travel ends behind the array's


@pytest.mark.ci
def test_the_main_lens_and_the_array_never_meet_homing_included(
    write_bench_file: WriteBench, tmp_path: Path
) -> None:
    bench = changed(write_bench_file(clock=100).file, axes=LONG)
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        world, refused = served.world, 0
        begun = world.clock.now()
        with connect(tmp_path / "served.yaml") as connected:
            with pytest.raises(
                InterlockError, match=r"between main lens and array.*main_lens_stage,"
            ):
                connected.array_stage.home()
            for step in home_steps(bench):
                wait_all(*(connected.axes[name].home() for name in step.axes), timeout=20)
            generator = np.random.default_rng(3)
            for _ in range(40):
                name, most = (("main_lens_stage", 75.0), ("array_stage", 30.0))[
                    generator.integers(2)
                ]
                try:
                    connected.axes[name].move_to(float(generator.uniform(0, most))).wait(10)
                except InterlockError:
                    refused += 1
        instants = np.linspace(begun, world.clock.now(), 20_000)
        least = min(world.lens_gap(float(instant)) for instant in instants)
    assert refused > 3
    assert bench.description.minimum_gap <= least < 5


def test_gaps_are_kept_from_metal_to_metal(write_bench_file: WriteBench, tmp_path: Path) -> None:
    bench = changed(
        write_bench_file(clock=100).file,
        axes=LONG,
        envelopes={
            "main_lens": {"rear": "12 mm"},
            "array": {"front": "1 mm", "rear": "0.6 mm", "radius": "12 mm"},
            "sensor": {"front": "0.7 mm"},
        },
        minimum_gap={"array-sensor": "0.3 mm", "lens-array": "2 mm"},
    )

    def as_far_as_it_may(axis: Axis, end: float) -> None:
        with pytest.raises(InterlockError) as refused:
            axis.move_to(end)
        far = re.search(r"Farthest allowed: (\d+\.\d+) mm", str(refused.value))
        assert far is not None
        axis.move_to(float(far[1])).wait(20)

    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        with connect(tmp_path / "served.yaml") as connected:
            for step in home_steps(bench):
                wait_all(*(connected.axes[name].home() for name in step.axes), timeout=20)
            as_far_as_it_may(connected.main_lens_stage, 70.0)
            as_far_as_it_may(connected.array_stage, 40.0)
        now = served.world.clock.now()
        gap, lens_gap = served.world.gap(now), served.world.lens_gap(now)
        places = served.world.elements(now)
    assert 0.3 <= gap < 0.5
    assert places["sensor.z"] - places["array.z"] > 0.3 + 0.6 + 0.7
    assert lens_gap >= 40
    assert places["array.z"] - places["main_lens.z"] > 12 + 1 + 2


def test_a_target_is_kept_clear_of_the_main_lens_where_that_is_asked_for(
    write_bench_file: WriteBench, tmp_path: Path
) -> None:
    bench = changed(
        write_bench_file(clock=100).file,
        axes={"target_stage": {"zero": "-160 mm"}},
        envelopes={"target": {"rear": "5 mm"}, "main_lens": {"front": "15 mm"}},
        minimum_gap={"array-sensor": "0.3 mm", "target-lens": "2 mm"},
    )
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        with connect(tmp_path / "served.yaml") as connected:
            for step in home_steps(bench):
                wait_all(*(connected.axes[name].home() for name in step.axes), timeout=20)
            connected.target_stage.move_to(127.7).wait(20)
            with pytest.raises(InterlockError, match="between target and main lens"):
                connected.target_stage.move_to(128.1)
