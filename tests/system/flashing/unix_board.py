"""Boards made of real MicroPython, on pseudo-terminals, with a power plug.

The unix port is the board: a folder is its flash, and a relay stands for the USB cable, the power
supply, the reset and the watchdog. A soft reset ends a unix process, so the relay starts another.
"""

import os
import pty
import select
import shutil
import signal
import subprocess
import threading
import time
import tty
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.micropython_builds import skipping_without_micropython, unix_command

from mdms_sim.nodes.micropython_process import find_micropython

PATIENCE_S = 20
POWER_UP = Path(__file__).parent / "on_board" / "power_up.py"
#: As `power_up.py` has it.
ROM_SIZE = 64 * 4096
#: What the boards have in `machine`; the relay reads the files.
MACHINE = """
import sys, time
OUTSIDE = %r

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
        self.timeout = timeout
        with open(OUTSIDE + "/timeouts", "a") as file:
            file.write("%%d " %% timeout)
        self.feed()

    def feed(self):
        tell("watchdog", str(self.timeout))
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
        self._thread = None

    @property
    def timeouts_ms(self):
        """All timeouts that its watchdog was given."""
        return [int(text) for text in (self._outside / "timeouts").read_text().split()]

    @property
    def rom(self):
        """What its ROMFS partition holds."""
        return (self._outside / "rom.bin").read_bytes()

    @rom.setter
    def rom(self, content):
        (self._outside / "rom.bin").write_bytes(content.ljust(ROM_SIZE, b"\xff"))

    def plug_in(self):
        self._host, self._line = pty.openpty()
        tty.setraw(self._line)
        self.port = os.ttyname(self._line)
        self._plugged = True
        self._start(with_main=True)
        self._thread = threading.Thread(target=self._relay)
        self._thread.start()

    def unplug(self):
        self._plugged = False
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()

    def wait_for(self, name, text):
        """Until a file in the flash has this text."""
        end = time.monotonic() + PATIENCE_S
        path = self.flash / name
        while not (path.exists() and path.read_text() == text):
            assert time.monotonic() < end, (name, path.exists() and path.read_text())
            time.sleep(0.01)

    def _start(self, with_main):
        (self._outside / "watchdog").unlink(missing_ok=True)
        (self._outside / "reset").unlink(missing_ok=True)
        self._runs_main = with_main and (self.flash / "main.py").exists()
        self._ours, theirs = pty.openpty()
        tty.setraw(theirs)
        self._child = subprocess.Popen(
            [*unix_command(), *self._arguments()],
            cwd=self.flash,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env={**os.environ, "MICROPYPATH": f"{self._outside}:"},
            start_new_session=True,
        )
        os.close(theirs)

    def _arguments(self):
        heap = () if self._heap_bytes is None else ("-X", f"heapsize={self._heap_bytes}")
        if self._has_rom:
            power_up = str(self._outside / POWER_UP.name)
            return (*heap, "-i", power_up, *(("main",) if self._runs_main else ()))
        return (*heap, *(("-i", "main.py") if self._runs_main else ()))

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
        for end in (self._host, self._line, self._ours):
            os.close(end)

    def _from_host(self, data):
        if self.fuse_bytes is not None:
            self.fuse_bytes -= len(data)
            self._plugged = self.fuse_bytes > 0
        if self._runs_main and b"\x03" in data:
            # A program has no terminal that would turn the key into a signal.
            data = data.replace(b"\x03", b"")
            self._child.send_signal(signal.SIGINT)
        if self._plugged:
            os.write(self._ours, data)

    def _from_board(self):
        with suppress(OSError):
            data = os.read(self._ours, 4096)
            self._runs_main = self._runs_main and b">>> " not in data
            os.write(self._host, data)
            return
        self._child.wait()
        os.close(self._ours)
        hard = (self._outside / "reset").exists()
        if hard:
            self._start(with_main=True)
        else:
            os.write(self._host, b"soft reboot\r\n")
            self._start(with_main=False)
            os.write(self._ours, b"\x01")

    def _watch(self):
        with suppress(FileNotFoundError, ValueError):
            dog = self._outside / "watchdog"
            overdue_s = time.time() - dog.stat().st_mtime - int(dog.read_text()) / 1000
            if overdue_s > 0:
                self.resets += 1
                self._child.kill()
                self._child.wait()
                os.close(self._ours)
                self._start(with_main=True)


@contextmanager
def boards_in(folder):
    """Gives a function that plugs in a board with these files in its flash, and `rom` in ROMFS."""
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

    try:
        yield plug_in
    finally:
        for board in boards:
            board.unplug()
