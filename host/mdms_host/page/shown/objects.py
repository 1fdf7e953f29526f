"""All objects of one cell, read one after another beside a running program."""

from collections import deque
from collections.abc import Iterator
from math import inf
from typing import Any

from mdms_host.can_link.sdo_client import Read, SdoClient
from mdms_host.page.shown.readings import name_of, reading_of
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import WRITE, Entry

#: Between two requests [s]: some 6 % of a bus of 1 Mbit/s while a cell is read.
PACE_S = 0.004
#: An entry of a list that is not so long now is refused with this code (CiA 301, table 22).
_NOTHING_THERE = "0x08000024"
#: So many rows are given at once.
_ROWS = 32


class ObjectReader:
    """Reads what can be read of a cell in one frame each; `wake_s` is when to poll next [s]."""

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
        """Note what has been read, or why it has not; and when to go on."""
        client, entry = self._client, self._entry
        assert client is not None
        value = client.answers.get((entry.index, entry.sub))
        if not client.done and client.failure is None:
            self.wake_s = client.wake_s
            return
        if client.failure is None or _NOTHING_THERE not in client.failure:
            self._rows.append(_row(entry, value, client.failure))
        if client.failure and "no answer" in client.failure:
            # One that does not answer once does not answer again.
            self._waiting.clear()
        self._client = None
        self.wake_s = now_s + PACE_S


def _readable() -> Iterator[Entry]:
    """What is worth a frame: no constants of the protocol's own, no texts, nothing write-only."""
    for entry in ENTRIES.values():
        if entry.type.size and entry.access != WRITE and "sub-index" not in entry.name:
            yield entry


def _row(entry: Entry, value: int | None, failure: str | None) -> dict[str, Any]:
    row: dict[str, Any] = {"place": f"{entry.index:04X}:{entry.sub}", "name": name_of(entry)}
    if value is None:
        return row | {"problem": failure}
    unit, text = entry.unit, reading_of(entry, value)
    return row | {"raw": value, "value": value * unit.factor, "unit": unit.symbol, "text": text}
