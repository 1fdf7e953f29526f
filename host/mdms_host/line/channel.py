"""Messages between the process that drives the table and the one that serves protocols.

Each is one line of JSON on a socket pair. The table's side never waits.
"""

import json
import socket
import subprocess
import sys
from typing import Any

#: Bytes that wait for a server that does not read; beyond them it has failed.
_MOST_WAITING = 4_000_000
_READ_BYTES = 65536


class ServersGoneError(Exception):
    """The process of the servers has ended, or does not read."""


class ServersProcess:
    """The process of the servers, from the table's side; close it when done."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "mdms_host.line.servers", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                # Ctrl-C is for the table, which ends the servers in order.
                start_new_session=True,
            )
        self._socket.setblocking(False)
        self._in = b""
        self._out = b""
        self.send(settings)

    def close(self) -> None:
        """End the servers: they see that the table is gone."""
        self._socket.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def send(self, message: dict[str, Any]) -> None:
        """Send a message, now or with the next one. Raises `ServersGoneError`."""
        self._out += json.dumps(message).encode() + b"\n"
        self.flushed()

    def flushed(self) -> bool:
        """Send as much as the servers take now, and return whether that was all.

        Raises `ServersGoneError`.
        """
        try:
            while self._out:
                self._out = self._out[self._socket.send(self._out) :]
        except BlockingIOError:
            if len(self._out) > _MOST_WAITING:
                raise ServersGoneError("the servers of the line do not read") from None
        except OSError as error:
            raise ServersGoneError(f"the servers of the line are gone: {error}") from None
        return not self._out

    def receive(self) -> list[dict[str, Any]]:
        """Messages that have come, the last ones of a process that has ended too.

        Raises `ServersGoneError` when it has ended, and nothing of it is left.
        """
        gone = False
        try:
            while data := self._socket.recv(_READ_BYTES):
                self._in += data
            gone = True
        except BlockingIOError:
            pass
        except OSError:
            gone = True
        *lines, self._in = self._in.split(b"\n")
        if gone and not lines:
            raise ServersGoneError(f"the servers of the line have ended, with {self._ended()}")
        return [json.loads(line) for line in lines]

    def _ended(self) -> int:
        """The exit code of the process."""
        try:
            return self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()
