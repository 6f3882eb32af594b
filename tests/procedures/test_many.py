"""Many runs measured again, and many configurations simulated, on this machine's cores and on a Dask cluster: the same numbers."""

import operator
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from dask.distributed import LocalCluster

from flflab.bench import read_bench
from flflab.cli.report import analyse
from flflab.cli.run import run_study
from flflab.errors import InputError
from flflab.expectation import expect_all
from flflab.study import read_study
from flflab.workers import results
from procedures.study import tell_nobody

Write = Callable[..., tuple[Path, Path]]
cluster_test = pytest.mark.filterwarnings("ignore::ResourceWarning")


@pytest.fixture
def cluster() -> Iterator[str]:
    made: Any = LocalCluster
    with made(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50) as running:
        yield running.scheduler_address


@pytest.mark.ci
@pytest.mark.timeout(300)
@cluster_test
def test_a_simulated_sweep_gives_the_same_numbers_on_cores_and_on_a_cluster(write: Write, cluster: str) -> None:
    places = [f"{480 + 6 * k} mm" for k in range(10)]
    bars = {"kind": "bars", "width": "12 mm", "height": "8 mm"}
    study_file, bench_file = write(
        study={"configurations": [{"f_number": 4, "distance": places}], "mtf_standard_uncertainty": 0.01, "bars": bars}
    )
    with_small_pixels(bench_file.with_name("camera.yaml"))
    bench = read_bench(bench_file)
    study = read_study(study_file, bench.optics)
    here, there = (sorted(expect_all(study, bench, scheduler), key=lambda one: one.configuration) for scheduler in (None, cluster))
    assert len(here) == 10
    assert here == there
    assert all(one.looks for one in here)


def with_small_pixels(camera: Path) -> None:
    """A sensor on which bars can be measured."""
    described = yaml.safe_load(camera.read_text())
    described["sensor"] |= {"resolution": [760, 560], "pixel": "1.66 um"}
    camera.write_text(yaml.safe_dump(described))


@pytest.mark.ci
def test_many_calls_are_spread_over_processes_and_few_stay_here() -> None:
    assert sorted(results(operator.mul, [(2, number) for number in range(20)], None)) == [2 * number for number in range(20)]
    processes = list(results(os.getpid, [() for _ in range(20)], None))
    assert len(processes) == 20
    assert os.getpid() not in processes
    assert [*results(os.getpid, [(), ()], None)] == [os.getpid(), os.getpid()]


def test_a_scheduler_that_is_not_there_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flflab.workers.PATIENCE", "1s")
    with pytest.raises(InputError, match="no Dask scheduler answers there"):
        list(results(operator.neg, [(1,)], "tcp://127.0.0.1:1"))


@pytest.mark.full
@pytest.mark.timeout(600)
@cluster_test
def test_runs_measured_again_give_the_same_tables_and_pages_here_and_on_a_cluster(write: Write, cluster: str, tmp_path: Path) -> None:
    study, bench = write()
    with_small_pixels(tmp_path / "camera.yaml")
    run_study(study, bench, tmp_path / "run", None, tell_nobody, "sweep")
    for place in ("here", "there"):
        for number in range(2):
            shutil.copytree(tmp_path / "run", tmp_path / place / f"{number}" / "run")
    calls = {place: [(number, tmp_path / place / f"{number}" / "run") for number in range(2)] for place in ("here", "there")}
    here, there = list(results(analyse, calls["here"], None)), list(results(analyse, calls["there"], cluster))
    assert sorted((one.number, one.sentences, one.accepted) for one in here) == sorted(
        (one.number, one.sentences, one.accepted) for one in there
    )
    tables = {(tmp_path / place / str(number) / "run" / "comparison.csv").read_bytes() for place in ("here", "there") for number in (0, 1)}
    assert len(tables) == 1
