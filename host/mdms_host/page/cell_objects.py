"""All objects of one cell: read one after another beside a running program, and put in words."""

from collections import deque
from collections.abc import Callable, Iterator
from math import inf
from typing import Any

from mdms_host.can_link.sdo_client import Read, SdoClient
from mdms_protocol import indices
from mdms_protocol.codecs import cia402, cob
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import ENTRIES, OBJECTS
from mdms_protocol.emergencies import code_text
from mdms_protocol.entry import WRITE, Entry

GROUPS = {item.index: item.name for item in OBJECTS}
#: Bit 31 of a COB-ID: the PDO or emergency is off (CiA 301).
_OFF = 1 << 31
#: Bit 30 of 0x1005: this node sends SYNC.
_PRODUCER = 1 << 30
_SHARE = "1"


def name_of(entry: Entry) -> str:
    """The name of an entry, with its object where that says more."""
    group = GROUPS[entry.index]
    return entry.name if group in entry.name else f"{group}: {entry.name}"


def reading_of(entry: Entry, value: int) -> str:
    """The value as text."""
    for words, reading in _READINGS:
        if any(word in entry.name for word in words):
            return reading(entry, value)
    return _number(entry, value)


def _hex(entry: Entry, value: int) -> str:
    return f"0x{value:0{2 * entry.type.size}X}"


def _cob_id(entry: Entry, value: int) -> str:
    notes = ", off" if value & _OFF else ""
    if entry.index == indices.SYNC_COB_ID and value & _PRODUCER:
        notes = ", sent by this cell"
    return f"0x{value & cob.IDENTIFIER:03X}{notes}"


def _mapping(_entry: Entry, value: int) -> str:
    """Index, sub-index and length in bits of the object that is mapped, and its name."""
    if not value:
        return "none"
    entry = ENTRIES.get((value >> 16, value >> 8 & 0xFF))
    return f"0x{value:08X}, {name_of(entry) if entry else 'nothing that there is'}"


def _heartbeat(_entry: Entry, value: int) -> str:
    return f"node {value >> 16 & 0x7F} within {value & 0xFFFF} ms" if value else "none"


def _statusword(entry: Entry, value: int) -> str:
    state = cia402.state(value)
    return f"{_hex(entry, value)}, {cia402.NAMES[state] if state is not None else 'no state'}"


def _error(_entry: Entry, value: int) -> str:
    return code_text(value & 0xFFFF) if value else "none"


def _bits(_entry: Entry, value: int) -> str:
    return f"0b{value:05b}"


def _number(entry: Entry, value: int) -> str:
    unit = entry.unit
    if unit.symbol == _SHARE:
        return f"{100 * value * unit.factor:.6g} %"
    return f"{value * unit.factor:.6g} {unit.symbol}" if unit.symbol else f"{value}"


#: By a word of the entry's name, the first that fits; all others are numbers with their units.
_READINGS: tuple[tuple[tuple[str, ...], Callable[[Entry, int], str]], ...] = (
    (("COB-ID",), _cob_id),
    (("Mapping entry",), _mapping),
    (("Consumer heartbeat",), _heartbeat),
    (("statusword",), _statusword),
    (("error code", "error field"), _error),
    (("Presence sensor", "Presence debounce"), _number),
    (("Presence",), _bits),
    (
        (
            *("evice type", "Error register", "Vendor-ID", "Product code", "Serial number"),
            *("controlword", "drive modes", "signature", "Bytes"),
        ),
        _hex,
    ),
)


#: Between two requests [s]: some 6 % of a bus of 1 Mbit/s while a cell is read.
PACE_S = 0.004
#: An entry of a list that is not so long now is refused with this code (CiA 301, table 22).
_NOTHING_THERE = "0x08000024"
#: So many rows are given at once.
_ROWS = 32


class ObjectReader:
    """Reads entries of a cell in one frame each; `wake_s` is when to poll next [s]."""

    def __init__(self, cell: int, node_id: int, bus: int) -> None:
        self.cell = cell
        self.bus = bus
        self.answers_id = cob.SDO_RESPONSE_BASE + node_id
        self.wake_s = 0.0
        self._node_id = node_id
        self._waiting = deque(_readable())
        self._client: SdoClient | None = None
        self._rows: list[dict[str, Any]] = []
        self.over = False

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The request to send now, if one is due."""
        if now_s < self.wake_s or self.over:
            return
        if self._client is None or self._client.done or self._client.failure:
            self._next()
        if self._client is not None:
            yield from self._client.poll(now_s)
            self._settle(now_s)

    def on_answer(self, data: bytes, now_s: float) -> None:
        """A frame with the cell's answer has come."""
        if self._client is not None:
            self._client.on_response(data)
            self._settle(now_s)

    def take_rows(self) -> list[dict[str, Any]]:
        """Rows that have been read since the last call, as soon as there are enough."""
        if not self.over and len(self._rows) < _ROWS:
            return []
        rows, self._rows = self._rows, []
        return rows

    def _next(self) -> None:
        self._client = None
        if not self._waiting:
            self.over, self.wake_s = True, inf
            return
        entry = self._waiting.popleft()
        self._entry = entry
        self._client = SdoClient(self._node_id, (Read(entry.index, entry.sub),))

    def _settle(self, now_s: float) -> None:
        """Note the value of an entry, or why there is none; and when to go on."""
        client, entry = self._client, self._entry
        assert client is not None
        value = client.answers.get((entry.index, entry.sub))
        if not client.done and client.failure is None:
            self.wake_s = client.wake_s
            return
        if client.failure is None or _NOTHING_THERE not in client.failure:
            self._rows.append(_row(entry, value, client.failure))
        if client.failure and "no answer" in client.failure:
            # A cell that does not answer once does not answer again.
            self._waiting.clear()
        self._client = None
        self.wake_s = now_s + PACE_S


def _readable() -> Iterator[Entry]:
    """Entries that are worth a frame:

    no constants of the protocol's own, no texts, nothing write-only.
    """
    for entry in ENTRIES.values():
        if entry.type.size and entry.access != WRITE and "sub-index" not in entry.name:
            yield entry


def _row(entry: Entry, value: int | None, failure: str | None) -> dict[str, Any]:
    row: dict[str, Any] = {"place": f"{entry.index:04X}:{entry.sub}", "name": name_of(entry)}
    if value is None:
        return row | {"problem": failure}
    unit, text = entry.unit, reading_of(entry, value)
    return row | {"raw": value, "value": value * unit.factor, "unit": unit.symbol, "text": text}
