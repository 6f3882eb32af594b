"""What every test gets: a folder for compiled kernels, the published measurements, and a look at
what was left running.
"""

import contextlib
import getpass
import importlib
import multiprocessing
import os
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

os.environ.setdefault(
    "NUMBA_CACHE_DIR", str(Path(tempfile.gettempdir()) / f"flflab-kernels-{getpass.getuser()}")
)
from flflab.kernel_cache import use_kernel_cache

if TYPE_CHECKING:
    from bluesky import RunEngine

FEW_KERNELS = 80  # of those that tests use
ROOT = Path(__file__).resolve().parent.parent
pytest.register_assert_rewrite("drivers.contract")

use_kernel_cache()  # before anything imports numba; child processes inherit it
settings.register_profile(
    "flflab", deadline=None, derandomize=True
)  # the first example may compile a kernel
settings.load_profile("flflab")
if os.name == "posix":
    # one process for the whole session, started here so that no test seems to leave it behind
    resource_tracker.ensure_running()


def find_r12a() -> Path | None:
    given = os.environ.get("FLFLAB_R12A")
    folder = Path(given) if given else ROOT.parent / "shared" / "data" / "r12a"
    return folder if (folder / "camera.json").is_file() else None


def pytest_configure(config: pytest.Config) -> None:
    """Kernels are compiled once, before several workers would each compile them."""
    shared = bool(getattr(config.option, "numprocesses", None)) and not hasattr(
        config, "workerinput"
    )
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    if shared and len(list(folder.rglob("*.nbi"))) < FEW_KERNELS:
        run = "import first_kernels; first_kernels."
        halves = [
            subprocess.Popen([sys.executable, "-c", f"{run}{half}()"], cwd=ROOT / "tests")
            for half in ("pictures", "measurements")
        ]
        for one in halves:
            one.wait()  # what fails there fails in the tests


def pytest_report_header() -> str:
    return (
        "r12a:"
        f" {find_r12a() or 'not here (set FLFLAB_R12A); the tests that need these measurements are deselected'}"  # noqa: E501
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if find_r12a() is not None:
        return
    without = [item for item in items if item.get_closest_marker("r12a") is None]
    config.hook.pytest_deselected(items=[item for item in items if item not in without])
    items[:] = without


@pytest.fixture(scope="session")
def r12a() -> Path:
    """The folder of the published R12 measurements; a test that uses it is marked ``r12a``."""
    folder = find_r12a()
    assert folder is not None, "mark this test with @pytest.mark.r12a"
    return folder


@pytest.fixture(scope="session", autouse=True)
def temporary_files_of_their_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What a test leaves among the temporary files, and the lock files of programs that a test
    killed, are not left behind.
    """
    from drivers import locks  # tests of the model alone need no drivers

    def notes() -> set[Path]:
        return set(locks.folder().glob(f"{locks.PREFIX}*.{locks.user()}.*"))

    before = notes()  # a bench of this machine's own may have a lost axis
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("temporary")
        patch.setenv("TMPDIR", str(folder))
        patch.setattr(tempfile, "tempdir", str(folder))
        yield
    for file in notes() - before:
        if not locks.locked(file.with_suffix(locks.LOCK)):
            with contextlib.suppress(OSError):  # another run of these tests leaves strange ones
                file.unlink()


class Forwarder:
    """Another address of a TCP server, as another computer or a converter would have it."""

    def __init__(self, address: str) -> None:
        host, _, port = address.removeprefix("socket://").rpartition(":")
        self._to = host, int(port)
        self._over = False
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        ends: dict[socket.socket, socket.socket] = {}
        while not self._over:
            for ready in select.select([self._server, *ends], [], [], 0.05)[0]:
                with contextlib.suppress(OSError):
                    if ready is self._server:
                        here, there = self._server.accept()[0], socket.create_connection(self._to)
                        ends |= {here: there, there: here}
                    elif ready in ends:
                        more = ready.recv(4096)
                        if more:
                            ends[ready].sendall(more)
                            continue
                        other = ends.pop(ready)
                        del ends[other]
                        ready.close()
                        other.close()
        for end in ends:
            end.close()
        self._server.close()

    def end(self) -> None:
        """Leave no thread and no connection."""
        self._over = True
        self._thread.join()


@pytest.fixture
def other_address() -> Iterator[Callable[[str], str]]:
    """Gives a TCP address another one, which nothing shows to be the same."""
    with contextlib.ExitStack() as ends:

        def forward(address: str) -> str:
            forwarder = Forwarder(address)
            ends.callback(forwarder.end)
            return forwarder.address

        yield forward


@pytest.fixture(scope="session")
def trace_pixels() -> Callable[..., Any]:
    """The slow reference of pictures, by rays refracted one by one; it lies beside the
    benchmarks.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "benchmarks")
        return importlib.import_module("reference_rays.pixels").trace_pixels


@pytest.fixture(scope="session")
def random_scene() -> Callable[..., Any]:
    """Draws a random scene of a random camera."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "benchmarks")
        return importlib.import_module("reference_rays.random_scene").random_scene


@pytest.fixture(scope="session")
def root() -> Path:
    """The project's folder."""
    return ROOT


@pytest.fixture
def engine() -> Iterator["RunEngine"]:
    """A RunEngine whose loop ends with the test."""
    from bluesky import RunEngine  # loaded by those who run plans

    engine = RunEngine({}, context_managers=[])
    yield engine
    engine.loop.call_soon_threadsafe(engine.loop.stop)
    engine._th.join()  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
    engine.loop.close()


def _children() -> set[str]:
    """Process numbers of this process's children, ended ones included until they are waited for."""
    lists = Path("/proc/self/task").glob(
        "*/children"
    )  # Linux only; elsewhere what multiprocessing started
    found: set[str] = set()
    for file in lists:
        with contextlib.suppress(OSError):  # of a thread that ended meanwhile
            found |= set(file.read_text().split())
    return found | {str(child.pid) for child in multiprocessing.active_children()}


def _threads() -> set[threading.Thread]:
    return {thread for thread in threading.enumerate() if not thread.daemon}


@pytest.fixture(autouse=True)
def nothing_left_running() -> Iterator[None]:
    """Fails a test that leaves a thread or a child process behind; those of longer-lived fixtures
    were there before.
    """
    threads, children = _threads(), _children()
    yield
    patience = time.monotonic() + 1.0
    while (left := (_threads() - threads, _children() - children)) != (set(), set()):
        if time.monotonic() > patience:
            pytest.fail(
                f"left running: threads {[thread.name for thread in left[0]]}, processes"
                f" {sorted(left[1])}"
            )
        time.sleep(0.01)
