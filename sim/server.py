"""Lines to connect to: TCP on the loopback, or a pseudo terminal; one thread for each client, none
left after ``stop``.
"""

import contextlib
import os
import select
import socket
import threading
import time
from collections.abc import Callable
from typing import Protocol

from flflab.image.bands import GivenUpError, given_up_when

POLL = 0.02  # s between looks for something to say unasked, and for the end


class HangUpError(Exception):
    """Raised by a session to close its line (a cable pulled out); nobody can connect for so many
    seconds.
    """

    def __init__(self, away: float = 0.0) -> None:
        """Pull it out."""
        super().__init__(away)
        self.away = away


class Session(Protocol):
    """One client's conversation with what stands behind a line."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes, return the answer (empty for none); may wait.

        Raises:
            HangUpError: the line is to be closed.
        """
        ...

    def unasked(self) -> bytes:
        """What there is to say without being asked since the last look (alerts)."""
        ...


Open = Callable[[], Session]


class TcpLine:
    """A listening socket on 127.0.0.1; every client has a session of its own."""

    def __init__(self, open_session: Open, port: int = 0) -> None:
        """Listen at once.

        Args:
            open_session: makes the session of a new client.
            port: 0 takes a free one.

        Raises:
            OSError: the port is taken.
        """
        self._open = open_session
        self._ended = threading.Event()
        self._clients: list[threading.Thread] = []
        self._back = 0.0  # when the cable is put back
        self._listener = socket.create_server(("127.0.0.1", port))
        self._listener.settimeout(POLL * 5)
        host, taken = self._listener.getsockname()[:2]
        self.address = f"{host}:{taken}"
        self._accepting = threading.Thread(
            target=self._accept, name=f"line {self.address}", daemon=True
        )
        self._accepting.start()

    def _accept(self) -> None:
        while not self._ended.is_set():
            try:
                client, _ = self._listener.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            if time.monotonic() < self._back:
                client.close()
                continue
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            thread = threading.Thread(
                target=self._serve, args=(client,), name=f"client of {self.address}", daemon=True
            )
            self._clients = [known for known in self._clients if known.is_alive()] + [thread]
            thread.start()

    def _serve(self, client: socket.socket) -> None:
        session = self._open()
        with client, contextlib.suppress(OSError):
            client.settimeout(POLL)
            while not self._ended.is_set() and time.monotonic() >= self._back:
                try:
                    with contextlib.suppress(TimeoutError):
                        data = client.recv(65536)
                        if not data:
                            return
                        with given_up_when(lambda: self._ended.is_set() or has_gone(client)):
                            answer = session.receive(data)
                        _send(client, answer, self._ended)
                    _send(client, session.unasked(), self._ended)
                except HangUpError as pulled:
                    self._back = time.monotonic() + pulled.away
                    return
                except GivenUpError:  # nobody waits for the picture
                    return

    def stop(self) -> None:
        """Close everything and wait for the threads."""
        self._ended.set()
        self._accepting.join()
        self._listener.close()
        for client in self._clients:
            client.join()


def has_gone(client: socket.socket) -> bool:
    """Whether a client has closed its side of the line and said nothing more before."""
    try:
        readable, _, _ = select.select([client], [], [], 0)
        return bool(readable) and not client.recv(1, socket.MSG_PEEK)
    except TimeoutError:
        return False
    except (OSError, ValueError):  # reset, or closed here
        return True


def _send(client: socket.socket, data: bytes, ended: threading.Event) -> None:
    """Send all of it however slowly the client reads, until the line ends."""
    rest = memoryview(data)
    while rest and not ended.is_set():
        with contextlib.suppress(TimeoutError):
            rest = rest[client.send(rest[:1_000_000]) :]


class PtyLine:
    """A pseudo terminal; its path is opened like a serial port. One client at a time, one session
    for all of them.
    """

    def __init__(self, open_session: Open) -> None:
        """Open the pair at once.

        Raises:
            OSError: the system has no pseudo terminals.
        """
        try:
            import tty

            self._master, self._slave = os.openpty()
        except (ImportError, AttributeError) as error:
            raise OSError("this system has no pseudo terminals; serve on TCP instead") from error
        tty.setraw(self._master)
        tty.setraw(self._slave)
        self.address = os.ttyname(self._slave)
        self._ended = threading.Event()
        self._session = open_session()
        self._thread = threading.Thread(
            target=self._serve, name=f"line {self.address}", daemon=True
        )
        self._thread.start()

    def _serve(self) -> None:
        # The slave stays open here: without it a read fails as soon as a client hangs up.
        with contextlib.suppress(OSError):
            while not self._ended.is_set():
                try:
                    if data := self._read(POLL):
                        self._write(self._session.receive(data))
                    self._write(self._session.unasked())
                except HangUpError as pulled:
                    self._ended.wait(pulled.away)
                    self._read(0)  # what was sent meanwhile went nowhere

    def _read(self, patience: float) -> bytes:
        ready, _, _ = select.select([self._master], [], [], patience)
        return os.read(self._master, 65536) if ready else b""

    def _write(self, data: bytes) -> None:
        rest = data
        while rest and not self._ended.is_set():
            _, ready, _ = select.select([], [self._master], [], POLL)
            if ready:
                rest = rest[os.write(self._master, rest[:256]) :]

    def stop(self) -> None:
        """Close the pair and wait for the thread."""
        self._ended.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)
