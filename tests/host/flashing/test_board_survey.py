from dataclasses import replace

import pytest

from mdms_host.flashing.board_link import BoardError
from mdms_host.flashing.board_survey import (
    BoardInfo,
    Firmware,
    Survey,
    VersionError,
    check_suits,
    hashes_of,
)

FIRMWARE = Firmware({"main.py": b"1", "cell.mpy": b"M\x06\x1f"}, "abc")
PYBOARD = BoardInfo("PYBv1.1 with STM32F405RG", "pybv11", (1, 28, 0), 6, "00", "/flash", "/flash")


def test_micropython_with_can_suits():
    check_suits(PYBOARD, FIRMWARE)
    assert PYBOARD.release == "1.28.0"


def test_older_micropython_is_refused_with_what_to_do():
    with pytest.raises(VersionError, match=r"MicroPython 1.27.2 has no machine.CAN; install 1.28"):
        check_suits(replace(PYBOARD, micropython=(1, 27, 2)), FIRMWARE)


def test_other_bytecode_is_refused():
    with pytest.raises(VersionError, match=r"reads .mpy files of version 7, the firmware has 6"):
        check_suits(replace(PYBOARD, mpy=7), FIRMWARE)


def test_board_that_starts_from_its_card_is_refused():
    with pytest.raises(BoardError, match="take the card out"):
        check_suits(replace(PYBOARD, folder="/sd"), FIRMWARE)


def test_firmware_is_there_only_with_every_file_and_no_other():
    hashes = hashes_of(FIRMWARE)
    assert Survey(hashes, "abc").has(FIRMWARE)
    assert not Survey(hashes | {"cell.py": b""}, "abc").has(FIRMWARE)
    assert not Survey({"main.py": hashes["main.py"]}, "abc").has(FIRMWARE)
    assert not Survey(hashes | {"main.py": b""}, "abc").has(FIRMWARE)
