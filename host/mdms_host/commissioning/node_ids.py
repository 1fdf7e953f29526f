"""The cells of a bus by their serial numbers, and the node id that each gets by LSS.

A cell is blank, has a node id, or is hidden. It is hidden where another has its node id: it has
lost the id when it booted, or both answer at once, and only LSS, which goes by serial numbers,
reaches it alone.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from mdms_host.commissioning.cell_settings import StrangerError
from mdms_host.commissioning.lss_master import LssAddress, LssError
from mdms_host.commissioning.network import (
    Commissioning,
    CommissioningError,
    Identity,
    RefusedError,
    SilentError,
    counted,
    operational_text,
)
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.dictionary import PRODUCT_CODE, REVISION, VENDOR_ID


@dataclass(frozen=True, slots=True)
class FoundCells:
    """All cells of a bus: identities by node id, addresses of blank ones, and hidden ones.

    `hidden` has the node id that each would have, by its serial number. `strangers` are node ids of
    participants that are no cells.
    """

    present: Mapping[int, Identity]
    blank: tuple[LssAddress, ...]
    hidden: Mapping[int, int]
    strangers: tuple[int, ...]

    @property
    def serials(self) -> set[int]:
        """The serial numbers of all cells."""
        with_ids = {identity.serial for identity in self.present.values()}
        return with_ids | {address.serial for address in self.blank} | {*self.hidden}

    @property
    def node_ids(self) -> dict[int, int]:
        """Node ids by serial number, of the cells that answer under one."""
        return {identity.serial: node_id for node_id, identity in self.present.items()}


def find_cells(commissioning: Commissioning) -> FoundCells:
    """Ask for all cells.

    Raises StrangerError for cells of another protocol, and for a serial number that is there twice:
    such cells cannot be told apart. Raises LssError.
    """
    found = commissioning.find()
    blank = find_blank(commissioning, found)
    present: dict[int, Identity] = {}
    unclear: list[int] = []
    for node_id in found:
        identity = None
        # Two cells of one id spoil each other's answers.
        with suppress(RefusedError, SilentError):
            identity = commissioning.identity(node_id)
        if identity is None or not identity.is_cell:
            unclear.append(node_id)
            continue
        if identity.other_protocol:
            raise StrangerError(f"node {node_id} {identity.other_protocol}")
        present[node_id] = identity
    known = [*(each.serial for each in present.values()), *(each.serial for each in blank)]
    _refuse_twins(present, blank)
    hidden = {}
    for serial in commissioning.lss.find_beside(known):
        commissioning.lss.select(address(serial))
        hidden[serial] = commissioning.lss.pending_node_id()
        commissioning.lss.leave()
    strangers = tuple(node_id for node_id in unclear if node_id not in hidden.values())
    return FoundCells(present, blank, hidden, strangers)


def find_blank(commissioning: Commissioning, found: Iterable[int]) -> tuple[LssAddress, ...]:
    """All cells without node id; `found` are the node ids that answer. Raises LssError.

    A command that was killed has left cells that answer still, and lose their ids with the next
    restart. They keep these ids.
    """
    blank = commissioning.lss.find_blank()
    for node_id in found if blank else ():
        with suppress(CommissioningError, LssError):
            numbers = (commissioning.read(node_id, indices.IDENTITY, sub) for sub in range(1, 5))
            one = LssAddress(*numbers)
            if one in blank:
                commissioning.lss.select(one)
                commissioning.lss.set_node_id(node_id)
                commissioning.lss.leave()
                blank.remove(one)
    return tuple(blank)


def address(serial: int) -> LssAddress:
    """The LSS address of a cell of this revision by its serial number."""
    return LssAddress(VENDOR_ID, PRODUCT_CODE, REVISION, serial)


def _refuse_twins(present: Mapping[int, Identity], blank: tuple[LssAddress, ...]) -> None:
    nodes: dict[int, str] = {}
    cells = [(identity.serial, f"node {node_id}") for node_id, identity in present.items()]
    cells += [(each.serial, "a blank cell") for each in blank]
    for serial, name in cells:
        other = nodes.setdefault(serial, name)
        if other is not name:
            raise StrangerError(
                f"{other} and {name} have the same serial number {serial:08X}, and cannot be told "
                "apart; take one off the bus"
            )


#: How often a cell is reset at once: frames may be lost.
_RESETS = 3


class NodeIdError(Exception):
    """Node ids that cannot be given; the message has which and why."""


@dataclass(frozen=True, slots=True)
class Assignment:
    """A cell and its node id to be; `before` is None for a blank one."""

    address: LssAddress
    before: int | None
    node_id: int


def address_of(identity: Identity) -> LssAddress:
    """The LSS address of a node by its identity."""
    return LssAddress(identity.vendor_id, identity.product_code, identity.revision, identity.serial)


def refuse_hidden(
    commissioning: Commissioning, blank: Iterable[LssAddress], present: Mapping[int, Identity]
) -> None:
    """Raises NodeIdError where cells are silent because another has their node id; LssError."""
    known = [each.serial for each in blank] + [each.serial for each in present.values()]
    if hidden := commissioning.lss.find_beside(known):
        names = ", ".join(f"{serial:08X}" for serial in hidden)
        raise NodeIdError(
            f"silent, since another cell has the node id: {names}; mdms commission gives each its "
            "own"
        )


def assign_in_order(
    blank: Iterable[LssAddress], taken: Iterable[int], first: int
) -> list[Assignment]:
    """Blank cells by their serial numbers get the free node ids from `first` on.

    Raises NodeIdError when they do not last.
    """
    cells = sorted(blank, key=lambda address: address.serial)
    free = sorted(set(range(first, cob.CELL_NODE_MAX + 1)) - set(taken))
    if len(free) < len(cells):
        raise NodeIdError(
            f"{counted(len(cells), 'blank cell')}, and "
            f"{counted(len(free), 'free node id')} from {first} to "
            f"{cob.CELL_NODE_MAX}"
        )
    return [Assignment(address, None, free[place]) for place, address in enumerate(cells)]


def refuse_host_node(wanted: Mapping[int, int]) -> None:
    """Raises NodeIdError where a cell, by its serial number, is to get the host's node id."""
    for serial, node_id in wanted.items():
        if node_id == cob.HOST_NODE:
            raise NodeIdError(
                f"{serial:08X}: node id {node_id} is the host's own; give it one from "
                f"{cob.NODE_MIN} to {cob.CELL_NODE_MAX}"
            )


def assign_by_serial(
    wanted: Mapping[int, int],
    blank: Iterable[LssAddress],
    present: Mapping[int, Identity],
    taken: Iterable[int],
) -> list[Assignment]:
    """Cells get the node ids that stand by their serial numbers, blank or not.

    `present` has which cell answers under which node id, `taken` all node ids that are in use.
    Raises NodeIdError for serial numbers that are not on the bus, or twice, and for node ids
    that others have, or the host.
    """
    refuse_host_node(wanted)
    cells = [(address, None) for address in blank]
    known = [*cells, *((address_of(who), node_id) for node_id, who in present.items())]
    absent = wanted.keys() - {address.serial for address, _ in known}
    if absent:
        names = ", ".join(f"{one:08X}" for one in sorted(absent))
        raise NodeIdError(
            f"not on the bus: {names}; is it powered, or has another cell its node id? mdms doctor "
            "tells, and mdms commission gives each its own"
        )
    serials = [address.serial for address, _ in known if address.serial in wanted]
    twice = {serial for serial in serials if serials.count(serial) > 1}
    if twice:
        raise NodeIdError(f"two cells have the serial number {min(twice):08X}")
    moves = [
        Assignment(address, node_id, wanted[address.serial])
        for address, node_id in known
        if address.serial in wanted and wanted[address.serial] != node_id
    ]
    staying = set(taken) - {move.before for move in moves}
    for move in moves:
        if move.node_id in staying:
            raise NodeIdError(f"node id {move.node_id} is another cell's, which is to keep it")
    return sorted(moves, key=lambda move: move.node_id)


def carry_out(
    commissioning: Commissioning,
    moves: Sequence[Assignment],
    report: Callable[[Assignment], None],
) -> list[Assignment]:
    """Give the node ids, have the cells store them, and wait until every cell boots with its own.

    Returns those whose board stores no settings: they are blank again after a loss of power.

    Cells that have another id become blank first, so that ids can be swapped. The stored id changes
    only with the new one. Raises NodeIdError before anything, LssError, SilentError.
    """
    before = [move.before for move in moves if move.before is not None]
    running = [node_id for node_id in before if _runs(commissioning, node_id)]
    if running:
        raise NodeIdError(operational_text(running))
    lss = commissioning.lss
    for move in moves:
        if move.before is not None:
            lss.select(move.address)
            lss.set_node_id(cob.NODE_NONE)
            lss.leave()
            # No answer tells whether it has come.
            for _ in range(_RESETS):
                commissioning.command(nmt.RESET_NODE, move.before)
    passing: list[Assignment] = []
    for move in moves:
        lss.select(move.address)
        try:
            lss.set_node_id(move.node_id)
            stored = lss.store()
        except BaseException:
            # It would boot with an id that it has not stored, and that nobody would give it again.
            with suppress(LssError):
                lss.set_node_id(cob.NODE_NONE)
            lss.leave()
            raise
        if not stored:
            passing.append(move)
        commissioning.expect_boot(move.node_id)
        lss.leave()
        _await_boot(commissioning, move)
        report(move)
    return passing


def _await_boot(commissioning: Commissioning, move: Assignment) -> None:
    try:
        commissioning.await_boot(move.node_id)
    except SilentError:
        # Its boot-up message may be lost.
        if commissioning.read(move.node_id, indices.IDENTITY, 4) != move.address.serial:
            raise


def _runs(commissioning: Commissioning, node_id: int | None) -> bool:
    return node_id is not None and commissioning.states.get(node_id) == nmt.OPERATIONAL
