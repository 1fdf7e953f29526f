"""The settings of single cells over the bus: read, compared, changed one by one, and verified."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass

from mdms_host.commissioning.network import (
    Commissioning,
    CommissioningError,
    Identity,
    RefusedError,
    SilentError,
)
from mdms_host.commissioning.parameters import Parameter

_GAIN = ".gain"


class StrangerError(CommissioningError):
    """A node that is no cell, or has another object table than this host."""


class NotTakenError(CommissioningError):
    """A cell has confirmed a setting, and reads back another value."""


@dataclass(frozen=True, slots=True)
class CellSettings:
    """A cell and its settings, in the integers of the wire."""

    node_id: int
    serial: int
    values: Mapping[Parameter, int]

    def changes(self, wanted: Mapping[Parameter, int]) -> "list[Change]":
        """The settings to write so that the cell has the wanted ones.

        Gains fall before and rise after all else, so that a loop has its margin on the way too.
        """
        changes = (
            Change(self.node_id, parameter, self.values[parameter], number)
            for parameter, number in wanted.items()
            if self.values[parameter] != number
        )
        return sorted(changes, key=_order)


@dataclass(frozen=True, slots=True)
class Change:
    """One setting of one node, before and after, in the integers of the wire."""

    node_id: int
    parameter: Parameter
    before: int
    after: int


def _order(change: Change) -> int:
    """-1 for a gain that falls, 1 for one that rises, 0 for anything else."""
    if not change.parameter.name.endswith(_GAIN):
        return 0
    return 1 if change.after > change.before else -1


def check_identity(node_id: int, identity: Identity) -> None:
    """Raises StrangerError for a node that is no cell, or one of another object table."""
    if not identity.is_cell:
        raise StrangerError(f"node {node_id} is {identity.name!r}, not an MDMS cell")
    if identity.other_protocol:
        raise StrangerError(f"node {node_id} {identity.other_protocol}")


def identify_cells(commissioning: Commissioning, node_ids: Iterable[int]) -> dict[int, Identity]:
    """Identities of the cells among these nodes, by node id; those that tell none are left out.

    Raises StrangerError for a serial number that is there twice, DeviceGoneError.
    """
    cells: dict[int, Identity] = {}
    for node_id in node_ids:
        with suppress(RefusedError, SilentError):
            identity = commissioning.identity(node_id)
            if identity.is_cell:
                cells[node_id] = identity
    nodes: dict[int, int] = {}
    for node_id, identity in cells.items():
        other = nodes.setdefault(identity.serial, node_id)
        if other != node_id:
            raise StrangerError(
                f"node {other} and node {node_id} have the same serial number "
                f"{identity.serial:08X}, and cannot be told apart"
            )
    return cells


def read_settings(
    commissioning: Commissioning, node_id: int, parameters: Iterable[Parameter]
) -> CellSettings:
    """The identity of a node, and some of its settings.

    Raises StrangerError, SilentError, RefusedError, DeviceGoneError.
    """
    identity = commissioning.identity(node_id)
    check_identity(node_id, identity)
    values = {each: commissioning.read(node_id, *each.place) for each in parameters}
    return CellSettings(node_id, identity.serial, values)


def apply_changes(commissioning: Commissioning, changes: Iterable[Change]) -> None:
    """Write settings one by one, and read each back.

    Raises SilentError, RefusedError, NotTakenError, DeviceGoneError at the first that fails.
    """
    for change in changes:
        place = change.parameter.place
        commissioning.write(change.node_id, *place, change.after)
        found = commissioning.read(change.node_id, *place)
        if found != change.after:
            parameter = change.parameter
            raise NotTakenError(
                f"node {change.node_id}, {parameter.name}: {parameter.text(change.after)} was "
                f"written, and {parameter.text(found)} is read"
            )
