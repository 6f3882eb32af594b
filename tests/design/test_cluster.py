"""The search on a real Dask cluster on loopback, one of whose workers is killed on the way."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from dask.distributed import LocalCluster

from flflab.design.cluster import search_on_cluster
from flflab.design.requirements import Requirements
from flflab.design.search import search
from flflab.errors import InputError

Wanted = Callable[..., Requirements]
pytestmark = [pytest.mark.ci, pytest.mark.filterwarnings("ignore::ResourceWarning")]


@pytest.fixture
def cluster() -> Iterator[Any]:
    made: Any = LocalCluster
    with made(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
    ) as running:
        yield running


def test_a_killed_worker_costs_only_its_chunk(
    wanted: Wanted, cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = wanted(search={"configurations": 2_000_000, "focus_steps": 25, "epsilon": "1 %"})
    monkeypatch.setattr("flflab.design.search.CHUNK", 1 << 16)
    alone = search(asked)
    killed = list[int]()

    def kill_one(done: int, total: int) -> None:
        if not killed and done > total / 4:
            worker = next(iter(cluster.workers.values()))
            killed.append(int(worker.pid))
            os.kill(killed[0], signal.SIGKILL)

    together = search_on_cluster(
        asked, cluster.scheduler_address, tmp_path / "search.jsonl", kill_one
    )
    assert killed
    assert together.front.numbers.tolist() == alone.front.numbers.tolist()
    assert (together.tried, together.built, together.met) == (alone.tried, alone.built, alone.met)
    assert len(set(together.chunks)) == len(together.chunks) == len(alone.chunks)


def test_a_scheduler_that_is_not_there_is_one_sentence(
    wanted: Wanted, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flflab.workers.PATIENCE", "1s")
    with pytest.raises(InputError, match="no Dask scheduler answers there"):
        search_on_cluster(wanted(), "tcp://127.0.0.1:1")
    with pytest.raises(InputError, match="no Dask scheduler answers there"):
        search_on_cluster(wanted(), "nonsense://1")
