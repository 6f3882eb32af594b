"""The same search on a Dask cluster: chunks go out, their fronts come back, and a worker that is
lost costs only its chunk.
"""

from collections.abc import Iterator
from pathlib import Path

from flflab.design.chunk_log import Chunk, Found
from flflab.design.grid import make_grid
from flflab.design.requirements import Requirements
from flflab.design.search import Progress, gathered, search_chunk
from flflab.workers import connected, on_cluster


def search_on_cluster(
    wanted: Requirements, address: str, log: Path | None = None, progress: Progress | None = None
) -> Found:
    """Search with the workers of a Dask scheduler; arguments and result as
    ``flflab.design.search.search``.

    Args:
        wanted: the requirements.
        address: of the scheduler, for instance ``tcp://127.0.0.1:8786``; its workers must have this
            package.
        log: where every chunk's result is written.
        progress: called with the configurations done and their number.

    Raises:
        InputError: Dask is not installed, or no scheduler answers at the address; and as
            ``search``.
    """
    grid = make_grid(wanted)
    with connected(address) as client:

        def run(todo: list[Chunk]) -> Iterator[Found]:
            return on_cluster(client, search_chunk, ((wanted, grid, *chunk, 1) for chunk in todo))

        return gathered(wanted, grid, run, log, progress)
