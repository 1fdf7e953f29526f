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
from tests.system.links.serving import serving

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_sim.nodes.python_bank import PythonBank

RECORD = struct.Struct("<HBB8s")
PROGRAM = Path(__file__).with_name("adapter_on_board.py")
FAKES = sorted((ROOT / "tests" / "firmware" / "fakes").glob("*.py"))
BOARDS = ("pybv11", "nucleo_g474re")
COMMAND = 0x80
BUS_OFF, SHORT, CLEAR, INTERRUPTS_OFF, INTERRUPTS_ON = range(5)
CELLS = 18
PATIENCE_S = 120
CHANCES = 10
pytestmark = pytest.mark.real_time
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

    def command(self, number):
        """Do something to the controller."""
        os.write(self._into, RECORD.pack(number, 0, COMMAND, bytes(8)))

    def type(self, lines):
        """Write lines as a host does."""
        os.write(self.line, lines)

    def read(self, ends_with):
        """Read as the host does, until these bytes have come last."""
        data = b""
        while not data.endswith(ends_with):
            assert select.select([self.line], [], [], PATIENCE_S)[0], data
            data += os.read(self.line, 1 << 16)
        return data

    def taken(self, timeout_s):
        """The next frame for the bus, None if none comes."""
        if not select.select([self._out], [], [], timeout_s)[0]:
            return None
        can_id, length, _, data = RECORD.unpack(os.read(self._out, RECORD.size))
        return can_id, data[:length]


@contextmanager
def plugged(folder: Path, board: str = "pybv11"):
    with skipping_without_micropython():
        command = unix_command()
    firmware = ROOT / "firmware"
    stage(folder, (PROGRAM, firmware / "boards", *FAKES))
    line, theirs = pty.openpty()
    tty.setraw(theirs)
    child_reads, into = os.pipe()
    out, child_writes = os.pipe()
    child = subprocess.Popen(
        [*command, PROGRAM.name, board, str(child_reads), str(child_writes)],
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
        at_once = ("--bus-kwargs", "sleep_after_open=0")
        show = ("configure", "show", "axis1.gain", "--node", "1-18")
        # On a busy machine answers of some cells are late.
        assert any(main([*show, *door, *at_once]) == ExitCode.OK for _ in range(CHANCES))
        assert "node 1-18" in capsys.readouterr().out


def read_until_quiet(line: int, lines: bytearray, wanted: int, over: threading.Event):
    """Read as a host does, until it has heard of this many frames."""
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


@pytest.fixture(params=BOARDS)
def adapter(request, tmp_path):
    """An adapter with its channel open."""
    with plugged(tmp_path / "flash", request.param) as ready:
        ready.type(b"O\rF\r")
        ready.read(b"\rF00\r")
        yield ready


def sent(adapter, number):
    return [adapter.taken(PATIENCE_S) for _ in range(number)]


def test_frames_are_refused_once_mailboxes_and_queue_are_full_and_those_taken_go_out(adapter):
    adapter.command(SHORT)
    adapter.type(b"".join(b"t%03X0\r" % number for number in range(40)))
    answers = adapter.read(b"\a").replace(b"z\r", b"z")
    while len(answers) < 40:
        answers += adapter.read(b"\a").replace(b"z\r", b"z")
    taken = answers.index(b"\a")
    # Three mailboxes and a queue of 32.
    assert answers == b"z" * taken + b"\a" * (40 - taken)
    assert taken == 35
    adapter.type(b"F\rF\r")
    assert adapter.read(b"F00\r") == b"F02\rF00\r"
    adapter.command(CLEAR)
    assert sent(adapter, taken) == [(number, b"") for number in range(taken)]


def test_bus_off_is_reported_and_frames_meanwhile_are_refused_not_sent_late(adapter):
    adapter.command(SHORT)
    adapter.type(b"".join(b"t%03X0\r" % number for number in range(8)))
    assert adapter.read(b"z\r" * 8) == b"z\r" * 8
    adapter.command(BUS_OFF)
    assert adapter.read(b"y\r") == b"y\r"
    adapter.type(b"t7000\rF\r")
    assert adapter.read(b"F82\r") == b"\aF82\r"
    # A restarted controller waits for recessive bits; only then the bus is there again.
    adapter.command(CLEAR)
    answer = b"\a"
    while answer == b"\a":
        adapter.type(b"t7010\r")
        answer = adapter.read((b"\a", b"z\r"))
    assert sent(adapter, 1) == [(0x701, b"")]
    adapter.give(0x585, b"\x01")
    assert adapter.read(b"t585101\r") == b"t585101\r"
    adapter.type(b"F\rF\r")
    assert adapter.read(b"F00\r")[-4:] == b"F00\r"


def test_frames_that_overrun_the_controllers_fifo_are_reported_in_their_place(adapter):
    adapter.command(INTERRUPTS_OFF)
    for number in range(5):
        adapter.give(number, b"")
    adapter.command(INTERRUPTS_ON)
    adapter.give(0x7FF, b"")
    lines = adapter.read(b"t7FF0\r")
    # Three fit; a bxCAN keeps the newest in the last place, an FDCAN the oldest. Either reports a
    # loss once, however many frames it is.
    assert re.findall(rb"x(....)", lines) == [b"0001"]
    kept = re.findall(rb"t(...)0\r", lines)
    assert kept in ([b"000", b"001", b"004", b"7FF"], [b"000", b"001", b"002", b"7FF"])
    adapter.type(b"F\r")
    assert adapter.read(b"\r") == b"F09\r"
