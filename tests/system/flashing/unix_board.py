"""Boards made of real MicroPython, on pseudo-terminals, with a power plug.

The unix port is the board: a folder is its flash, and a relay stands for the USB cable, the power
supply, the reset and the watchdog. A soft reset ends a unix process, so the relay starts another.

As on an STM32 (ports/stm32/main.c, shared/runtime/pyexec.c), bytes that come during a reset are
lost, and Ctrl-C interrupts nothing before `main.py` runs: it is a byte like any other. Left out: it
does so only where `main.py` feeds its watchdog, and not at all at the prompt. A signal would
interrupt anything, but the unix port raises it amid its C code, with locks held, and hangs then.
"""

import os
import pty
import select
import shutil
import subprocess
import threading
import time
import tty
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from tests.micropython_builds import skipping_without_micropython, unix_command

from mdms_host.flashing import board_link
from mdms_sim.nodes.micropython_process import find_micropython

#: Longer than any machine is busy; only a board that hangs takes so long.
PATIENCE_S = 120.0
POWER_UP = Path(__file__).parent / "on_board" / "power_up.py"
#: As `power_up.py` has it.
ROM_SIZE = 80 * 4096
#: The members of `machine` on the boards; the relay reads the files.
MACHINE = """
import os, sys
OUTSIDE = %r
#: Whether Ctrl-C interrupts.
interruptible = False

def tell(name, text):
    with open(OUTSIDE + "/" + name, "w") as file:
        file.write(text)

def unique_id():
    return bytes(range(12))

def reset():
    tell("reset", "")
    sys.exit()

class WDT:
    def __init__(self, timeout=5000):
        with open(OUTSIDE + "/timeouts", "a") as file:
            file.write("%%d " %% timeout)
        tell("watchdog", str(timeout))
        self.feed()

    def feed(self):
        if interruptible:
            try:
                os.remove(OUTSIDE + "/interrupt")
            except OSError:
                return
            raise KeyboardInterrupt
"""


class UnixBoard:
    """A board of MicroPython's unix port; `port` is where its USB cable ends.

    Its flash is a folder. It has a ROMFS partition on request, and a heap of another size.
    """

    def __init__(self, folder, rom=False, heap_bytes=None):
        self._has_rom, self._heap_bytes = rom, heap_bytes
        self.flash, self._outside = folder / "flash", folder / "outside"
        self.flash.mkdir(parents=True)
        self._outside.mkdir()
        (self._outside / "machine.py").write_text(MACHINE % str(self._outside))
        shutil.copy(POWER_UP, self._outside)
        self.resets = 0
        self.fuse_bytes = None
        self._is_starved = False
        self._thread = None
        self._lines = []

    @property
    def timeouts_ms(self):
        """All timeouts that its watchdog was given."""
        return [int(text) for text in (self._outside / "timeouts").read_text().split()]

    @property
    def rom(self):
        """The content of its ROMFS partition."""
        return (self._outside / "rom.bin").read_bytes()

    @rom.setter
    def rom(self, content):
        (self._outside / "rom.bin").write_bytes(content.ljust(ROM_SIZE, b"\xff"))

    def plug_in(self):
        """Give it power; returns when it is at its prompt or runs `main.py`."""
        self._host, line = pty.openpty()
        tty.setraw(line)
        self.port = os.ttyname(line)
        # Until it is thrown away, no other board gets a port of this name.
        self._lines.append(line)
        self._plugged = True
        self._start()
        self._thread = threading.Thread(target=self._relay)
        self._thread.start()
        _until((self._outside / "up").exists)

    def unplug(self):
        self._plugged = False
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()

    def throw_away(self):
        self.unplug()
        while self._lines:
            os.close(self._lines.pop())

    def wait_for(self, name, text):
        """Until a file in the flash has this text."""
        path = self.flash / name
        _until(lambda: path.exists() and path.read_text() == text)

    def starve(self, duration_ms):
        """Feed the watchdog of a board at its prompt for so long not at all.

        No other time passes for it, so no machine is too slow for it.
        """
        dog, before = self._outside / "watchdog", self.resets
        if dog.exists() and int(dog.read_text()) < duration_ms:
            self._is_starved = True
            _until(lambda: self.resets > before)

    def _start(self, after_reset=True):
        for name in ("watchdog", "reset", "interrupt", "main", "up"):
            (self._outside / name).unlink(missing_ok=True)
        if after_reset:
            (self._outside / "on").unlink(missing_ok=True)
        self._ours, theirs = pty.openpty()
        tty.setraw(theirs)
        self._child = subprocess.Popen(
            [*unix_command(), *self._arguments(after_reset)],
            cwd=self.flash,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env={**os.environ, "MICROPYPATH": f"{self._outside}:"},
            start_new_session=True,
        )
        os.close(theirs)

    def _arguments(self, with_main):
        heap = () if self._heap_bytes is None else ("-X", f"heapsize={self._heap_bytes}")
        does = ("rom",) if self._has_rom else ()
        if with_main and (self.flash / "main.py").exists():
            does += ("main",)
        return (*heap, "-i", str(self._outside / POWER_UP.name), *does)

    def _relay(self):
        while self._plugged:
            ready = select.select([self._host, self._ours], [], [], 0.02)[0]
            if self._host in ready:
                self._from_host(os.read(self._host, 4096))
            if self._ours in ready:
                self._from_board()
            self._watch()
        self._child.kill()
        self._child.wait()
        os.close(self._host)
        os.close(self._ours)

    def _from_host(self, data):
        if self.fuse_bytes is not None:
            self.fuse_bytes -= len(data)
            self._plugged = self.fuse_bytes > 0
        if not (self._outside / "on").exists():
            return
        if b"\x03" in data and (self._outside / "main").exists():
            data = data.replace(b"\x03", b"")
            (self._outside / "interrupt").touch()
        if self._plugged:
            os.write(self._ours, data)

    def _from_board(self):
        with suppress(OSError):
            data = os.read(self._ours, 4096)
            os.write(self._host, data)
            return
        self._child.wait()
        os.close(self._ours)
        hard = (self._outside / "reset").exists()
        if hard:
            self._start()
        else:
            os.write(self._host, b"soft reboot\r\n")
            self._start(after_reset=False)
            os.write(self._ours, b"\x01")

    def _watch(self):
        if self._is_starved:
            self._is_starved = False
            self._child.kill()
            self._child.wait()
            os.close(self._ours)
            self._start()
            self.resets += 1


def _until(is_so):
    end_s = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@contextmanager
def boards_in(folder):
    """Gives a function that plugs in a board with these files in its flash, and `rom` in ROMFS.

    On a busy machine they are slower than any board, so the tests are patient with them.
    """
    with skipping_without_micropython():
        find_micropython()
    boards = []

    def plug_in(files, rom=None, heap_bytes=None):
        board = UnixBoard(folder / f"board{len(boards)}", rom is not None, heap_bytes)
        if rom is not None:
            board.rom = rom
        for path, data in files.items():
            (board.flash / path).parent.mkdir(parents=True, exist_ok=True)
            (board.flash / path).write_bytes(data)
        board.plug_in()
        boards.append(board)
        return board

    with pytest.MonkeyPatch.context() as patch:
        for name in ("_PATIENCE_S", "_ANSWER_S", "_RUN_S", "_RETURN_S"):
            patch.setattr(board_link, name, PATIENCE_S)
        try:
            yield plug_in
        finally:
            for board in boards:
                board.throw_away()
