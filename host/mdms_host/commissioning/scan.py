"""What is on the bus: every node, its identity and its state."""

from dataclasses import dataclass

import can
from rich.markup import escape
from rich.table import Table

from mdms_host.clock import Clock
from mdms_host.commissioning.network import Commissioning, CommissioningError, Identity
from mdms_protocol.codecs import cob, nmt

STATE_NAMES = {
    nmt.INITIALISING: "initialising",
    nmt.STOPPED: "stopped",
    nmt.OPERATIONAL: "operational",
    nmt.PRE_OPERATIONAL: "pre-operational",
}


@dataclass(frozen=True, slots=True)
class FoundNode:
    """A node that sends or answers: its state, None without a heartbeat, and its identity.

    `identity` is None if it could not be read; `problem` is the reason, or why a run cannot use it.
    """

    node_id: int
    state: str | None
    identity: Identity | None
    problem: str | None

    @property
    def is_cell(self) -> bool:
        """Whether it is a cell of our kind."""
        return self.identity is not None and self.identity.is_cell


def scan_bus(bus: can.BusABC, clock: Clock, listen_s: float = 0.3) -> list[FoundNode]:
    """All nodes in the order of their ids; closes the bus. Raises DeviceGoneError."""
    with Commissioning(bus, clock) as commissioning:
        return [_read_node(commissioning, node_id) for node_id in commissioning.find(listen_s)]


def scan_table(nodes: list[FoundNode]) -> Table:
    """The nodes as a table."""
    table = Table("node", "state", "device", "software", "serial", "remark")
    for node in nodes:
        identity = node.identity
        table.add_row(
            str(node.node_id),
            node.state or "no heartbeat",
            escape(identity.name) if identity else "?",
            escape(identity.software) if identity else "",
            f"{identity.serial:08X}" if identity else "",
            escape(node.problem or ""),
        )
    return table


def _read_node(commissioning: Commissioning, node_id: int) -> FoundNode:
    identity, problem = None, None
    try:
        identity = commissioning.identity(node_id)
        problem = _problem(node_id, identity)
    except CommissioningError as error:
        problem = str(error)
    state = commissioning.states.get(node_id)
    return FoundNode(node_id, None if state is None else STATE_NAMES[state], identity, problem)


def _problem(node_id: int, identity: Identity) -> str | None:
    if not identity.is_cell:
        return "not an MDMS cell"
    problems = [identity.other_protocol] if identity.other_protocol else []
    if node_id == cob.HOST_NODE:
        problems.append(
            "has the host's own node id; give it another: mdms configure assign --from FILE"
        )
    return "; ".join(problems) or None
