"""Faults of an array, by measurements of it: each rule makes findings of one kind."""

from collections import Counter
from collections.abc import Iterator, Mapping
from statistics import median

from mdms_host.commissioning.array_file import FiledCell
from mdms_host.commissioning.doctor.examination import Examination, Examined
from mdms_host.commissioning.doctor.findings import Finding
from mdms_protocol import indices
from mdms_protocol.codecs import cia402, cob, update
from mdms_protocol.dictionary import AXES, AXIS_OFFSET
from mdms_protocol.emergencies import code_text, is_elsewhere
from mdms_protocol.version import VERSION

_BUS_OFF = 0x8140
#: In place of a size that a board does not know.
_UNKNOWN = 0xFFFFFFFF
#: A single frame that is not acknowledged, or in error, leaves so much in a counter for a while.
_ERRORS_LEAST = 8
_HEAP_LEAST = 8_192
_FLASH_LEAST = 16_384
#: A clock that is off by more is faulty, even beside a bad clock of the host.
_CLOCK_SHARE = 0.05
_SUPPLY_SHARE = 0.1
_SENSORS = 5
_AROUND = (1 << _SENSORS) - 2
#: The neighbour on the other side, by direction.
_OPPOSITE = 4


def diagnose(
    examined: Examination, listed: Mapping[int, FiledCell] | None = None, *, empty: bool = False
) -> list[Finding]:
    """All findings; `listed` are the cells of an array file by their serial numbers.

    With `empty` nothing lies on the table.
    """
    findings = [*_of_bus(examined), *_of_roll(examined)]
    if listed is not None:
        findings += _of_list(examined, listed)
    findings += _of_versions(examined)
    for cell in examined.cells.values():
        findings += _of_cell(cell, examined.cells)
        findings += _of_sensors(cell, empty)
    findings += _of_supplies(examined.cells)
    findings += _of_neighbours(examined.cells)
    return findings


def _of_bus(examined: Examination) -> Iterator[Finding]:
    counts = examined.counts
    if not (examined.cells or examined.blank or examined.silent or examined.other_protocol):
        yield Finding("silence", f"no cell answers{_counted(str(counts))}")
    if counts.error_frames:
        yield Finding("bus-errors", f"{counts.error_frames} error frames while this looked")
    if counts.garbled or counts.unsent:
        yield Finding("adapter", str(counts))
    if examined.other_host:
        yield Finding("other-host", "a host's heartbeat is on the bus")


def _of_roll(examined: Examination) -> Iterator[Finding]:
    if examined.blank:
        yield Finding("blank", f"without a node id: {_serials(examined.blank)}")
    for serial, node_id in examined.hidden.items():
        yield Finding("double-id", f"{serial:08X} has node id {node_id}, as another", (node_id,))
    for serial in examined.twins:
        nodes = _nodes_of(examined, serial)
        yield Finding("twin-serial", f"two cells have the serial number {serial:08X}", nodes)
    for node_id, answer in examined.strangers.items():
        yield Finding("stranger", answer, (node_id,))
    for node_id, reason in examined.silent.items():
        if node_id not in examined.hidden.values():
            yield Finding("silent-node", reason, (node_id,))
    for node_id, reason in examined.other_protocol.items():
        yield Finding("other-protocol", reason, (node_id,))
    if cob.HOST_NODE in examined.cells:
        yield Finding("host-id", "the host's own node id", (cob.HOST_NODE,))


def _of_list(examined: Examination, listed: Mapping[int, FiledCell]) -> Iterator[Finding]:
    there = {cell.identity.serial: node_id for node_id, cell in examined.cells.items()}
    for serial in sorted(listed.keys() - there.keys()):
        node_id = listed[serial].node_id
        yield Finding("missing", f"{serial:08X} is to be node {node_id}", (node_id,))
    for serial in sorted(there.keys() - listed.keys()):
        yield Finding("unlisted", f"{serial:08X} is in no place", (there[serial],))
    for serial in sorted(there.keys() & listed.keys()):
        if there[serial] != listed[serial].node_id:
            wanted = listed[serial].node_id
            yield Finding("settings", f"{serial:08X} is to be node {wanted}", (there[serial],))


def _of_versions(examined: Examination) -> Iterator[Finding]:
    for node_id, cell in examined.cells.items():
        if cell.identity.software != VERSION:
            text = f"firmware {cell.identity.software}, this host is {VERSION}"
            yield Finding("versions", text, (node_id,))


def _of_cell(cell: Examined, cells: Mapping[int, Examined]) -> Iterator[Finding]:
    node = (cell.node_id,)
    for axis in range(AXES):
        offset = axis * AXIS_OFFSET
        state = cia402.state(cell[indices.STATUSWORD + offset, 0])
        code = cell[indices.ERROR_CODE + offset, 0]
        if state in (cia402.FAULT, cia402.FAULT_REACTION):
            yield Finding("drive-fault", f"axis {axis + 1}: {code_text(code)}", node)
    yield from _of_errors(cell)
    for sub, kind in ((3, "not-sent"), (4, "overrun")):
        if cell[indices.TRAFFIC, sub]:
            yield Finding(kind, f"{cell[indices.TRAFFIC, sub]} frames", node)
    errors = [cell[indices.TRAFFIC, sub] for sub in (5, 6)]
    if _UNKNOWN not in errors and max(errors) >= _ERRORS_LEAST:
        yield Finding("node-errors", f"{errors[0]} in sending, {errors[1]} in receiving", node)
    for sub, kind, least in ((1, "heap", _HEAP_LEAST), (2, "flash", _FLASH_LEAST)):
        free = cell.objects.get((indices.MEMORY, sub), _UNKNOWN)
        if free != _UNKNOWN and free < least:
            yield Finding(kind, f"{free} bytes are free", node)
    if update.reason_of(cell.objects.get((indices.FLASH_STATUS, 1), 0)) == update.ROLLED_BACK:
        yield Finding("rolled-back", f"{cell.identity.software} runs", node)
    if cell.objects.get((indices.UPDATE, 8)):
        yield Finding("on-trial", f"{cell.identity.software} runs, on trial", node)
    wanted_s = cell[indices.PRODUCER_TIME, 0] * 1e-3
    if cell.period_s and wanted_s and abs(cell.period_s / wanted_s - 1) > _CLOCK_SHARE:
        text = f"a heartbeat every {cell.period_s * 1e3:.1f} ms, {wanted_s * 1e3:g} are set"
        yield Finding("clock", text, node)
    suspects = [each.node_id for each in cells.values() if each[indices.SUSPECT, 0] in node]
    if suspects:
        yield Finding("suspected", f"by node {', '.join(map(str, suspects))}", node)


def _of_errors(cell: Examined) -> Iterator[Finding]:
    if is_elsewhere(cell[indices.ERROR_REGISTER, 0], cell[indices.SUSPECT, 0]):
        yield Finding("elsewhere", "its place is coded as another node's", (cell.node_id,))
    if _BUS_OFF in cell.history:
        yield Finding("bus-off", "in its error history (0x1003)", (cell.node_id,))


def _of_sensors(cell: Examined, empty: bool) -> Iterator[Finding]:
    """A sensor that reads other than all its fellows; on an empty table every one covered."""
    bits = cell[indices.PRESENCE, 0] & (1 << _SENSORS) - 1
    wrong = bits if empty else 0
    # Only the centre covered, or free, no convex parcel explains; a corner alone one may.
    if bits in (1, _AROUND):
        wrong |= 1
    for sensor in range(_SENSORS):
        if wrong >> sensor & 1:
            shown = "covered" if bits >> sensor & 1 else "free"
            others = "the table is empty" if empty else "the four around show the opposite"
            yield Finding("sensor", f"sensor {sensor} is {shown}, and {others}", (cell.node_id,))


def _of_supplies(cells: Mapping[int, Examined]) -> Iterator[Finding]:
    supplies_mv = {node_id: cell[indices.SUPPLY, 0] for node_id, cell in cells.items()}
    limits_mv = {node_id: cell[indices.UNDERVOLTAGE_LIMIT, 0] for node_id, cell in cells.items()}
    # Cells behind a fuse or a stop relay tell nothing about the supply of the others.
    fed_mv = [mv for node_id, mv in supplies_mv.items() if mv >= limits_mv[node_id]]
    usual_mv = median(fed_mv) if fed_mv else 0
    for node_id, supply_mv in supplies_mv.items():
        limit_mv = limits_mv[node_id]
        if supply_mv < limit_mv:
            text = f"{supply_mv / 1e3:.1f} V, {limit_mv / 1e3:g} V are needed"
            yield Finding("supply-low", text, (node_id,))
        elif abs(supply_mv - usual_mv) > _SUPPLY_SHARE * usual_mv:
            text = f"{supply_mv / 1e3:.1f} V, the others {usual_mv / 1e3:.1f} V"
            yield Finding("supply-uneven", text, (node_id,))


def _of_neighbours(cells: Mapping[int, Examined]) -> Iterator[Finding]:
    """The neighbour in the east has this cell in the west; no two cells have one place."""
    spots = Counter(_spot(cell) for cell in cells.values() if cell[indices.PLACE, 2])
    for node_id, cell in cells.items():
        if not cell[indices.PLACE, 2]:
            continue
        column, row = _spot(cell)
        if spots[column, row] > 1:
            yield Finding("neighbours", f"another is at column {column}, row {row} too", (node_id,))
        for direction in range(2 * _OPPOSITE):
            other = cells.get(cell[indices.NEIGHBOURS, direction + 1])
            back = (direction ^ _OPPOSITE) + 1
            if other is not None and other[indices.NEIGHBOURS, back] != node_id:
                text = f"node {other.node_id} is its neighbour, and does not say so of it"
                yield Finding("neighbours", text, (node_id,))


def _spot(cell: Examined) -> tuple[int, int]:
    return cell[indices.PLACE, 1], cell[indices.PLACE, 2]


def _nodes_of(examined: Examination, serial: int) -> tuple[int, ...]:
    cells = examined.cells.items()
    return tuple(node_id for node_id, cell in cells if cell.identity.serial == serial)


def _serials(serials: list[int]) -> str:
    return ", ".join(f"{serial:08X}" for serial in serials)


def _counted(text: str) -> str:
    return f" ({text})" if text else ""
