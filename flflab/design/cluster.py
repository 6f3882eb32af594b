"""The same search on a Dask cluster: chunks go out, their fronts come back, and a worker that is lost costs only its chunk."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from flflab.design.chunk_log import Chunk, Found
from flflab.design.grid import make_grid
from flflab.design.requirements import Requirements
from flflab.design.search import Progress, gathered, search_chunk
from flflab.errors import InputError

PATIENCE = "10s"
AHEAD = 4  # chunks a worker thread has waiting: enough to keep it busy, few enough to keep memory small
RETRIES = 5


def search_on_cluster(wanted: Requirements, address: str, log: Path | None = None, progress: Progress | None = None) -> Found:
    """Search with the workers of a Dask scheduler; arguments and result as ``flflab.design.search.search``.

    Args:
        wanted: the requirements.
        address: of the scheduler, for instance ``tcp://127.0.0.1:8786``; its workers must have this package.
        log: where every chunk's result is written.
        progress: called with the configurations done and their number.

    Raises:
        InputError: Dask is not installed, or no scheduler answers at the address; and as ``search``.
    """
    try:
        from dask.distributed import Client, as_completed
    except ImportError as error:
        raise InputError("--scheduler needs Dask; install flflab's extra 'cluster'") from error
    try:
        client: Any = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there within {PATIENCE}; start one, or leave the option out"
        ) from error
    grid = make_grid(wanted)

    def run(todo: list[Chunk]) -> Iterator[Found]:
        waiting = iter(todo)
        threads = max(sum(client.nthreads().values()), 1)

        def send(count: int) -> list[Any]:
            chunks = islice(waiting, count)
            return [client.submit(search_chunk, wanted, grid, *chunk, 1, pure=False, retries=RETRIES) for chunk in chunks]

        under_way: Any = as_completed(send(AHEAD * threads), loop=client.loop)
        for future in under_way:
            found: Found = future.result()
            future.release()
            under_way.update(send(1))
            yield found

    try:
        return gathered(wanted, grid, run, log, progress)
    finally:
        client.close()
