"""Which cells are on a bus, told apart by their serial numbers: blank, with a node id, or hidden.

A cell is hidden where another has its node id: it has lost the id when it booted, or both answer
at once, and only LSS, which goes by serial numbers, reaches it alone.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from mdms_host.commissioning.cell_settings import StrangerError
from mdms_host.commissioning.lss_master import LssAddress
from mdms_host.commissioning.network import Commissioning, Identity, RefusedError, SilentError
from mdms_protocol.dictionary import PRODUCT_CODE, REVISION, VENDOR_ID


@dataclass(frozen=True, slots=True)
class RollCall:
    """All cells of a bus: identities by node id, addresses of blank ones, and hidden ones.

    `hidden` has the node id that each would have, by its serial number; `strangers` are node ids
    of what is no cell.
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


def call_roll(commissioning: Commissioning) -> RollCall:
    """Ask for all cells.

    Raises StrangerError for cells of another protocol, and for a serial number that is there twice:
    such cells cannot be told apart. Raises LssError.
    """
    found = commissioning.find()
    blank = tuple(commissioning.lss.find_blank())
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
    return RollCall(present, blank, hidden, strangers)


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
