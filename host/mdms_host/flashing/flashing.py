"""Brings firmware onto a board so that the power may fail at any moment.

`main.py` goes first and comes last: whatever is half done does not start, and can be flashed again.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from mdms_host.flashing.board_link import BoardError, BoardLink
from mdms_host.flashing.board_rom import deploy
from mdms_host.flashing.board_survey import Survey, hashes_of, survey
from mdms_host.flashing.firmware_build import Firmware
from mdms_host.flashing.firmware_sources import START

_FRESH = "main.new"
#: Until then the blocks of a FAT file system may wait in memory.
_SYNC = "os.sync() if hasattr(os, 'sync') else None"


@dataclass(frozen=True, slots=True)
class Plan:
    """What has to be removed from a board and written to it, by path, in bytes together.

    `rom` is the image for its ROMFS, None where that stays as it is.
    """

    stale: tuple[str, ...] = ()
    written: tuple[str, ...] = ()
    rom: bytes | None = None
    size: int = 0


def plan_flash(found: Survey, firmware: Firmware, *, force: bool = False) -> Plan:
    """What brings a board from what it has to the firmware; all of it when forced."""
    wanted = hashes_of(firmware)
    if found.has(firmware) and not force:
        return Plan()
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
    return Plan(stale, tuple(written), rom, size)


def carry_out(
    link: BoardLink,
    firmware: Firmware,
    plan: Plan,
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
