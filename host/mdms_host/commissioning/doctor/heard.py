"""Findings by frames alone, of a minute that is over: nobody can be asked any more."""

from collections.abc import Iterable, Iterator

from mdms_host.can_link.link import LinkCounts
from mdms_host.can_link.recent import RecentFrame
from mdms_host.can_link.remote_cell import RemoteCell
from mdms_host.commissioning.doctor.findings import Finding
from mdms_host.layout import Layout
from mdms_protocol.codecs import cia402, cob
from mdms_protocol.emergencies import LOW_SUPPLY, code_text

_FAULTS = frozenset((cia402.FAULT, cia402.FAULT_REACTION))
_BUS_OFF = 0x8140
#: Heartbeats are due every 0.1 s; a cell that has missed three is silent [s].
_SILENT_S = 0.35
#: Only the centre covered, or free, no convex parcel explains.
_SENSORS = (0b00001, 0b11110)


class _Heard:
    """A cell, and the codes of all errors that it has reported."""

    def __init__(self, cell: RemoteCell) -> None:
        self.cell = cell
        self.codes: dict[int, None] = {}

    def on_frame(self, frame: RecentFrame) -> None:
        can_id, data = frame.frame
        self.cell.on_frame(can_id, data, frame.time_s)
        if can_id == cob.EMCY_BASE + self.cell.node_id and len(data) == 8:
            code = int.from_bytes(data[:2], "little")
            if code:
                self.codes[code] = None


def findings_by_frames(
    frames: Iterable[RecentFrame], layout: Layout, now_s: float, counts: LinkCounts | None = None
) -> list[Finding]:
    """The findings of the doctor that frames show; `now_s` is when the last one could come."""
    several = layout.bus_count > 1
    heard = {
        (bus, node): _Heard(RemoteCell(number, node, bus if several else None))
        for number, (bus, node) in enumerate(zip(layout.buses, layout.node_ids, strict=True), 1)
    }
    other_host = False
    for each in frames:
        node = each.frame.can_id & cob.NODE_MAX
        if (one := heard.get((each.bus, node))) is not None:
            one.on_frame(each)
        elif each.frame.can_id == cob.HEARTBEAT_BASE + cob.HOST_NODE and not each.sent:
            other_host = True
    findings = [*_of_link(counts), *_of_cells(list(heard.values()), now_s, several)]
    if other_host:
        findings.append(Finding("other-host", "a host's heartbeat is on the bus"))
    return findings


def _of_link(counts: LinkCounts | None) -> Iterator[Finding]:
    if counts is None:
        return
    if counts.error_frames:
        yield Finding("bus-errors", f"{counts.error_frames} error frames since the start")
    if counts.garbled or counts.unsent:
        yield Finding("adapter", str(counts))


def _of_cells(heard: list[_Heard], now_s: float, several: bool) -> Iterator[Finding]:
    silent = [each for each in heard if each.cell.silence_s(now_s) > _SILENT_S]
    if len(silent) == len(heard):
        yield Finding("silence", f"no cell was heard in the last {_SILENT_S:g} s")
        silent = []
    for each in silent:
        yield _finding("silent-node", "it sends no heartbeat", each.cell, several)
    for each in heard:
        cell = each.cell
        for code in each.codes:
            kind = "supply-low" if code == LOW_SUPPLY else "drive-fault"
            kind = "bus-off" if code == _BUS_OFF else kind
            yield _finding(kind, f"{cell.name} reported {code_text(code)}", cell, several)
        if not each.codes and not _FAULTS.isdisjoint(cell.drive_states or ()):
            yield _finding("drive-fault", cell.drive_text, cell, several)
        if cell.suspect:
            text = f"{cell.name} suspects node {cell.suspect}"
            yield Finding("suspected", text, (cell.suspect,), _bus(cell, several))
        if cell.presence in _SENSORS:
            text = "the centre's sensor shows the opposite of the four around"
            yield _finding("sensor", text, cell, several)


def _finding(kind: str, text: str, cell: RemoteCell, several: bool) -> Finding:
    return Finding(kind, text, (cell.node_id,), _bus(cell, several))


def _bus(cell: RemoteCell, several: bool) -> str | None:
    return f"bus {cell.bus}" if several else None
