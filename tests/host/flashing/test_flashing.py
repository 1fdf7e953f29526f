from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.flashing.board_link import BoardError
from mdms_host.flashing.board_survey import BoardInfo, Survey, hashes_of
from mdms_host.flashing.firmware import START, Firmware
from mdms_host.flashing.flashing import (
    COPIES_HEAP,
    ROM_HEAP,
    FlashPlan,
    VersionError,
    firmware_for,
    plan_flash,
)
from mdms_protocol.version import VERSION

paths = st.sampled_from(["cell.mpy", "boards/a.mpy", "boards/b.mpy", "mdms_cell/c.mpy"])
contents = st.dictionaries(paths, st.sampled_from([b"1", b"2"]))


@given(contents, contents, st.booleans(), st.booleans())
def test_whatever_is_there_main_comes_last_and_all_is_right_in_the_end(
    before, wanted, started, force
):
    there = before | ({START: b"old"} if started else {})
    firmware = Firmware({START: b"new", **wanted}, "v")
    found = Survey(hashes_of(Firmware(there, "")), None)
    plan = plan_flash(found, firmware, force=force)
    assert plan.written[-1] == START
    assert plan.size == sum(len(firmware.files[path]) for path in plan.written)
    after = {path: data for path, data in there.items() if path not in plan.stale}
    after |= {path: firmware.files[path] for path in plan.written}
    assert after == firmware.files
    if force:
        assert set(plan.written) == set(firmware.files)


def test_nothing_is_written_where_nothing_differs():
    firmware = Firmware({START: b"new", "cell.mpy": b"1"}, "v")
    assert plan_flash(Survey(hashes_of(firmware), "v"), firmware) == FlashPlan()


def test_image_is_written_only_where_another_is():
    firmware = Firmware({START: b"new"}, "v", rom=b"image")
    hashes = hashes_of(firmware)
    assert plan_flash(Survey(hashes, "v", rom=True), firmware) == FlashPlan()
    assert plan_flash(Survey(hashes, "v", rom=False), firmware).rom == b"image"
    assert plan_flash(Survey({}, None, rom=True), firmware).rom is None
    assert plan_flash(Survey(hashes, "v", rom=True), firmware, force=True).rom == b"image"


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
def test_board_with_too_little_memory_is_refused_with_a_cure(memory):
    with pytest.raises(BoardError, match=r"KB free.*freeze .*firmware/FREEZING.md"):
        chosen(**memory)


def test_board_with_the_same_firmware_frozen_in_gets_main_alone():
    assert chosen(frozen=VERSION, heap=0).files.keys() == {START}


def test_board_with_other_firmware_frozen_in_is_refused_with_a_cure():
    with pytest.raises(VersionError, match=r"9\.9\.9 is frozen .* has .*firmware/FREEZING.md"):
        chosen(frozen="9.9.9")


def test_older_micropython_is_refused_with_a_cure():
    with pytest.raises(VersionError, match=r"MicroPython 1.27.2 has no machine.CAN; install 1.28"):
        chosen(micropython=(1, 27, 2))
    with pytest.raises(VersionError, match=r"MicroPython 1.28.0 has no machine.CAN; install 1.29"):
        chosen(board="teensy41", micropython=(1, 28, 0))


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
