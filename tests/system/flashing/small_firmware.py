"""A small firmware in two versions, and what becomes of a board that it is flashed onto."""

import random

import pytest

from mdms_host.clock import MonotonicClock
from mdms_host.flashing import board_link
from mdms_host.flashing.board_link import BoardLink, NoBoardError
from mdms_host.flashing.board_survey import identify, survey
from mdms_host.flashing.firmware import Firmware
from mdms_host.flashing.flashing import carry_out, plan_flash

#: A cell at work, as far as its host can tell: fed watchdog, motors that go off with it.
CELL = b"""
import machine, time
from mdms_protocol.version import VERSION

def tell(name, text, mode="w"):
    with open(name, mode) as file:
        file.write(text)

dog = machine.WDT(timeout=1000)
tell("motors", "on " + VERSION)
try:
    while True:
        dog.feed()
        time.sleep_ms(5)
except BaseException as error:
    tell("crash.log", repr(error) + "\\n", "a")
    raise
finally:
    tell("motors", "off")
"""


def version(text):
    """A small firmware that reports its version."""
    files = {
        "main.py": CELL,
        "mdms_protocol/__init__.py": b"",
        "mdms_protocol/version.py": f"VERSION = {text!r}\n".encode(),
        "boards/table.bin": random.Random(text).randbytes(6000),
    }
    return Firmware(files, text)


OLD, NEW = version("old"), version("new")
KEPT = {"settings0.bin": b"\x00\x01", "boot.py": b"", "crash.log": b"before\n"}
STALE = {
    "mdms_protocol/version.mpy": b"M\x06",
    "mdms.mpy": b"M\x06",
    "binascii.mpy": b"M\x06",
    "mdms_protocol/x.py": b"1",
    "mdms_gone.mpy": b"M\x06",
}


def flash(board, firmware, force=False):
    """Flash, restart, and return the plan that was carried out."""
    with BoardLink(board.port, MonotonicClock()) as link:
        identify(link)
        found = survey(link, firmware)
        plan = plan_flash(found, firmware, force=force)
        if plan.written:
            carry_out(link, firmware, plan, found, lambda _share: None)
        assert survey(link, firmware).has(firmware)
        link.restart()
    return plan


def traffic_of(board, firmware):
    """How many bytes a board receives while it is flashed.

    On a busy machine it may be asked for its prompt again, for a few bytes more than others are.
    """
    board.wait_for("motors", "on old")
    board.fuse_bytes = plenty = 1 << 30
    flash(board, firmware)
    return plenty - board.fuse_bytes


def cut_off(board, firmware):
    """Flash a board whose fuse blows meanwhile; its port does not come back."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(board_link, "_RETURN_S", 0.0)
        with pytest.raises(NoBoardError):
            flash(board, firmware)
    board.unplug()


def files_of(board):
    return {
        str(path.relative_to(board.flash)): path.read_bytes()
        for path in board.flash.rglob("*")
        if path.is_file()
    }


def firmware_on(board):
    """The content of its flash, except files that a cell writes itself."""
    left = files_of(board)
    return {path: left[path] for path in left.keys() - KEPT.keys() - {"motors"}}


def imported_from(board, module):
    """The file that a board imports a module from; its program is restarted."""
    with BoardLink(board.port, MonotonicClock()) as link:
        link.run(f"import sys, {module}")
        told = link.ask(f"sys.modules[{module!r}].__file__")
        link.restart()
    return told
