"""`mdms report`: a running `run` or `serve` writes its last minute as a run folder.

It is asked over a socket that only its user may use. A thread waits for requests, and the driver
of the table carries them out.
"""

import json
import os
import socket
import tempfile
from argparse import Namespace
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import Any

from mdms_host.cli.exits import CommandError, ExitCode

_SUFFIX = ".report"
_LONGEST = 65536
#: A report is written within this, or something is wrong [s].
ANSWER_S = 120.0
#: A client that has come says what it wants within this [s].
_ASKS_S = 2.0
#: When a connection that could not be taken is tried again [s].
_AGAIN_S = 0.1


class Request:
    """A wish for a report, into `folder` if that is not None; answer it by `done`."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.answer: dict[str, Any] = {"error": "the command has ended"}
        self._answered = Event()

    def done(self, path: Path, error: str | None) -> None:
        """The report is there, or is not for that reason."""
        self.answer = {"report": str(path)} if error is None else {"error": error}
        self._answered.set()

    def wait(self, timeout_s: float) -> None:
        """Wait for the answer."""
        self._answered.wait(timeout_s)


class ReportRequests:
    """Takes requests for reports of this process; close it when done.

    Where there are no such sockets (Windows), or none can be made, nobody can ask.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._waiting: SimpleQueue[Request] = SimpleQueue()
        self._closed = Event()
        self._socket: socket.socket | None = None
        self._path = folder_of_requests() / f"{os.getpid()}{_SUFFIX}"
        if not hasattr(socket, "AF_UNIX"):
            return
        with suppress(OSError):
            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._path.unlink(missing_ok=True)
            listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            listener.bind(str(self._path))
            self._path.chmod(0o600)
            listener.listen()
            self._socket = listener
            Thread(target=self._listen, args=(listener,), name="reports", daemon=True).start()

    def take(self) -> Iterator[Request]:
        """The requests that have come."""
        with suppress(Empty):
            while True:
                yield self._waiting.get_nowait()

    def close(self) -> None:
        """Take no more requests."""
        self._closed.set()
        if self._socket is not None:
            with suppress(OSError):
                # A thread that waits in `accept` is woken by this alone.
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()
            self._path.unlink(missing_ok=True)

    def _listen(self, listener: socket.socket) -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                # Without a file descriptor left they wait.
                if self._closed.wait(_AGAIN_S):
                    return
                continue
            # A report takes seconds, and others ask meanwhile which commands run.
            Thread(target=self._serve, args=(connection,), name="report", daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, suppress(OSError, ValueError, RecursionError):
            connection.settimeout(_ASKS_S)
            self._answer(connection, json.loads(connection.recv(_LONGEST)))

    def _answer(self, connection: socket.socket, asked: Any) -> None:
        """Raises OSError."""
        tree = asked if isinstance(asked, dict) else {}
        do, folder = tree.get("do"), tree.get("folder")
        if do == "title":
            answer: dict[str, Any] = {"title": self._title}
        elif do == "report" and isinstance(folder, str | None):
            request = Request(Path(folder) if folder else None)
            self._waiting.put(request)
            request.wait(ANSWER_S)
            answer = request.answer
        else:
            answer = {"error": "that is no request"}
        connection.sendall(json.dumps(answer).encode())


def folder_of_requests() -> Path:
    """Where the sockets of this user's commands are; only the user may enter."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    if base and os.access(base, os.W_OK):
        return Path(base) / "mdms"
    user = os.getuid() if hasattr(os, "getuid") else "user"
    return Path(tempfile.gettempdir()) / f"mdms-{user}"


def running() -> dict[int, str]:
    """The commands of this user that write reports: process number and title."""
    found = {}
    for path in sorted(folder_of_requests().glob(f"*{_SUFFIX}")):
        process = int(path.stem) if path.stem.isdecimal() else None
        answer = None if process is None else ask(process, {"do": "title"}, _ASKS_S)
        if process is not None and answer is not None:
            found[process] = str(answer["title"])
    return found


def ask(process: int, request: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
    """The answer of a command; None where it is gone or does not answer."""
    path = folder_of_requests() / f"{process}{_SUFFIX}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(timeout_s)
        try:
            connection.connect(str(path))
            connection.sendall(json.dumps(request).encode())
            answer: dict[str, Any] = json.loads(connection.recv(_LONGEST))
        except (OSError, ValueError):
            return None
    return answer


def run(arguments: Namespace) -> ExitCode:
    """Ask the named command, or the only one that runs, for a report; print its folder."""
    if not hasattr(socket, "AF_UNIX"):
        raise CommandError(
            "mdms report asks over a Unix socket, which this system has not; a report is written "
            "after a fault in any case",
            ExitCode.FAILURE,
        )
    process = _process(arguments.process)
    folder = None if arguments.out is None else str(arguments.out.absolute())
    answer = ask(process, {"do": "report", "folder": folder}, ANSWER_S)
    if answer is None:
        raise CommandError(f"process {process} does not answer, or has ended", ExitCode.FAILURE)
    if "error" in answer:
        raise CommandError(
            f"process {process} wrote no report: {answer['error']}", ExitCode.FAILURE
        )
    print(json.dumps(answer) if arguments.json else answer["report"])
    return ExitCode.OK


def _process(named: int | None) -> int:
    commands = running()
    if named in commands:
        return int(named or 0)
    listed = "; ".join(f"{process} ({title})" for process, title in commands.items())
    if named is not None:
        raise CommandError(
            f"process {named} is no table that writes reports; there are: {listed or 'none'}",
            ExitCode.USAGE,
        )
    if not commands:
        raise CommandError(
            "no `mdms run` or `mdms serve` of yours keeps a last minute (--log ring or all)",
            ExitCode.FAILURE,
        )
    if len(commands) > 1:
        raise CommandError(f"several tables run; name one process: {listed}", ExitCode.USAGE)
    return next(iter(commands))
