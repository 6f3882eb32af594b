"""What a bench must do before a run is trusted to it: of the simulated bench every day, of a real
one with ``--hardware BENCH``.

On a real bench this moves things: every axis is homed in the order that the procedures keep, and
each moves over a quarter of its travel at most. Iris and target holder that a person moves are left
alone.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

import drivers
from drivers.base import Axis, wait_all
from drivers.bench import ConnectedBench
from flflab.bench import read_bench
from flflab.errors import LimitError, MotionError
from procedures.steps import home_steps

SHARE = 0.05  # of an axis's travel
LONG_ENOUGH = 0.25  # of it, so that a stop that is late on a busy computer comes on the way
BY_HAND = "manual"


def small_simulated_bench(root: Path, folder: Path) -> Path:
    """The built-in bench with a small sensor, 50 times faster than a real one."""
    optics = yaml.safe_load((root / "examples/cameras/osinski.yaml").read_text(encoding="utf-8"))
    optics["sensor"] |= {"resolution": [64, 48], "pixel": "20 um"}
    (folder / "camera.yaml").write_text(yaml.safe_dump(optics), encoding="utf-8")
    bench = yaml.safe_load((root / "examples/benches/simulated.yaml").read_text(encoding="utf-8"))
    bench["optics"] = "camera.yaml"
    bench["simulated"]["clock"] = 50
    file = folder / "bench.yaml"
    file.write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    return file


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "axis" in metafunc.fixturenames:
        given = (
            metafunc.config.getoption("--hardware")
            or metafunc.config.rootpath / "examples/benches/simulated.yaml"
        )
        metafunc.parametrize("axis", list(read_bench(Path(given)).description.axes), indirect=True)


@pytest.fixture(scope="module")
def bench(
    request: pytest.FixtureRequest, root: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ConnectedBench]:
    """The bench, homed."""
    given = request.config.getoption("--hardware")
    file = Path(given) if given else small_simulated_bench(root, tmp_path_factory.mktemp("bench"))
    with drivers.connect(file) as connected:
        for step in home_steps(connected.described):
            wait_all(*(connected.axes[name].home() for name in step.axes), timeout=600)
        yield connected


@pytest.fixture
def axis(request: pytest.FixtureRequest, bench: ConnectedBench) -> Axis:
    return bench.axes[request.param]


def a_little_inwards(axis: Axis, share: float = SHARE) -> float:
    """A share of the travel from where the axis stands, towards the farther limit."""
    low, high = axis.limits
    here = min(max(axis.position(), low), high)
    return here + share * (high - low) * (1 if high - here > here - low else -1)


def test_every_device_says_who_it_is(bench: ConnectedBench) -> None:
    for row in bench.identities():
        assert row.identity, row


def test_an_axis_that_was_homed_has_a_reference_and_no_warnings(axis: Axis) -> None:
    assert axis.is_homed()
    assert axis.warnings() == ()


def test_an_axis_goes_where_it_is_told_and_says_so(axis: Axis) -> None:
    start, end = axis.position(), a_little_inwards(axis)
    axis.move_to(end).wait(600)
    assert axis.position() == pytest.approx(end, abs=2 * axis.resolution)
    back = min(max(start, axis.limits[0]), axis.limits[1])
    axis.move_to(back).wait(600)
    assert axis.position() == pytest.approx(back, abs=2 * axis.resolution)


def test_an_axis_stopped_on_its_way_stands_between_its_ends(axis: Axis) -> None:
    start, end = axis.position(), a_little_inwards(axis, LONG_ENOUGH)
    motion = axis.move_to(end)
    axis.stop()
    with pytest.raises(MotionError):
        motion.wait(60)
    slack = 2 * axis.resolution
    assert not axis.is_moving()
    assert min(start, end) - slack <= axis.position() <= max(start, end) + slack
    assert axis.is_homed()


def test_beyond_its_limits_an_axis_refuses_and_stays_where_it_is(axis: Axis) -> None:
    before = axis.position()
    for beyond in (axis.limits[0] - 1, axis.limits[1] + 1):
        with pytest.raises(LimitError, match=axis.name):
            axis.move_to(beyond)
    assert not axis.is_moving()
    assert axis.position() == pytest.approx(before, abs=axis.resolution)


def test_the_camera_gives_frames_as_large_and_as_long_as_asked(bench: ConnectedBench) -> None:
    columns, rows = bench.described.optics.sensor.resolution
    shortest, longest = bench.camera.exposure_limits
    means = list[float]()
    for exposure in (max(shortest, 1e-3), min(longest, 2e-2)):
        bench.camera.prepare(exposure)
        frame = bench.camera.grab()
        assert frame.picture.shape == (rows, columns)
        assert frame.exposure_s == pytest.approx(exposure, rel=0.05)
        means.append(float(np.mean(frame.picture)))
    assert means[1] >= means[0] - 1  # longer is not darker


def test_iris_and_target_holder_go_through_what_they_offer(bench: ConnectedBench) -> None:
    description = bench.described.description
    if description.target.driver != BY_HAND:
        for kind in ("white", "four-dot"):
            bench.target.set(kind).wait(120)
            assert bench.target.locate()["readback"] == kind
    if description.iris.driver != BY_HAND:
        for f_number in (2.8, 4.0):
            bench.iris.set(f_number).wait(120)
            assert bench.iris.locate()["readback"] == pytest.approx(f_number, rel=1e-3)
