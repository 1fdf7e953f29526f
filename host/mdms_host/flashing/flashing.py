"""Brings firmware onto a board so that the power may fail at any moment.

`main.py` goes first and comes last: whatever is half done does not start, and can be flashed again.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mdms_host.flashing.board_link import BoardError, BoardLink
from mdms_host.flashing.board_survey import START, Firmware, Survey, hashes_of, survey

_FRESH = "main.new"
#: Until then the blocks of a FAT file system may wait in memory.
_SYNC = "os.sync() if hasattr(os, 'sync') else None"


@dataclass(frozen=True, slots=True)
class Plan:
    """What has to be removed from a board and written to it, by path."""

    stale: tuple[str, ...]
    written: tuple[str, ...]
    size: int


def plan_flash(found: Survey, firmware: Firmware, *, force: bool = False) -> Plan:
    """What brings a board from what it has to the firmware; all of it when forced."""
    wanted = hashes_of(firmware)
    if found.has(firmware) and not force:
        return Plan((), (), 0)
    stale = tuple(path for path in found.hashes if path not in wanted)
    # Whatever changes, main.py is away meanwhile, so it is written anew.
    written = [
        path
        for path, digest in wanted.items()
        if force or path == START or found.hashes.get(path) != digest
    ]
    written.sort(key=lambda path: path == START)
    return Plan(stale, tuple(written), sum(len(firmware.files[path]) for path in written))


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
    for path in plan.written:
        _write(link, _FRESH if path == START else path, firmware.files[path])
        done += len(firmware.files[path])
        progress(done / plan.size)
    link.run(_SYNC)
    wanted = hashes_of(firmware)
    _verify(link, {_FRESH if path == START else path: wanted[path] for path in wanted})
    link.run(f"os.rename(_root + '/{_FRESH}', _root + '/{START}'); {_SYNC}")
    _verify(link, wanted)


def _write(link: BoardLink, path: str, data: bytes) -> None:
    root = link.ask("_root")
    link.run(f"_make_folders({path!r})")
    link.write(f"{root}/{path}", data)


def _verify(link: BoardLink, wanted: Mapping[str, bytes]) -> None:
    found = survey(link, wanted).hashes
    wrong = [path for path in wanted if found.get(path) != wanted[path]]
    if wrong:
        raise BoardError(f"{wrong[0]} did not arrive whole; flash it again")
