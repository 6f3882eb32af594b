"""Many runs measured again, and many configurations simulated, on this machine's cores and on a
Dask cluster: the same numbers.
"""

import gc
import operator
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import pytest
import yaml
from dask.distributed import LocalCluster

from flflab.bench import read_bench
from flflab.cli.many_runs import Analysed, analyse
from flflab.cli.run import run_study
from flflab.errors import InputError
from flflab.study import read_study
from flflab.verdict.expectation import expect_all
from flflab.workers import results
from procedures.study import tell_nobody

Write = Callable[..., tuple[Path, Path]]
Found = TypeVar("Found")
cluster_test = pytest.mark.filterwarnings("ignore::ResourceWarning")


@pytest.fixture
def cluster() -> Iterator[str]:
    made: Any = LocalCluster
    with made(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
    ) as running:
        yield running.scheduler_address


@pytest.mark.timeout(1800)
@cluster_test
@pytest.mark.parametrize(
    ("distances", "arrays", "f_numbers"),
    [
        pytest.param(4, 1, [4], marks=pytest.mark.full),
        pytest.param(25, 10, [2.8, 3.5, 4, 5.6], marks=pytest.mark.full),
    ],
    ids=["four", "thousand"],
)
def test_a_simulated_sweep_gives_the_same_numbers_on_cores_and_on_a_cluster(
    distances: int, arrays: int, f_numbers: list[float], write: Write, cluster: str
) -> None:
    grid = {
        "f_number": f_numbers,
        "distance": [f"{480 + 60 * k / distances} mm" for k in range(distances)],
        "array": [f"{60 + 0.1 * k} mm" for k in range(arrays)],
    }  # fmt: skip
    bars = {"kind": "bars", "width": "12 mm", "height": "8 mm"}
    study_file, bench_file = write(
        study={"configurations": [grid], "mtf_standard_uncertainty": 0.0005, "bars": bars}
    )
    with_small_pixels(bench_file.with_name("camera.yaml"))
    bench = read_bench(bench_file)
    study = read_study(study_file, bench.optics)
    here, there = (
        sorted(
            timed(
                f"{len(study.configurations)} configurations", expect_all(study, bench, scheduler)
            ),
            key=lambda one: one.configuration,
        )
        for scheduler in (None, cluster)
    )
    assert [one.configuration for one in here] == list(range(distances * arrays * len(f_numbers)))
    assert here == there
    assert sum(bool(one.looks) for one in here) > 0.9 * len(
        here
    )  # at some places bars are too blurred to be measured
    assert all(one.looks or one.why for one in here)


def timed(what: str, found: Iterator[Found]) -> list[Found]:
    """Everything, with the time it took printed."""
    began = time.monotonic()
    everything = list(found)
    print(f"{what}: {time.monotonic() - began:.0f} s")
    return everything


def with_small_pixels(camera: Path) -> None:
    """A sensor on which bars can be measured."""
    described = yaml.safe_load(camera.read_text())
    described["sensor"] |= {"resolution": [760, 560], "pixel": "1.66 um"}
    camera.write_text(yaml.safe_dump(described))


@pytest.mark.ci
def test_many_calls_are_spread_over_processes_and_few_stay_here() -> None:
    assert sorted(results(operator.mul, [(2, number) for number in range(20)], None)) == [
        2 * number for number in range(20)
    ]
    processes = list(results(os.getpid, [() for _ in range(20)], None))
    assert len(processes) == 20
    assert os.getpid() not in processes
    assert [*results(os.getpid, [(), ()], None)] == [os.getpid(), os.getpid()]


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "no host", "tcp://", "127.0.0.1:port"])
def test_a_scheduler_that_is_not_there_is_one_sentence(
    address: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match="no Dask scheduler answers there"):
        list(results(operator.neg, [(1,)], address))
    gc.collect()
    assert capfd.readouterr().err == ""


@pytest.mark.timeout(3600)
@cluster_test
@pytest.mark.full
def test_a_hundred_runs_measured_again_give_the_same_tables_and_verdicts_here_and_on_a_cluster(
    write: Write, cluster: str, tmp_path: Path
) -> None:
    """Every run is of another bench, so that none may be taken for another."""
    study, bench = write(
        study={"configurations": [{"f_number": 4, "distance": ["500 mm", "507 mm"]}], "draws": 450},
        clock=1000,
    )
    with_small_pixels(tmp_path / "camera.yaml")
    folders = [tmp_path / "runs" / str(seed) for seed in range(100)]
    timed(
        "taking them",
        (
            run_study(study, bench, folder, seed, tell_nobody, "sweep")
            for seed, folder in enumerate(folders)
        ),
    )
    found: list[list[tuple[Analysed, bytes]]] = []
    for scheduler in (None, cluster):
        for folder in folders:
            (folder / "comparison.csv").unlink(missing_ok=True)
        analysed = sorted(timed("100 runs", results(analyse, list(enumerate(folders)), scheduler)))
        found.append(
            [
                (one, (folder / "comparison.csv").read_bytes())
                for one, folder in zip(analysed, folders, strict=True)
            ]
        )
    here, there = found
    assert here == there
    assert [one.folder for one, _ in here] == folders
    assert len({table for _, table in here}) == 100
