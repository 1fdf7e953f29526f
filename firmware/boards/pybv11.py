"""PYBv1.1 (STM32F405, 168 MHz); pins as in the wiring table of docs/boards.md.

Its settings lie in sectors of internal flash, behind a file system that leaves room for them.

MicroPython's STM32 port writes its internal flash through one cache in RAM that holds a sector. A
write changes the cache. A sync erases the sector and programs all of it. If power fails meanwhile,
the whole sector is lost with all its files, under LittleFS as under FAT. So the settings are no
files. Each bank has a sector that no file system uses, and a save touches the sector of one bank.

`make_room` makes the smaller file system. Before that, settings are read but not written. The same
holds after the port has made a new file system over all of the flash.

This is for flash without error correction, as an STM32F405 has. There, a read after a write that
was cut off returns some number. For flash with error correction see `nucleo_g474re`.
"""

from machine import (
    Pin,
    mem16,  # pyright: ignore[reportAttributeAccessIssue] - not in the stubs
)
from pyb import Flash

from boards import can_filters
from boards.stm32 import Pins, Stm32Board
from mdms_protocol.codecs import update

PINS = Pins(
    pwm_timer=12,
    pwm_hz=84_000_000,  # of timers on APB1
    pulses=("Y7", "Y8"),
    phases=("X7", "X8"),
    encoders=((4, "X9", "X10"), (8, "Y1", "Y2")),
    currents=("X19", "X20"),
    wake="Y5",
    fault="X11",
    sensors=("X1", "X2", "X3", "X4", "X6"),
    place=("X5", "X12", "Y6", "Y9", "Y10", "Y11", "Y12"),
    supply="X21",
    run_led="A14",
    error_led="A13",
    filters=can_filters.bxcan,
    receive="Y3",
)

BANK_SIZE = 4096
_BLOCK = 512
_BLANK = b"\xff" * _BLOCK
_SYNC = 3  # an operation of `ioctl`
_FAT_SIGNATURE = b"\x55\xaa"

#: Where the flash of `pyb.Flash` begins, as the port's linker script has it.
_ADDRESS = 0x08004000
#: The banks, as offsets behind sectors 1 and 2 (16 KB each) with the file system, which ends where
#: the first of them begins: sectors 3 (16 KB) and 4 (64 KB).
BANKS = (0x8000, 0xC000)


def board():
    """The board with both wheels off; `start` brings it to life."""
    return Stm32Board(PINS, Sectors, update.PYBV11)


def held():
    """Whether the user button is pressed, which keeps the firmware from starting."""
    return not Pin("B3", Pin.IN, Pin.PULL_UP).value()


# Settings in flash --------------------------------------------------------------------------------


class Sectors:
    """Two banks of bytes; the store never writes to the bank whose content is in use.

    Erasing and programming stop the processor, for 4 s at worst, so nothing is written unless
    `asleep()` reports that no bridge is awake.
    """

    def __init__(self, asleep):
        self._flash = Flash(start=0)
        self._asleep = asleep

    def read(self, bank):
        """The bank up to its first blank block.

        It is read from flash directly. The port would answer from its cache, and the cache may
        differ from the flash.
        """
        start = _ADDRESS + BANKS[bank]
        content = b""
        for address in range(start, start + BANK_SIZE, _BLOCK):
            block = _stored(address)
            if block == _BLANK:
                break
            content += block
        return content

    def erase(self, _bank):
        """Nothing: the port erases the sector when it is written."""

    def write(self, bank, offset, data):
        """Replace the contents of the bank."""
        if offset or len(data) > BANK_SIZE:
            raise OSError("settings are written in one piece of %d bytes at most" % BANK_SIZE)
        if not self._asleep():
            raise OSError("flash is written only while both bridges sleep")
        size = _file_system_size(self._flash)
        if size is None or size > BANKS[0]:
            raise OSError("the file system leaves no room for settings")
        write_blocks(self._flash, BANKS[bank], data)


def make_room():
    """Make a new file system that leaves room for the settings.

    To be called once, from the prompt; it erases all files and settings. Reset the board after it.
    """
    import vfs  # once in a board's life

    try:  # noqa: SIM105 - MicroPython has no contextlib
        vfs.umount("/flash")
    except OSError:
        pass  # there was none that could be mounted
    vfs.VfsFat.mkfs(Flash(start=0, len=BANKS[0]))
    for start in BANKS:
        write_blocks(Flash(start=0), start, b"")


def write_blocks(flash, start, data):
    """Write a bank from `start` on, blank behind the data, and have the port program it."""
    for place in range(0, BANK_SIZE, _BLOCK):
        piece = data[place : place + _BLOCK]
        block = piece + _BLANK[len(piece) :]
        if flash.writeblocks((start + place) // _BLOCK, block):
            raise OSError("flash takes no block")
    flash.ioctl(_SYNC, 0)


def _file_system_size(flash):
    """Bytes of the FAT volume that the flash begins with, None if there is none."""
    first = bytearray(_BLOCK)
    flash.readblocks(0, first)
    if first[-2:] != _FAT_SIGNATURE or int.from_bytes(first[11:13], "little") != _BLOCK:
        return None
    blocks = int.from_bytes(first[19:21], "little") or int.from_bytes(first[32:36], "little")
    return blocks * _BLOCK


def _stored(address):
    """Return the contents of a block of flash."""
    block = bytearray(_BLOCK)
    for place in range(0, _BLOCK, 2):
        half_word = mem16[address + place]
        block[place] = half_word & 0xFF
        block[place + 1] = half_word >> 8
    return block
