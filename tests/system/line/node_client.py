"""Clients of other makers in processes of their own, and the network between them and a table."""

import json
import selectors
import shutil
import socket
import subprocess
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

HERE = Path(__file__).parent
NODE = shutil.which("node")
#: Whether the clients are installed, as `.ci/run` does it.
IS_THERE = NODE is not None and (HERE / "node_modules").is_dir()


def check_is_there() -> None:
    """End a benchmark that needs the clients, where there are none."""
    if not IS_THERE:
        raise SystemExit("this needs node, and `npm ci --prefix tests/system/line`")


class ClientError(Exception):
    """A request that was refused, or a connection that is lost: the client's own words."""

    @property
    def refused(self) -> bool:
        """Whether the table has refused it."""
        return str(self).startswith("refused")


class NodeClient:
    """A client of node, by `modbus` or `opcua`; close it when done."""

    def __init__(self, protocol: str) -> None:
        self._process = subprocess.Popen(
            [str(NODE), str(HERE / "remote_client.js"), protocol],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        with self._process as process:
            process.kill()

    def connect(self, *where: str) -> None:
        """Connect, in the place of an earlier connection. Raises `ClientError`."""
        self.ask("connect", *where)

    def ask(self, method: str, *values: Any) -> Any:
        """The answer to a request. Raises `ClientError`."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"do": method, "with": values}) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        if "error" in answer:
            raise ClientError(answer["error"])
        return answer["value"]


class Network:
    """A TCP port of this machine that leads to another one, until it is pulled.

    Close it when done.
    """

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._target = 0
        self._is_there = threading.Event()
        self._is_there.set()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._over.set()
        self._thread.join()
        self._listener.close()

    def lead_to(self, port: int) -> None:
        """Connections lead to this port from now on."""
        self._target = port

    def pull(self) -> None:
        """Carry nothing from now on; the two sides are not told."""
        self._is_there.clear()

    def plug_in(self) -> None:
        """Carry bytes of new connections; those of before are broken off."""
        self._is_there.set()

    def _run(self) -> None:
        with selectors.DefaultSelector() as ready:
            ready.register(self._listener, selectors.EVENT_READ)
            while not self._over.is_set():
                if not self._is_there.is_set():
                    self._is_there.wait(0.05)
                    if self._is_there.is_set():
                        self._break_off(ready)
                    continue
                for key, _ in ready.select(0.05):
                    if key.data is None:
                        self._accept(ready)
                    else:
                        self._carry(ready, key)
            self._break_off(ready)

    def _accept(self, ready: selectors.BaseSelector) -> None:
        ours, _ = self._listener.accept()
        try:
            theirs = socket.create_connection(("127.0.0.1", self._target), 1.0)
        except OSError:
            ours.close()
            return
        theirs.settimeout(None)
        ready.register(ours, selectors.EVENT_READ, theirs)
        ready.register(theirs, selectors.EVENT_READ, ours)

    def _carry(self, ready: selectors.BaseSelector, key: selectors.SelectorKey) -> None:
        one, other = key.fileobj, key.data
        assert isinstance(one, socket.socket)
        if one.fileno() < 0:
            return
        with suppress(OSError):
            if data := one.recv(65536):
                other.sendall(data)
                return
        for each in (one, other):
            ready.unregister(each)
            each.close()

    def _break_off(self, ready: selectors.BaseSelector) -> None:
        for key in [each for each in ready.get_map().values() if each.data is not None]:
            ready.unregister(key.fileobj)
            key.data.close()
