"""A plug-in of pytest: what every axis and bench promises, asked of one driver on its simulated
instrument, or of a whole bench, simulated or real.

    pytest -p drivers.contract --flflab-axis acme --flflab-keys "socket: 1"
    pytest -p drivers.contract --flflab-bench my-bench.yaml

``promises`` asks one thing after the other and moves each axis by a quarter of its travel at most;
``faults`` shows simulated axes every fault that their simulator knows. Without one of the two
options the plug-in does nothing.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.base import Axis, wait_all
from drivers.bench import ConnectedBench, connect
from drivers.contract.written import AXIS, asked_for, write_bench
from drivers.interlocks import homing_groups
from flflab.bench import Bench, read_bench
from flflab.errors import FlflabError

HERE = Path(__file__).resolve().parent
BY_HAND = "manual"  # a person is not tested
HOMING_S = 600.0
FAULTS = 100  # of a driver; of a bench as many as are asked for


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options."""
    group = parser.getgroup("flflab", "what axes and benches of flflab promise")
    group.addoption("--flflab-axis", metavar="DRIVER", help="a driver of axes, simulated")
    group.addoption(
        "--flflab-keys", metavar="YAML", default="", help="its own keys: 'socket: 1, step: 2 um'"
    )
    group.addoption(
        "--flflab-bench", metavar="FILE", help="a bench file: every axis of it moves, be there"
    )
    group.addoption(
        "--flflab-faults",
        metavar="N",
        type=int,
        help=f"faults shown to simulated axes: {FAULTS} with --flflab-axis, else none",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Have the suites collected, alone or beside what the command line names."""
    axis, bench = config.getoption("--flflab-axis"), config.getoption("--flflab-bench")
    if not axis and not bench:
        return
    if axis and bench:
        raise pytest.UsageError("give --flflab-axis or --flflab-bench, one of them")
    faults: int | None = config.getoption("--flflab-faults")
    config.option.flflab_faults = faults = faults if faults is not None else FAULTS if axis else 0
    suites = [str(HERE / "promises.py")]
    if faults > 0:
        suites.append(str(HERE / "faults.py"))
    named = config.args if config.args_source is pytest.Config.ArgsSource.ARGS else []
    config.args = [*named, *suites]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Every axis of the bench in turn, or the driver's."""
    if "axis" not in metafunc.fixturenames or not asked_for(metafunc.config):
        return
    bench = metafunc.config.getoption("--flflab-bench")
    try:
        names = _moved_by_motors(read_bench(Path(bench))) if bench else [AXIS]
    except FlflabError as error:
        raise pytest.UsageError(str(error)) from error
    metafunc.parametrize("axis", names, indirect=True)


def _moved_by_motors(bench: Bench) -> list[str]:
    axes = bench.description.axes
    return [name for name, axis in axes.items() if axis.driver != BY_HAND]


@pytest.fixture(scope="module")
def bench_file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bench file that was given, or one written for the driver."""
    given = request.config.getoption("--flflab-bench")
    return Path(given) if given else write_bench(request.config, tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def bench(bench_file: Path) -> Iterator[ConnectedBench]:
    """The bench, every axis with a motor homed."""
    with connect(bench_file) as connected:
        motors = _moved_by_motors(connected.described)
        for group in homing_groups(connected.described):
            homing = [connected.axes[name].home() for name in group if name in motors]
            wait_all(*homing, timeout=HOMING_S)
        yield connected


@pytest.fixture
def axis(request: pytest.FixtureRequest, bench: ConnectedBench) -> Iterator[Axis]:
    """An axis, which goes back to where it stood."""
    asked: Any = request.param
    found = bench.axes[asked]
    low, high = found.limits
    start = min(max(found.position(), low), high)
    yield found
    if not found.is_moving() and found.is_homed():
        found.move_to(start).wait(HOMING_S)
