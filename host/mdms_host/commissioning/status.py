"""The nodes on a bus: their identities and states, and a table of how cells are."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import can
from rich import box
from rich.markup import escape
from rich.table import Table

from mdms_host.can_link.remote_cell import UPDATE_S, RemoteCell, takes_firmware
from mdms_host.can_link.sdo_client import Read, SdoClient
from mdms_host.clock import Clock
from mdms_host.commissioning.network import (
    HEAR_S,
    Commissioning,
    CommissioningError,
    Identity,
)
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import PRODUCT_CODE, VENDOR_ID
from mdms_protocol.emergencies import (
    IN_ANOTHERS_PLACE,
    PLACE_SOURCE,
    error_text,
    is_elsewhere,
)

STATE_NAMES = {
    nmt.INITIALISING: "initialising",
    nmt.STOPPED: "stopped",
    nmt.OPERATIONAL: "operational",
    nmt.PRE_OPERATIONAL: "pre-operational",
}


#: Where a cell has stored the node ids of those around it.
NEIGHBOURS = tuple((indices.NEIGHBOURS, sub) for sub in range(1, 9))


@dataclass(frozen=True, slots=True)
class FoundNode:
    """A node that sends or answers: its state, None without a heartbeat, and its identity.

    `identity` is None if it could not be read; `problem` is the reason, or why a run cannot use it.
    `neighbours` are the node ids that it has stored of the cells around it.
    """

    node_id: int
    state: str | None
    identity: Identity | None
    problem: str | None
    neighbours: tuple[int, ...] = ()

    @property
    def is_cell(self) -> bool:
        """Whether it is a cell of our kind."""
        return self.identity is not None and self.identity.is_cell


def scan_bus(bus: can.BusABC, clock: Clock, listen_s: float = 0.3) -> list[FoundNode]:
    """All nodes in the order of their ids; closes the bus. Raises DeviceGoneError."""
    with Commissioning(bus, clock) as commissioning:
        return [_read_node(commissioning, node_id) for node_id in commissioning.find(listen_s)]


def scan_table(nodes: Mapping[str, Sequence[FoundNode]]) -> Table:
    """The nodes of each bus as a table."""
    split = len(nodes) > 1
    names = ("bus",) if split else ()
    table = Table()
    for name in (*names, "node", "state", "device", "software", "serial", "remark"):
        table.add_column(name, overflow="fold", no_wrap=name == "node")
    for bus, node in ((bus, node) for bus, some in nodes.items() for node in some):
        identity = node.identity
        table.add_row(
            *((escape(bus),) if split else ()),
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
    neighbours: list[int] = []
    try:
        identity = commissioning.identity(node_id)
        problem = _problem(node_id, identity)
        if identity.is_cell and not identity.other_protocol:
            neighbours = [commissioning.read(node_id, *place) for place in NEIGHBOURS]
    except CommissioningError as error:
        problem = str(error)
    state = commissioning.states.get(node_id)
    name = None if state is None else STATE_NAMES[state]
    return FoundNode(node_id, name, identity, problem, tuple(filter(None, neighbours)))


def _problem(node_id: int, identity: Identity) -> str | None:
    if not identity.is_cell:
        return "not an MDMS cell"
    problems = [identity.other_protocol] if identity.other_protocol else []
    if node_id == cob.HOST_NODE:
        problems.append(
            "has the host's own node id; give it another: mdms configure assign --from FILE"
        )
    return "; ".join(problems) or None


_STATUSWORDS = (indices.STATUSWORD, indices.STATUSWORD + indices.AXIS_OFFSET)
_ERROR_CODES = (indices.ERROR_CODE, indices.ERROR_CODE + indices.AXIS_OFFSET)
#: Vendor and product: only the first is there for certain (CiA 301, 7.5.2.21).
_KIND = {(indices.IDENTITY, 1): VENDOR_ID, (indices.IDENTITY, 2): PRODUCT_CODE}
_READS = (
    *(Read(*place) for place in _KIND),
    *(Read(index, 0) for index in (*_STATUSWORDS, indices.PRESENCE)),
    *(Read(index, 0) for index in (*_ERROR_CODES, indices.SUSPECT, indices.ERROR_REGISTER)),
    *(Read(*place) for place in NEIGHBOURS),
)
#: A cell that is silent for longer is shown as such: three heartbeats at their default period.
_SILENT_S = 0.35
_POLL_S = 0.1
_M_PER_UM = pdo.ACTUAL_VELOCITY.entries[0].unit.factor


@dataclass(frozen=True, slots=True)
class CellStatus:
    """One row: the last report of the cell; None without one.

    `emergency` is the code of its last error that stands, `errors` are all that stand, in words.
    `suspected_by` are the node ids of neighbours that it contradicts. `bus` is its bus, where a
    table has several.
    """

    node_id: int
    state: str | None
    silent_s: float | None
    drives: tuple[str, ...] | None
    presence: int | None
    speeds_m_s: tuple[float, ...] | None
    emergency: int | None
    errors: tuple[str, ...] = ()
    suspected_by: tuple[int, ...] = ()
    bus: str | None = None

    @property
    def in_fault(self) -> bool:
        """Whether an axis of it is in fault, an error of it stands, or a neighbour suspects it."""
        told = self.errors or self.suspected_by
        return bool(told) or any("fault" in name for name in self.drives or ())

    @property
    def silent(self) -> bool:
        """Whether its heartbeat is overdue."""
        return self.silent_s is None or self.silent_s > _SILENT_S


class StatusModel:
    """A participant that keeps the last state of every node on the bus.

    It sends little: the kind of a node, its state and the node ids of the cells around it are read
    when it appears, and when it is pre-operational again. An operational node reports changes by
    itself. While firmware comes in over the bus, nothing is sent: a request would break it off.
    """

    def __init__(self) -> None:
        self._cells: dict[int, RemoteCell] = {}
        self._reading: dict[int, SdoClient] = {}
        self._next_poll_s = 0.0
        self._quiet_until_s: float | None = None
        #: Whether firmware has come in over the bus.
        self.update_ran = False
        #: The node ids that each node has stored of the cells around it, once it is read.
        self.neighbours: dict[int, tuple[int, ...]] = {}
        #: The nodes that say that they are no cells.
        self.strangers: set[int] = set()

    @property
    def wake_s(self) -> float:
        """When to poll it next [s]."""
        wake_s = min((each.wake_s for each in self._reading.values()), default=self._next_poll_s)
        return wake_s if self._quiet_until_s is None else max(wake_s, self._quiet_until_s)

    @property
    def cells(self) -> frozenset[int]:
        """The nodes that have appeared so far, without strangers."""
        return frozenset(self._cells.keys() - self.strangers)

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Take in a node's frame; a node appears with its first heartbeat."""
        if takes_firmware(frame):
            self.update_ran, self._quiet_until_s = True, now_s + UPDATE_S
        node_id = frame.can_id & 0x7F
        base = frame.can_id - node_id
        is_node = base == cob.HEARTBEAT_BASE and cob.NODE_MIN <= node_id < cob.NODE_MAX
        if is_node and node_id not in self._cells:
            self._cells[node_id] = RemoteCell(node_id, node_id)
            self._reading[node_id] = SdoClient(node_id, _READS)
        if node_id not in self._cells:
            return
        cell = self._cells[node_id]
        before = cell.nmt_state
        cell.on_frame(frame.can_id, frame.data, now_s)
        if cell.nmt_state == nmt.PRE_OPERATIONAL and before not in (None, nmt.PRE_OPERATIONAL):
            self._reading[node_id] = SdoClient(node_id, _READS)
        if base == cob.SDO_RESPONSE_BASE and node_id in self._reading:
            self._on_answer(node_id, frame.data)

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The reads that are due."""
        self._next_poll_s = now_s + _POLL_S
        if self._quiet_until_s is None:
            self._quiet_until_s = now_s + HEAR_S
        if now_s < self._quiet_until_s:
            return
        for node_id, client in list(self._reading.items()):
            yield from client.poll(now_s)
            self._take(node_id)

    def rows(self, now_s: float) -> list[CellStatus]:
        """All nodes that have appeared so far, by node id."""
        return [_row(self._cells[node_id], now_s, self._cells) for node_id in sorted(self._cells)]

    def _on_answer(self, node_id: int, data: bytes) -> None:
        self._reading[node_id].on_response(data)
        self._take(node_id)

    def _take(self, node_id: int) -> None:
        """Take over the answers of a node that has been asked for all, or refuses to go on."""
        client, cell = self._reading.get(node_id), self._cells[node_id]
        if client is None or not (client.done or client.failure):
            return
        del self._reading[node_id]
        answers = client.answers
        if any(answers.get(place, kind) != kind for place, kind in _KIND.items()):
            self.strangers.add(node_id)
        if client.done:
            named = (answers.get(place, 0) for place in NEIGHBOURS)
            self.neighbours[node_id] = tuple(filter(None, named))
        if not all((index, 0) in answers for index in _STATUSWORDS):
            return
        if cell.drive_states is None or cell.nmt_state != nmt.OPERATIONAL:
            words = (answers[index, 0] for index in _STATUSWORDS)
            cell.drive_states = tuple(cia402.state(word) for word in words)
            cell.presence = answers.get((indices.PRESENCE, 0))
            cell.suspect = cell.suspect or answers.get((indices.SUSPECT, 0), 0)
            for source, index in enumerate(_ERROR_CODES, 1):
                self._on_error_code(cell, source, answers.get((index, 0), 0))
            if is_elsewhere(answers.get((indices.ERROR_REGISTER, 0), 0), cell.suspect):
                cell.errors.setdefault(PLACE_SOURCE, IN_ANOTHERS_PLACE)

    def _on_error_code(self, cell: RemoteCell, source: int, code: int) -> None:
        """An axis in fault has its code in 0x603F, though its emergency came before we listened."""
        states = cell.drive_states
        if code and states is not None and states[source - 1] == cia402.FAULT:
            cell.errors.setdefault(source, code)


def status_table(rows: list[CellStatus], dots: tuple[str, str] = ("●", "○")) -> Table:
    """The rows as a table of 80 columns; presence as the centre sensor and the four around.

    `dots` are the signs of a covered sensor and of a free one. On a narrower terminal every text
    is folded, but for the node ids.
    """
    table = Table(box=box.SIMPLE_HEAD, padding=0, collapse_padding=True)
    split = any(row.bus for row in rows)
    names = ("node", "state", "drives", "parcel", "speeds mm/s", "remark")
    for name in (*(("bus",) if split else ()), *names):
        table.add_column(name, overflow="fold", no_wrap=name == "node")
    for row in rows:
        table.add_row(
            *((escape(row.bus or ""),) if split else ()),
            str(row.node_id),
            row.state or "?",
            _drives(row.drives),
            _dots(row.presence, dots),
            " ".join(f"{speed * 1e3:5.1f}" for speed in row.speeds_m_s or ()),
            _remark(row),
            style="red" if row.silent or row.in_fault else None,
        )
    return table


def _row(cell: RemoteCell, now_s: float, cells: Mapping[int, RemoteCell]) -> CellStatus:
    suspected_by = (node for node in sorted(cells) if cells[node].suspect == cell.node_id)
    states, speeds_um_s = cell.drive_states, cell.speeds_um_s
    return CellStatus(
        node_id=cell.node_id,
        state=None if cell.nmt_state is None else STATE_NAMES[cell.nmt_state],
        silent_s=None if cell.last_heartbeat_s is None else now_s - cell.last_heartbeat_s,
        drives=None if states is None else tuple(map(_drive_name, states)),
        presence=cell.presence,
        speeds_m_s=None if speeds_um_s is None else tuple(um * _M_PER_UM for um in speeds_um_s),
        emergency=cell.emergency,
        errors=tuple(error_text(*error) for error in cell.errors.items()),
        suspected_by=tuple(suspected_by),
    )


def _drive_name(state: int | None) -> str:
    return "unknown" if state is None else str(cia402.NAMES[state])


def _drives(names: tuple[str, ...] | None) -> str:
    """The states of the drives; one for both axes where it is the same."""
    if names is None:
        return "?"
    if len(set(names)) == 1:
        return names[0]
    return "\n".join(f"{axis}: {name}" for axis, name in enumerate(names, 1))


def _dots(presence: int | None, dots: tuple[str, str]) -> str:
    if presence is None:
        return "?"
    covered, free = dots
    return "".join(covered if presence >> sensor & 1 else free for sensor in range(5))


def _remark(row: CellStatus) -> str:
    remarks = []
    if row.silent:
        remarks.append("never heard" if row.silent_s is None else f"silent {row.silent_s:.1f} s")
    if row.suspected_by:
        remarks.append(f"suspected by node {', '.join(map(str, row.suspected_by))}")
    return "\n".join((*remarks, *row.errors))
