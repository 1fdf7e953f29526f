"""Where clients come in: a Unix socket for python-can, a pseudo-terminal and TCP for SLCAN."""

import errno
import os
import select
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mdms_sim.serve import packet

try:
    import fcntl
    import termios
    import tty
except ImportError:
    # Windows has none; `refuse_elsewhere` says so.
    fcntl = termios = tty = None  # type: ignore[assignment]

LOOPBACK = "127.0.0.1"
#: Errors of `accept` when the process or the machine can open nothing more.
_NO_ROOM = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))
_SOCKET_MODE = 0o600
_FOLDER_MODE = 0o700
_BACKLOG = 128


class ServeError(Exception):
    """A way in cannot be opened."""


def refuse_elsewhere() -> None:
    """Raise `ServeError` on a system without the sockets and terminals that a served bus has."""
    if fcntl is None or not hasattr(socket, "AF_UNIX"):
        raise ServeError(
            "a bus is served by Unix sockets and pseudo-terminals, which this system has not; "
            "serve it on Linux, on macOS or in WSL. `mdms simulate`, `mdms demo --page` and "
            "`mdms run` with an adapter need none"
        )


class UnixListener:
    """A listening socket in the file system that only this user can connect to.

    A socket of this user's that nobody listens at any more is replaced; whatever else has the name
    stays, and raises ServeError.
    """

    def __init__(self, channel: str) -> None:
        self.path = packet.socket_path(channel)
        if "/" not in channel:
            _make_folder(self.path.parent)
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            with _one_at_a_time(self.path.parent):
                _remove_dead(self.path)
                self._bind()
                self._identity = _identity(self.path)
        except OSError as error:
            self.socket.close()
            raise ServeError(f"cannot serve at {self.path}: {error.strerror or error}") from error
        except ServeError:
            self.socket.close()
            raise
        self.socket.setblocking(False)

    def _bind(self) -> None:
        # Nobody may slip in between the file's appearing and its mode.
        before = os.umask(0o777 - _SOCKET_MODE)
        try:
            self.socket.bind(str(self.path))
        finally:
            os.umask(before)
        self.socket.listen(_BACKLOG)

    def close(self) -> None:
        """Close it and remove its file, unless something else has the name by now."""
        # While the socket is open no other file can have its inode.
        with suppress(OSError):
            if _identity(self.path) == self._identity:
                self.path.unlink()
        self.socket.close()


def _make_folder(folder: Path) -> None:
    folder.mkdir(mode=_FOLDER_MODE, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise ServeError(f"{folder} belongs to somebody else; set XDG_RUNTIME_DIR")


@contextmanager
def _one_at_a_time(folder: Path) -> Iterator[None]:
    """Two servers that start at once do not both find the same dead socket. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _identity(path: Path) -> tuple[int, int]:
    status = path.lstat()
    return status.st_dev, status.st_ino


def _remove_dead(path: Path) -> None:
    """Remove this user's socket that nobody listens at; raises ServeError for anything else."""
    try:
        status = path.lstat()
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(status.st_mode):
        raise ServeError(f"{path} is there and is no socket; choose another name with --name")
    if status.st_uid != os.getuid():
        raise ServeError(f"{path} belongs to somebody else; choose another name with --name")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        # A server that is too busy to take the connection is alive as well.
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
        except BlockingIOError:
            pass
    raise ServeError(f"{path} is in use; choose another name with --name")


def listen_tcp(port: int) -> socket.socket:
    """A listening socket on loopback; port 0 takes a free one. Raises ServeError."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    # Connections inherit it: no frame waits for the client to acknowledge the ones before.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    try:
        listener.bind((LOOPBACK, port))
    except OSError as error:
        listener.close()
        raise ServeError(f"cannot listen on {LOOPBACK}:{port}: {error}") from error
    except OverflowError:
        listener.close()
        raise ServeError(
            f"there is no TCP port {port} for a further bus, the last is 65535; give a lower one "
            "with --tcp"
        ) from None
    listener.listen(_BACKLOG)
    listener.setblocking(False)
    return listener


class Terminal:
    """A pseudo-terminal in raw mode: `name` is the path that a client opens like a serial port."""

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

    def forget(self) -> None:
        """Drop all that the client has not read."""
        termios.tcflush(self._client_end, termios.TCIFLUSH)

    def close(self) -> None:
        """Hang up."""
        # The client's end was kept open so that a client that leaves does not end the line.
        os.close(self._client_end)
        os.close(self.descriptor)


class FullError(Exception):
    """A connection was refused: there is no room for it."""


class Acceptor:
    """Accepts connections, or turns them away at once, so that no client waits for an answer.

    One file descriptor is kept back: without any, a connection could not even be refused.
    """

    def __init__(self) -> None:
        self._reserve: int | None = None
        self._keep_reserve()

    def accept(self, listener: socket.socket) -> socket.socket | None:
        """The next connection, None when there is none.

        Raises FullError for a client that had to be turned away.
        """
        try:
            connection, _ = listener.accept()
        except (BlockingIOError, ConnectionError):
            return None
        except OSError as error:
            if error.errno not in _NO_ROOM:
                raise
            self._turn_away(listener)
            raise FullError("no file descriptor is left (ulimit -n)") from error
        connection.setblocking(False)
        return connection

    def close(self) -> None:
        """Give the descriptor back."""
        if self._reserve is not None:
            os.close(self._reserve)
            self._reserve = None

    def _turn_away(self, listener: socket.socket) -> None:
        self.close()
        with suppress(OSError):
            listener.accept()[0].close()
        self._keep_reserve()

    def _keep_reserve(self) -> None:
        with suppress(OSError):
            self._reserve = os.open(os.devnull, os.O_RDONLY)
