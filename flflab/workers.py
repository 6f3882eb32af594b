"""Many calls of one function: on a Dask scheduler's workers, or on this machine's cores; the same
results either way.
"""

import contextlib
import multiprocessing
import os
import socket
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import islice
from multiprocessing import connection
from typing import Any, TypeVar

from flflab.errors import InputError

Result = TypeVar("Result")
PATIENCE = "10s"
LISTENS_S = 5.0
DASK_PORT = 8786
AHEAD = (
    4  # calls a worker thread has waiting: enough to keep it busy, few enough to keep memory small
)
RETRIES = 5
FEW = 8  # calls that are done sooner here than other processes have started


def results(
    function: Callable[..., Result], calls: Iterable[tuple[Any, ...]], scheduler: str | None
) -> Iterator[Result]:
    """What the function returns for each tuple of arguments, in the order they are ready.

    Args:
        function: of a module, so that other processes find it.
        calls: the arguments.
        scheduler: address of a Dask scheduler; None takes this machine's cores.

    Raises:
        InputError: Dask is not installed, or no scheduler answers at the address.
    """
    todo = list(calls)
    if scheduler is not None:
        with connected(scheduler) as client:
            yield from on_cluster(client, function, todo)
    elif len(todo) <= FEW:
        yield from (function(*call) for call in todo)
    else:
        yield from _on_this_machine(function, todo)


def _on_this_machine(
    function: Callable[..., Result], calls: list[tuple[Any, ...]]
) -> Iterator[Result]:
    # Started afresh: a fork would copy the threads' locks of the process that asks.
    afresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(mp_context=afresh, initializer=_end_with_the_parent) as pool:
        try:
            for future in as_completed([pool.submit(function, *call) for call in calls]):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _end_with_the_parent() -> None:
    """Let this worker end when the program that started it does, however it ends: the pool itself
    ends its workers only where it can still speak to them.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)  # what a worker computes nobody waits for any more

    threading.Thread(target=watch, name="watch the parent", daemon=True).start()


@contextlib.contextmanager
def connected(scheduler: str) -> Generator[Any]:
    """A client of a Dask scheduler.

    Args:
        scheduler: its address, for instance ``tcp://127.0.0.1:8786``; its workers must have this
            package.

    Raises:
        InputError: Dask is not installed, or no scheduler answers at the address.
    """
    try:
        from dask.distributed import Client
    except ImportError as error:
        raise InputError("--scheduler needs Dask; install flflab's extra 'cluster'") from error
    try:
        with socket.create_connection(_host_and_port(scheduler), timeout=LISTENS_S):
            pass  # a client that found nobody would wait twenty seconds more and end in a traceback
        client: Any = Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there within {PATIENCE}; start"
            " one, or leave the option out"
        ) from error
    try:
        yield client
    finally:
        client.close()


def _host_and_port(scheduler: str) -> tuple[str, int]:
    from distributed.comm.addressing import parse_address, parse_host_port

    host, port = parse_host_port(parse_address(scheduler)[1], DASK_PORT)
    return str(host), int(port)


def on_cluster(
    client: Any, function: Callable[..., Result], calls: Iterable[tuple[Any, ...]]
) -> Iterator[Result]:
    """As ``results`` by a client's workers; a worker that is lost costs only what it was at."""
    from dask.distributed import as_completed as completed_on

    waiting = iter(calls)
    threads = max(sum(client.nthreads().values()), 1)

    def send(count: int) -> list[Any]:
        return [
            client.submit(function, *call, pure=False, retries=RETRIES)
            for call in islice(waiting, count)
        ]

    under_way: Any = completed_on(send(AHEAD * threads), loop=client.loop)
    for future in under_way:
        found: Result = future.result()
        future.release()
        under_way.update(send(1))
        yield found
