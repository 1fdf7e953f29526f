"""A served table that may be killed, and a controller that speaks Modbus byte by byte."""

import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from tests.free_port import free_port

EXAMPLES = Path(__file__).parents[3] / "examples" / "line"
MDMS = [sys.executable, "-c", "import sys; from mdms_host.entry import main; sys.exit(main())"]
PATIENCE_S = 120
STOPPED, IDLE, SUSPENDED, EXECUTE, ABORTED = 2, 4, 5, 6, 9


class Controller:
    """A client of a line; close it when done."""

    def __init__(self, port: int) -> None:
        self.port = port
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self._beat = 0

    def close(self) -> None:
        self._socket.close()

    def send(self, pdu: bytes) -> None:
        self._socket.sendall(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)

    def ask(self, pdu: bytes) -> bytes:
        self.send(pdu)
        (length,) = struct.unpack(">4xHx", self._socket.recv(7, socket.MSG_WAITALL))
        return self._socket.recv(length - 1, socket.MSG_WAITALL)

    def read(self, address: int, count: int = 1) -> tuple[int, ...]:
        return struct.unpack(f">{count}H", self.ask(struct.pack(">BHH", 3, address, count))[2:])

    def write(self, address: int, *values: int) -> None:
        head = struct.pack(">BHHB", 16, address, len(values), 2 * len(values))
        assert self.ask(head + struct.pack(f">{len(values)}H", *values))[0] == 16

    def beat(self) -> None:
        self._beat += 1
        self.write(100, self._beat)

    def command(self, number: int) -> bool:
        self.write(101, number, (self.read(103)[0] + 1) & 0xFFFF)
        return self.read(104)[0] == 0

    def order(self, request: int, key: str, parcel: str = "", exit: int = 0) -> tuple[int, ...]:
        texts = struct.unpack(
            ">16H", key.encode().ljust(16, b"\0") + parcel.encode().ljust(16, b"\0")
        )
        counter = (self.read(224)[0] + 1) & 0xFFFF
        self.write(200, counter, request, exit, 0, 0, 0, 0x8000, *texts)
        answered, result, state = self.read(224, 3)
        assert answered == counter
        return result, state

    def until(self, done: Callable[[], bool], *, beats: bool = True) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < end_s, self.read(0, 20)
            if beats:
                self.beat()
            time.sleep(0.1)

    def until_state(self, state: int, *, beats: bool = True) -> None:
        self.until(lambda: self.read(1)[0] == state, beats=beats)

    def bring_to_execute(self) -> None:
        assert self.command(1)
        self.until_state(IDLE)
        assert self.command(2)
        self.until_state(EXECUTE)


class Table:
    """`mdms serve` of the example, in a process that may be killed and begun again."""

    def __init__(self, folder: Path, protocols: tuple[str, ...]) -> None:
        self.folder = folder
        self.ports = {name: free_port() for name in protocols}
        self.process: subprocess.Popen[str] | None = None
        self._controllers: list[Controller] = []

    def start(self) -> None:
        options = [f"--{name}={port}" for name, port in self.ports.items()]
        options.append(f"--recipe={EXAMPLES / 'gentle.toml'}")
        command = [*MDMS, "serve", str(EXAMPLES / "table.toml"), "--state", str(self.folder)]
        environment = os.environ | {"XDG_RUNTIME_DIR": str(self.folder)}
        self.process = subprocess.Popen(
            [*command, *options], stdout=subprocess.PIPE, text=True, env=environment
        )
        assert self.process.stdout is not None
        lines = iter(self.process.stdout.readline, "")
        assert any("connect with" in line for line in lines)

    def report(self, folder: Path) -> None:
        """Have the table write its last minute into a folder."""
        assert self.process is not None
        command = [*MDMS, "report", str(self.process.pid), "--out", str(folder)]
        environment = os.environ | {"XDG_RUNTIME_DIR": str(self.folder)}
        subprocess.run(command, check=True, env=environment, capture_output=True)

    def controller(self) -> "Controller":
        self._controllers.append(Controller(self.ports["modbus"]))
        return self._controllers[-1]

    def servers(self) -> int:
        """The process of its servers."""
        assert self.process is not None
        number = self.process.pid
        children = Path(f"/proc/{number}/task/{number}/children").read_text().split()
        (servers,) = [
            int(child)
            for child in children
            if b"mdms_host.line.servers" in Path(f"/proc/{child}/cmdline").read_bytes()
        ]
        return servers

    def close(self) -> None:
        for each in self._controllers:
            each.close()
        if self.process is not None and self.process.poll() is None:
            assert self.stop() == 0

    def kill(self) -> None:
        assert self.process is not None
        self.process.kill()
        self.process.communicate()

    def stop(self) -> int:
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode


def admit_user(folder: Path) -> None:
    """Make a certificate, and let the user `plc` in by a password."""
    command = [*MDMS, "line", "certificate", "--state", str(folder)]
    made = subprocess.run(command, check=False, capture_output=True)
    assert made.returncode == 0
    assert (folder / "key.pem").stat().st_mode & 0o777 == 0o600
    (folder / "users.txt").write_text("plc:secret\n")
    (folder / "users.txt").chmod(0o600)
