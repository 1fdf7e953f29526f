"""A line to look at: the table with its page, a scanner at its infeed, and chutes that fill up.

python examples/line/plant.py [SECONDS] starts `mdms serve` with a page and works beside it, until
Ctrl-C or for so long. A chute holds four parcels. It is full then, and somebody empties it after
12 s. Every parcel is scanned, and has an order. `make line` runs it.
"""

import itertools
import random
import re
import socket
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RESET, START = 1, 2
STOPPED, IDLE, SUSPENDED, EXECUTE, ABORTED, HELD = 2, 4, 5, 6, 9, 11
#: The way back to Execute, by state: Reset, Start, Unsuspend, Clear, Unhold. A plant asks a person.
WAY_BACK = {STOPPED: RESET, IDLE: START, SUSPENDED: 7, ABORTED: 9, HELD: 5}
ORDER, COMING, ASK = 0, 2, 3
UNDER_WAY, LEFT, ANY_YAW = 2, 4, 0x8000
#: Orders that are open at a time, parcels in a chute, and seconds until it is empty again.
AHEAD, ROOM, EMPTIED_S = 4, 4, 12.0
EXITS = ("north", "east", "south")
TABLE = Path(__file__).with_name("table.toml")
PAGE = ("--page",)


class Table:
    """The registers of the table; see `docs/line-registers.md`."""

    def __init__(self, port: int) -> None:
        self._link = socket.create_connection(("127.0.0.1", port))
        self._beats = itertools.count(1)

    def _request(self, pdu: bytes) -> bytes:
        self._link.sendall(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)
        (length,) = struct.unpack(">4xHx", self._link.recv(7, socket.MSG_WAITALL))
        return self._link.recv(length - 1, socket.MSG_WAITALL)

    def read(self, address: int, count: int = 1) -> tuple[int, ...]:
        """Registers, by function 3."""
        return struct.unpack(
            f">{count}H", self._request(struct.pack(">BHH", 3, address, count))[2:]
        )

    def write(self, address: int, *values: int) -> None:
        """Write registers, by function 16."""
        head = struct.pack(">BHHB", 16, address, len(values), 2 * len(values))
        self._request(head + struct.pack(f">{len(values)}H", *values))

    def beat(self) -> None:
        """Say that the controller lives."""
        self.write(100, next(self._beats) & 0xFFFF)

    def command(self, number: int, state: int) -> None:
        """Give a command, and wait for the state that it leads to."""
        self.write(101, number, (self.read(103)[0] + 1) & 0xFFFF)
        while self.read(1)[0] != state:
            self.beat()
            time.sleep(0.1)

    def request(self, kind: int, key: str = "", parcel: str = "", exit: int = 0) -> int:
        """Send a request; returns the state of the order."""
        texts = key.encode().ljust(16, b"\0") + parcel.encode().ljust(16, b"\0")
        counter = (self.read(224)[0] + 1) & 0xFFFF
        self.write(200, counter, kind, exit, 0, 0, 0, ANY_YAW, *struct.unpack(">16H", texts))
        return self.read(226)[0]


class Plant:
    """The scanner, the chutes and the controller around a table."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self._random = random.Random(1)
        self._numbers = itertools.count(1)
        #: The exit of each order that is open, from 1.
        self._open: dict[str, int] = {}
        self._inside = [0, 0, 0]
        self._full_since_s: list[float | None] = [None, None, None]

    def step(self, now_s: float) -> None:
        """Scan what comes, see what has left, fill and empty chutes."""
        self._table.beat()
        state, is_full = self._table.read(1)[0], any(self._full_since_s)
        if state in WAY_BACK and not (state == SUSPENDED and is_full):
            if state == IDLE:
                # Reset has ended all announcements, if anything lay on the table.
                for key in self._open:
                    self._table.request(COMING, parcel=f"P-{key}")
            self._table.write(101, WAY_BACK[state], (self._table.read(103)[0] + 1) & 0xFFFF)
        while len(self._open) < AHEAD:
            key, exit = f"{next(self._numbers):04d}", self._random.randint(1, len(EXITS))
            self._table.request(COMING, parcel=f"P-{key}")
            self._table.request(ORDER, key, f"P-{key}", exit)
            self._open[key] = exit
        for key, exit in list(self._open.items()):
            state = self._table.request(ASK, key)
            if state > UNDER_WAY:
                del self._open[key]
            if state == LEFT:
                self._drop(exit - 1, key, now_s)
            elif state > UNDER_WAY:
                print(f"P-{key} has not left: its order is refused, or in doubt", flush=True)
        for chute, since_s in enumerate(self._full_since_s):
            if since_s is not None and now_s - since_s > EMPTIED_S:
                self._inside[chute], self._full_since_s[chute] = 0, None
                self._tell(f"the chute {EXITS[chute]} is empty")

    def _drop(self, chute: int, key: str, now_s: float) -> None:
        self._inside[chute] += 1
        print(f"P-{key} has left by {EXITS[chute]}, {self._inside[chute]} in its chute", flush=True)
        if self._inside[chute] >= ROOM and self._full_since_s[chute] is None:
            self._full_since_s[chute] = now_s
            self._tell(f"the chute {EXITS[chute]} is full")

    def _tell(self, text: str) -> None:
        full = sum(1 << k for k, since_s in enumerate(self._full_since_s) if since_s is not None)
        self._table.write(105, full)
        print(text, flush=True)


def main(seconds: float) -> None:
    """Start the table, bring it to Execute, and work."""
    mdms = [str(Path(sys.executable).with_name("mdms")), "serve", str(TABLE), *PAGE]
    with tempfile.TemporaryDirectory() as state:
        options = ["--modbus", "0", "--state", state, "--name", f"line-{Path(state).name}"]
        served = subprocess.Popen([*mdms, *options], stdout=subprocess.PIPE, text=True)
        try:
            assert served.stdout is not None
            page = served.stdout.readline().strip()
            port = re.search(r":(\d+)$", served.stdout.readline().strip())
            if port is None:
                raise SystemExit("the table does not start")
            print(f"look at it: {page}", flush=True)
            table = Table(int(port[1]))
            table.command(RESET, IDLE)
            table.command(START, EXECUTE)
            plant, end_s = Plant(table), time.monotonic() + seconds
            while time.monotonic() < end_s and served.poll() is None:
                plant.step(time.monotonic())
                time.sleep(0.1)
        except (KeyboardInterrupt, ConnectionError):
            pass
        finally:
            served.terminate()
            served.wait()


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else float("inf"))
