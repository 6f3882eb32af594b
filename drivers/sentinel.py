"""A child process that stops every axis of a bench when the process that drives it dies: killed,
crashed, or out of memory.

It holds the reading end of a pipe. The pipe ends when the owner does; what the owner says before
tells whether it let go on purpose.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any

from drivers.described import driver_of, spelt
from flflab.bench import AxisDescription, Bench
from flflab.errors import DeviceError

RELEASED, WATCHING = b"released", b"watching\n"
PATIENCE_S = 5.0
START_S = 20.0


class Sentinel:
    """The child, from the owner's side, as soon as it watches; ``close`` lets it go without a stop.

    Args:
        bench: the bench as read, whatever becomes of its file.
        addresses: where each axis really is.

    Raises:
        DeviceError: it does not start.
    """

    def __init__(self, bench: Bench, addresses: Mapping[str, str]) -> None:
        command = [sys.executable, "-P", "-c", "from drivers.sentinel import main; main()"]
        # A session of its own: what ends the owner's process group must not end its sentinel.
        self._child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        said: list[bytes] = []
        listener = threading.Thread(
            target=lambda: said.append(self._stdout().readline()), name="sentinel", daemon=True
        )
        listener.start()
        try:
            with contextlib.suppress(OSError):
                pickle.dump((bench, dict(addresses)), self._stdin())
                self._stdin().flush()
            listener.join(START_S)
        finally:
            if said != [WATCHING]:  # Ctrl-C, too: nothing moves yet that it would have to stop
                self._child.kill()
                listener.join()
                self.close()
        if said != [WATCHING]:
            raise DeviceError(
                f"{bench.file}: the sentinel that stops the axes when this program dies did not"
                " start; nothing moved"
            )

    def _stdin(self) -> Any:
        return self._child.stdin

    def _stdout(self) -> Any:
        return self._child.stdout

    def watches(self) -> bool:
        """Whether it still lives."""
        return self._child.poll() is None

    def close(self) -> None:
        """Let go: nothing is stopped."""
        try:
            with contextlib.suppress(OSError):
                self._child.communicate(RELEASED, PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()


def stop_axes(bench: Bench, addresses: Mapping[str, str]) -> list[str]:
    """Stop every axis of a bench, all lines at once; none is opened first, since what it refuses
    must not stand in the way of a stop.

    Args:
        bench: the bench file as read.
        addresses: where each axis is; those that are not named are left alone.

    Returns:
        A sentence for each axis that did not take the stop.
    """
    lines: dict[str, list[str]] = {}
    for name, address in addresses.items():
        lines.setdefault(spelt(bench.description.axes[name].driver, address), []).append(name)
    faults: dict[str, str] = {
        name: f"{name}: no answer to the stop; it may still move, cut its power"
        for name in addresses
    }

    def stop_line(names: list[str]) -> None:
        opened: list[Any] = []

        def share(_: str, opener: Callable[[], Any], /) -> Any:
            if not opened:
                opened.append(opener())
            return opened[0]

        for name in names:
            axis: AxisDescription = bench.description.axes[name].model_copy(
                update={"address": addresses[name]}
            )
            try:
                driver = driver_of(bench, name)
                driver.stop(name, axis, bench.own_keys(driver.keys, "axes", name), share)
            except Exception as error:  # whatever it is, the next axis of the line is told too
                why = str(error) if name in str(error) else f"{name}: {error}"
                faults[name] = f"{why}; it may still move, cut its power"
            else:
                del faults[name]
        for line in opened:
            line.close()

    threads = [
        threading.Thread(target=stop_line, args=(names,), daemon=True) for names in lines.values()
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    return list(faults.values())


def main() -> None:
    """Wait for the owner's end; stop every axis unless it let go. Standard input brings the bench
    and the axes' addresses first.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        # from the owner, which started this process
        bench, addresses = pickle.load(sys.stdin.buffer)  # noqa: S301
    except EOFError:  # the owner died before anything moved
        return
    with contextlib.suppress(OSError):  # it died meanwhile
        os.write(sys.stdout.fileno(), WATCHING)
    if sys.stdin.buffer.read() == RELEASED:
        return
    faults = stop_axes(bench, addresses)
    said = faults or ["every axis was told to stop"]
    sys.stderr.write(
        "".join(
            f"flflab: the program that drove {bench.file} is gone; {sentence}\n"
            for sentence in said
        )
    )
