"""A board as SLCAN adapter: a real MicroPython process behind a pseudo-terminal."""

import os
import pty
import re
import select
import struct
import subprocess
import threading
import time
import tty
from contextlib import contextmanager
from pathlib import Path

import can
import pytest
from tests.micropython_builds import ROOT, skipping_without_micropython, stage, unix_command
from tests.system.serving import serving

from mdms_host.cli import main
from mdms_host.cli.exits import Exit
from mdms_sim.nodes.python_bank import PythonBank

RECORD = struct.Struct("<HBB8s")
PROGRAM = ROOT / "tests" / "system" / "on_board" / "adapter_on_pipes.py"
CELLS = 18
PATIENCE_S = 30
FULL_BUS = 8000


class Plugged:
    """The adapter: `port` is its serial device, `give` and `taken` are the other side's frames."""

    def __init__(self, port, line, into, out):
        self.port = port
        self.line = line
        self._into = into
        self._out = out

    def give(self, can_id, data):
        os.write(self._into, RECORD.pack(can_id, len(data), 0, data.ljust(8, b"\0")))

    def taken(self, timeout_s):
        """The next frame for the bus, None if none comes."""
        if not select.select([self._out], [], [], timeout_s)[0]:
            return None
        can_id, length, _, data = RECORD.unpack(os.read(self._out, RECORD.size))
        return can_id, data[:length]


@contextmanager
def plugged(folder: Path):
    with skipping_without_micropython():
        command = unix_command()
    stage(folder, (PROGRAM, ROOT / "firmware" / "adapter_main.py", stand_in(folder)))
    line, theirs = pty.openpty()
    tty.setraw(theirs)
    child_reads, into = os.pipe()
    out, child_writes = os.pipe()
    child = subprocess.Popen(
        [*command, PROGRAM.name, str(child_reads), str(child_writes)],
        cwd=folder,
        stdin=line,
        stdout=line,
        env={**os.environ, "MICROPYPATH": str(folder)},
        pass_fds=(child_reads, child_writes),
    )
    try:
        yield Plugged(os.ttyname(theirs), theirs, into, out)
    finally:
        child.kill()
        child.wait()
        for each in (line, theirs, child_reads, into, out, child_writes):
            os.close(each)


def stand_in(folder: Path) -> Path:
    """What `adapter_main` imports of the boards, which these pipes replace."""
    boards = folder.parent / "boards"
    boards.mkdir()
    (boards / "detect.py").write_text("def board_module(machine):\n    raise RuntimeError\n")
    return boards


@contextmanager
def wired(adapter: Plugged, channel: str):
    """Frames between the adapter's controller and the served bus."""
    over = threading.Event()
    with can.Bus(channel, interface="mdms") as bus:

        def to_adapter():
            while not over.is_set():
                message = bus.recv(0.05)
                if message is not None:
                    adapter.give(message.arbitration_id, bytes(message.data))

        def to_bus():
            while not over.is_set():
                frame = adapter.taken(0.05)
                if frame is not None:
                    message = can.Message(
                        arbitration_id=frame[0], data=frame[1], is_extended_id=False
                    )
                    bus.send(message)

        threads = [threading.Thread(target=each) for each in (to_adapter, to_bus)]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            over.set()
            for thread in threads:
                thread.join()


def test_cells_are_reached_over_a_board_instead_of_a_bought_adapter(tmp_path, capsys):
    channel = str(tmp_path / "bus.sock")
    with (
        serving(PythonBank(range(1, CELLS + 1)), channel),
        plugged(tmp_path / "flash") as adapter,
        wired(adapter, channel),
    ):
        door = ("-i", "slcan", "-c", adapter.port, "-b", "1000000")
        assert main(["configure", "show", "axis1.gain", "--node", "1-18", *door]) == Exit.OK
        assert "node 1-18" in capsys.readouterr().out
        assert main(["identify", "--node", "7", *door]) == Exit.OK


def read_until_quiet(line: int, lines: bytearray, wanted: int, over: threading.Event):
    """What a host reads, until it has heard of so many frames."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s and heard_of(lines) < wanted and not over.is_set():
        if select.select([line], [], [], 0.1)[0]:
            lines += os.read(line, 1 << 16)


def heard_of(lines: bytearray) -> int:
    received = lines.count(b"\rt") + lines.startswith(b"t")
    return received + sum(int(lost, 16) for lost in re.findall(rb"x([0-9A-F]{4})\r", lines))


@pytest.mark.slow
def test_a_second_of_a_full_bus_arrives_in_order_or_is_reported_as_lost(tmp_path):
    with plugged(tmp_path / "flash") as adapter:
        # A terminal passes on what its other side reads: the host's end is the slave.
        os.write(adapter.line, b"S8\rO\r")
        lines = bytearray()
        over = threading.Event()
        while lines.count(b"\r") < 2:
            lines += os.read(adapter.line, 64)
        lines.clear()
        lines += b"\r"
        host = threading.Thread(target=read_until_quiet, args=(adapter.line, lines, FULL_BUS, over))
        host.start()
        start_s = time.monotonic()
        for number in range(FULL_BUS):
            adapter.give(number & 0x7FF, number.to_bytes(4, "little") * 2)
            ahead_s = number / FULL_BUS - (time.monotonic() - start_s)
            if ahead_s > 0.002:
                time.sleep(ahead_s)
        host.join()
        got = [int(digits, 16) for digits in re.findall(rb"t...8(.{8}).{8}\r", lines)]
        numbers = [int.from_bytes(each.to_bytes(4, "big"), "little") for each in got]
        assert numbers == sorted(set(numbers))
        assert heard_of(lines) == FULL_BUS
