"""What is on the bus: every node, who it is, and in which state."""

from dataclasses import dataclass

import can
from rich.table import Table

from mdms_host.clock import Clock
from mdms_host.commissioning.network import Commissioning, CommissioningError, Identity
from mdms_protocol import nmt

STATE_NAMES = {
    nmt.INITIALISING: "initialising",
    nmt.STOPPED: "stopped",
    nmt.OPERATIONAL: "operational",
    nmt.PRE_OPERATIONAL: "pre-operational",
}


@dataclass(frozen=True, slots=True)
class FoundNode:
    """A node that spoke: its state, None if it sends no heartbeat, and who it is.

    `identity` is None if it would not say; `problem` then tells why, or why it is not a cell.
    """

    node_id: int
    state: str | None
    identity: Identity | None
    problem: str | None

    @property
    def is_cell(self) -> bool:
        """Whether it is a cell that this host knows how to talk to."""
        return self.identity is not None and self.identity.is_cell


def scan(bus: can.BusABC, clock: Clock, listen_s: float = 0.3) -> list[FoundNode]:
    """All nodes in the order of their ids; closes the bus. Raises DeviceGoneError."""
    with Commissioning(bus, clock) as commissioning:
        return [_look_at(commissioning, node_id) for node_id in commissioning.find(listen_s)]


def scan_table(nodes: list[FoundNode]) -> Table:
    """The nodes as people like to read them."""
    table = Table("node", "state", "device", "software", "serial", "remark")
    for node in nodes:
        who = node.identity
        table.add_row(
            str(node.node_id),
            node.state or "no heartbeat",
            who.name if who else "?",
            who.software if who else "",
            f"{who.serial:08X}" if who else "",
            node.problem or "",
        )
    return table


def _look_at(commissioning: Commissioning, node_id: int) -> FoundNode:
    identity, problem = None, None
    try:
        identity = commissioning.identity(node_id)
        problem = None if identity.is_cell else "not an MDMS cell"
    except CommissioningError as error:
        problem = str(error)
    state = commissioning.states.get(node_id)
    return FoundNode(node_id, None if state is None else STATE_NAMES[state], identity, problem)
