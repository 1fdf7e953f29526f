"""Writes settings into one cell's object dictionary by expedited SDO, without any IO of its own.

CiA 301, 7.2.4.3. Only values of up to four bytes: settings, not programs.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from mdms_protocol import cob, pdo
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.frame import Frame

_ABORT = 0x80
_DOWNLOADED = 0x60


@dataclass(frozen=True, slots=True)
class Setting:
    """One value for one object, in the object's own integer unit."""

    index: int
    sub: int
    value: int


class SdoClient:
    """Sends settings one after another, each again when no answer comes in time.

    `failure` tells why it gave up, None as long as it has not.
    """

    def __init__(
        self,
        node_id: int,
        settings: tuple[Setting, ...],
        answer_within_s: float = 0.1,
        attempts: int = 3,
    ) -> None:
        self._node_id = node_id
        self._waiting = deque(settings)
        self._answer_within_s = answer_within_s
        self._attempts = attempts
        self._attempt = 0
        self._due_s = 0.0
        self.failure: str | None = None

    @property
    def done(self) -> bool:
        """Whether all settings have been taken over."""
        return not self._waiting

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The request to send now, if any; raises OutOfRangeError for a value that cannot be."""
        if self.done or self.failure or now_s < self._due_s:
            return
        setting = self._waiting[0]
        if self._attempt == self._attempts:
            self.failure = (
                f"no answer to a write of 0x{setting.index:04X}:{setting.sub} "
                f"after {self._attempts} attempts"
            )
            return
        self._attempt += 1
        self._due_s = now_s + self._answer_within_s
        yield Frame(cob.SDO_REQUEST_BASE + self._node_id, download_request(setting))

    def on_response(self, data: bytes) -> None:
        """Take in an answer of the cell; one to another request is ignored."""
        if len(data) != 8 or self.done:
            return
        setting = self._waiting[0]
        if data[1:4] != setting.index.to_bytes(2, "little") + bytes((setting.sub,)):
            return
        if data[0] == _ABORT:
            code = int.from_bytes(data[4:], "little")
            self.failure = (
                f"it refuses {setting.value} for 0x{setting.index:04X}:{setting.sub} "
                f"(abort code 0x{code:08X})"
            )
        elif data[0] == _DOWNLOADED:
            self._waiting.popleft()
            self._attempt, self._due_s = 0, 0.0


def download_request(setting: Setting) -> bytes:
    """The request that writes a setting; raises OutOfRangeError, or KeyError for no such object."""
    entry = ENTRIES[setting.index, setting.sub]
    pdo.check(entry, setting.value)
    size: int = entry.type.size
    command = 0x23 | (4 - size) << 2
    value = setting.value.to_bytes(size, "little", signed=entry.type.low < 0)
    head = bytes((command,)) + setting.index.to_bytes(2, "little") + bytes((setting.sub,))
    return (head + value).ljust(8, b"\0")
