"""Where clients come in: a Unix socket for python-can, a pseudo-terminal and TCP for SLCAN."""

import fcntl
import os
import select
import socket
import tty
from collections.abc import Callable
from pathlib import Path

from mdms_sim.serve import packet

LOOPBACK = "127.0.0.1"
_SOCKET_MODE = 0o600
_FOLDER_MODE = 0o700


class ServeError(Exception):
    """A way in cannot be opened."""


def listen_unix(channel: str) -> socket.socket:
    """A listening socket that only this user can connect to. Raises ServeError."""
    path = packet.socket_path(channel)
    if "/" not in channel:
        path.parent.mkdir(mode=_FOLDER_MODE, parents=True, exist_ok=True)
        if path.parent.stat().st_uid != os.getuid():
            raise ServeError(f"{path.parent} belongs to somebody else; set XDG_RUNTIME_DIR")
    if path.exists():
        _remove_dead(path)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    # Nobody may slip in between the file's appearing and its mode.
    before = os.umask(0o777 - _SOCKET_MODE)
    try:
        listener.bind(str(path))
    except OSError as error:
        listener.close()
        raise ServeError(f"cannot serve at {path}: {error}") from error
    finally:
        os.umask(before)
    listener.listen()
    listener.setblocking(False)
    return listener


def _remove_dead(path: Path) -> None:
    """Remove the socket of a server that is no more; raises ServeError for a live one."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink(missing_ok=True)
            return
    raise ServeError(f"{path} is in use; choose another name with --name")


def listen_tcp(port: int) -> socket.socket:
    """A listening socket on loopback; port 0 takes a free one. Raises ServeError."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((LOOPBACK, port))
    except OSError as error:
        listener.close()
        raise ServeError(f"cannot listen on {LOOPBACK}:{port}: {error}") from error
    listener.listen()
    listener.setblocking(False)
    return listener


class Terminal:
    """A pseudo-terminal in raw mode: `name` is what a client opens like a serial port."""

    def __init__(self) -> None:
        self.descriptor, self._client_end = os.openpty()
        tty.setraw(self.descriptor)
        tty.setraw(self._client_end)
        flags = fcntl.fcntl(self.descriptor, fcntl.F_GETFL)
        fcntl.fcntl(self.descriptor, fcntl.F_SETFL, flags | os.O_NONBLOCK)
        self.name = os.ttyname(self._client_end)
        self._ends = select.poll()
        for end in (self.descriptor, self._client_end):
            self._ends.register(end, select.POLLIN)

    def settle(self) -> None:
        """Return once all that either end has written has reached the other.

        A worker of the kernel carries it over, and gets no turn for 0.2 s on a busy machine.
        """
        # Unlike epoll, poll waits for that worker before it says that an end has nothing to read.
        self._ends.poll(0)

    def close(self) -> None:
        """Hang up."""
        # The client's end was kept open so that a client that leaves does not end the line.
        os.close(self._client_end)
        os.close(self.descriptor)


def accept(listener: socket.socket, admit: Callable[[socket.socket], object]) -> None:
    """Admit whoever is waiting at the door."""
    try:
        connection, _ = listener.accept()
    except (BlockingIOError, ConnectionError):
        return
    connection.setblocking(False)
    admit(connection)
