from dataclasses import replace

import pytest

from mdms_host.flashing.board_link import BoardError
from mdms_host.flashing.board_survey import BoardInfo
from mdms_host.flashing.firmware import START, Firmware
from mdms_host.flashing.flashing import COPIES_HEAP, ROM_HEAP, VersionError, firmware_for
from mdms_protocol.version import VERSION

pytest.importorskip("mpremote", reason="mpremote is not installed")

ARMV7EMSP = 7 << 10 | 3 << 8
PYBOARD = BoardInfo(
    "PYBv1.1 with STM32F405RG",
    "pybv11",
    (1, 29, 0),
    ARMV7EMSP | 6,
    "00",
    "/flash",
    "/flash",
    heap=COPIES_HEAP,
)
#: Bytecode, and with machine code: its version stands in the lowest bits of the third byte.
COPIES = Firmware({START: b"1", "cell.mpy": b"M\x06\x00\x1f", "loop.mpy": b"M\x06\x1f\x1f"})
#: Of an image with these files.
ROM_SIZE = 4096


def chosen(**differences):
    def compiled(architecture):
        assert architecture == "armv7emsp"
        return COPIES

    return firmware_for(replace(PYBOARD, **differences), compiled)


def test_board_with_memory_gets_copies():
    assert chosen() == COPIES
    assert PYBOARD.release == "1.29.0"


def test_board_with_romfs_gets_an_image():
    firmware = chosen(rom_size=ROM_SIZE, heap=ROM_HEAP)
    assert firmware.files.keys() == {START}
    assert firmware.rom.startswith(b"\xd2\xcd\x31")


def test_board_with_romfs_that_holds_older_firmware_gets_an_image():
    names = ("boards", "mdms_cell", "mdms_protocol")
    assert chosen(rom_size=ROM_SIZE, rom_names=names).rom


@pytest.mark.parametrize("romfs", [{"rom_size": 16}, {"rom_size": ROM_SIZE, "rom_names": ("app",)}])
def test_romfs_that_is_too_small_or_taken_is_left_alone(romfs):
    assert chosen(**romfs) == COPIES


@pytest.mark.parametrize(
    "memory", [{"heap": COPIES_HEAP - 1}, {"heap": ROM_HEAP - 1, "rom_size": ROM_SIZE}]
)
def test_board_with_too_little_memory_is_refused_with_what_to_do(memory):
    with pytest.raises(BoardError, match=r"KB free.*freeze .*firmware/FREEZING.md"):
        chosen(**memory)


def test_board_with_the_same_firmware_frozen_in_gets_main_alone():
    assert chosen(frozen=VERSION, heap=0).files.keys() == {START}


def test_board_with_other_firmware_frozen_in_is_refused_with_what_to_do():
    with pytest.raises(VersionError, match=r"9\.9\.9 is frozen .* has .*firmware/FREEZING.md"):
        chosen(frozen="9.9.9")


def test_older_micropython_is_refused_with_what_to_do():
    with pytest.raises(VersionError, match=r"MicroPython 1.27.2 has no machine.CAN; install 1.28"):
        chosen(micropython=(1, 27, 2))


def test_micropython_without_machine_code_is_refused():
    with pytest.raises(VersionError, match="loads no machine code"):
        chosen(mpy=6)


@pytest.mark.parametrize(
    ("mpy", "version"), [(ARMV7EMSP | 7, r"7\.3"), (7 << 10 | 2 << 8 | 6, r"6\.2")]
)
def test_other_bytecode_is_refused(mpy, version):
    with pytest.raises(VersionError, match=rf"of version {version}, the firmware has 6\.3"):
        chosen(mpy=mpy)


def test_board_that_starts_from_its_card_is_refused():
    with pytest.raises(BoardError, match="take the card out"):
        chosen(folder="/sd")
