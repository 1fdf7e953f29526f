"""The array's key, with which bundles are signed: made, and given to cells that have none."""

from collections.abc import Callable, Sequence
from pathlib import Path

from mdms_host.cli.streams import say
from mdms_host.commissioning.array_file import FiledCell
from mdms_host.commissioning.network import Commissioning, CommissioningError
from mdms_host.updating.bundles import key_beside, key_id, make_key, read_key
from mdms_host.updating.candidates import give_key, read_candidate


def array_key(named: Path | None, array: Path | None) -> bytes | None:
    """The key in the file that was named, made if it is missing; else the one beside the array.

    None where neither is there. Raises KeyFileError, OSError.
    """
    if named is not None:
        if not named.exists():
            say(f"mdms: {named} is the array's new key; keep it safe, and out of version control")
            return make_key(named)
        return read_key(named)
    beside = None if array is None else key_beside(array)
    return read_key(beside) if beside is not None and beside.exists() else None


def give_keys(
    commissioning: Commissioning,
    cells: Sequence[FiledCell],
    key: bytes,
    report: Callable[[str], None],
) -> dict[str, str]:
    """Give the key to all cells that have room for firmware; why it failed, by serial number."""
    failed = {}
    for cell in cells:
        name = f"{cell.serial:08X}"
        try:
            identity = commissioning.identity(cell.node_id)
            candidate = read_candidate(commissioning, cell.node_id, identity)
            if candidate.refusal:
                report(f"{name}: no key: {candidate.refusal}")
            elif give_key(commissioning, candidate, key, key_id(key)):
                report(f"{name}: has the update key {key_id(key).hex()} now")
        except CommissioningError as error:
            failed[name] = str(error)
    return failed
