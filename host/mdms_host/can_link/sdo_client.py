"""Writes settings into, and reads values from, one cell's object dictionary by expedited SDO.

CiA 301, 7.2.4.3; without any IO of its own, and for values of up to four bytes only: settings, not
programs.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from mdms_protocol import pdo
from mdms_protocol.codecs import cob, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import ENTRIES

#: Attempts at a transfer where frames may get lost and nobody waits: of two lost in a hundred, one
#: transfer in 10^14 fails.
PATIENT = 10


@dataclass(frozen=True, slots=True)
class Setting:
    """One value for one object, in the object's own integer unit."""

    index: int
    sub: int
    value: int


@dataclass(frozen=True, slots=True)
class Read:
    """One object to be read."""

    index: int
    sub: int


class SdoClient:
    """Does transfers one after another, each again when no answer comes in time: `attempts`.

    `answers` holds the values that were read, by (index, sub-index), as integers. `failure` is the
    reason why it gave up, None as long as it has not; `abort` is the cell's code, if it gave one.
    """

    def __init__(
        self,
        node_id: int,
        transfers: Iterable[Setting | Read],
        answer_within_s: float = 0.1,
        attempts: int = 3,
    ) -> None:
        self._node_id = node_id
        self._waiting = deque(transfers)
        self._answer_within_s = answer_within_s
        self._attempts = attempts
        self._attempt = 0
        self._due_s = 0.0
        self.answers: dict[tuple[int, int], int] = {}
        self.failure: str | None = None
        self.abort: int | None = None

    def append(self, transfers: Iterable[Setting | Read]) -> None:
        """Do these as well, after the others."""
        self._waiting.extend(transfers)

    @property
    def done(self) -> bool:
        """Whether all transfers have succeeded."""
        return not self._waiting

    @property
    def wake_s(self) -> float:
        """When to poll next, if no answer comes before [s]."""
        return float("inf") if self.done or self.failure else self._due_s

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The request to send now, if any; raises OutOfRangeError for a value that cannot be."""
        if now_s < self.wake_s:
            return
        transfer = self._waiting[0]
        if self._attempt == self._attempts:
            self.failure = f"no answer to {_text(transfer)} after {self._attempts} attempts"
            return
        self._attempt += 1
        self._due_s = now_s + self._answer_within_s
        yield Frame(cob.SDO_REQUEST_BASE + self._node_id, _request(transfer))

    def on_response(self, data: bytes) -> None:
        """Take in an answer of the cell; one to another request is ignored."""
        if len(data) != 8 or self.done:
            return
        transfer = self._waiting[0]
        if data[1:4] != transfer.index.to_bytes(2, "little") + bytes((transfer.sub,)):
            return
        kind = data[0] & sdo.SPECIFIER
        if kind == sdo.ABORT:
            self.abort = int.from_bytes(data[4:], "little")
            self.failure = f"it refuses {_text(transfer)} (abort code 0x{self.abort:08X})"
        elif kind == sdo.DOWNLOAD_RESPONSE and isinstance(transfer, Setting):
            self._next()
        elif kind == sdo.UPLOAD_RESPONSE and isinstance(transfer, Read):
            self._take(transfer, data)

    def _take(self, read: Read, data: bytes) -> None:
        """The value of an expedited answer, as long as the object's type is."""
        kind = ENTRIES[read.index, read.sub].type
        if not data[0] & sdo.EXPEDITED:
            self.failure = f"its answer to {_text(read)} is longer than a frame"
            return
        value = int.from_bytes(data[4 : 4 + kind.size], "little", signed=kind.low < 0)
        self.answers[read.index, read.sub] = value
        self._next()

    def _next(self) -> None:
        self._waiting.popleft()
        self._attempt, self._due_s = 0, 0.0


def _text(transfer: Setting | Read) -> str:
    place = f"0x{transfer.index:04X}:{transfer.sub}"
    if isinstance(transfer, Setting):
        return f"a write of {transfer.value} to {place}"
    return f"a read of {place}"


def _request(transfer: Setting | Read) -> bytes:
    """Raises OutOfRangeError for a value, and KeyError for an object, that cannot be."""
    entry = ENTRIES[transfer.index, transfer.sub]
    if isinstance(transfer, Read):
        return sdo.read_request(transfer.index, transfer.sub)
    pdo.check(entry, transfer.value)
    value = transfer.value.to_bytes(entry.type.size, "little", signed=entry.type.low < 0)
    return sdo.write_request(transfer.index, transfer.sub, value)
