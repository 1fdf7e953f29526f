"""A value of any length into one cell by SDO block download (CiA 301, 7.2.4.2.9 to 7.2.4.2.12)."""

import binascii
from collections.abc import Iterator

from mdms_protocol.codecs import cob, sdo
from mdms_protocol.codecs.frame import Frame

_SEGMENT = 7
#: Erasing flash may keep a cell from an answer for so long [s]; it aborts a second after the last
#: segment that it has seen.
_ANSWER_S = 0.7
#: The end is answered when all is read again from flash.
_END_S = 5.0
_NUDGES = 3


class BlockDownload:
    """Sends segments of a block until the cell's count of them says otherwise; without IO.

    `failure` is the reason why it has ended early, and `abort` the cell's code, if it gave one.
    `repeated` counts segments that were sent again, `acknowledged` bytes that have arrived.
    """

    def __init__(self, node_id: int, index: int, sub: int, data: bytes) -> None:
        self.done = False
        self.failure: str | None = None
        self.abort: int | None = None
        self.repeated = 0
        self.acknowledged = 0
        self._can_id = cob.SDO_REQUEST_BASE + node_id
        self._place = index.to_bytes(2, "little") + bytes((sub,))
        self._data = data
        self._block_size = 0
        self._sent = 0
        self._highest = 0
        self._awaits: int | None = None
        self._due_s = 0.0
        self._asked = 0

    @property
    def wake_s(self) -> float:
        """When to poll next, if no answer comes before [s]."""
        return float("inf") if self.done or self.failure else self._due_s

    def poll(self, now_s: float) -> Iterator[Frame]:
        """Frames to send now; who takes fewer gets the rest with the next call."""
        if self.done or self.failure:
            return
        if self._awaits is None and self._block_size:
            yield from self._segments(now_s)
        elif now_s >= self._due_s:
            yield from self._ask(now_s)

    def on_response(self, data: bytes) -> None:
        """Take in what the cell answers; what answers nothing of this is left alone."""
        if len(data) != 8 or self.done or self.failure:
            return
        if data[0] == sdo.ABORT:
            self.abort = int.from_bytes(data[4:], "little")
            self.failure = f"it ends the transfer (abort code 0x{self.abort:08X})"
        elif data[0] & sdo.SPECIFIER == sdo.BLOCK_DOWNLOAD_RESPONSE:
            self._on_block(data[0] & sdo.BLOCK_SUBCOMMAND, data)

    def _on_block(self, answers: int, data: bytes) -> None:
        if answers == sdo.BLOCK_INITIATE and not self._block_size and data[1:4] == self._place:
            self._begin_block(data[4])
        elif answers == sdo.BLOCK_ACKNOWLEDGE and self._awaits == sdo.BLOCK_ACKNOWLEDGE:
            self.acknowledged = min(self.acknowledged + data[1] * _SEGMENT, len(self._data))
            self._begin_block(data[2])
        elif answers == sdo.BLOCK_END and self._awaits == sdo.BLOCK_END:
            self.done = True

    def _begin_block(self, size: int) -> None:
        if not 1 <= size <= sdo.BLOCK_SEQUENCE:
            self.failure = f"it asks for blocks of {size} segments"
            return
        whole = self._block_size and self.acknowledged == len(self._data)
        self._block_size, self._sent, self._asked, self._due_s = size, 0, 0, 0.0
        self._awaits = sdo.BLOCK_END if whole else None

    def _segments(self, now_s: float) -> Iterator[Frame]:
        while self._awaits is None:
            self._sent += 1
            frame = self._segment(self._sent)
            start = self.acknowledged + (self._sent - 1) * _SEGMENT
            self.repeated += start < self._highest
            self._highest = max(self._highest, start + _SEGMENT)
            if self._sent == self._block_size or frame.data[0] & sdo.BLOCK_LAST:
                self._awaits, self._due_s = sdo.BLOCK_ACKNOWLEDGE, now_s + _ANSWER_S
            yield frame

    def _segment(self, sequence: int) -> Frame:
        start = self.acknowledged + (sequence - 1) * _SEGMENT
        piece = self._data[start : start + _SEGMENT]
        last = sdo.BLOCK_LAST if start + _SEGMENT >= len(self._data) else 0
        return Frame(self._can_id, bytes((sequence | last,)) + piece.ljust(_SEGMENT, b"\0"))

    def _ask(self, now_s: float) -> Iterator[Frame]:
        """Open or end the transfer; or send the last segment again, by which a block is counted."""
        if self._asked == _NUDGES:
            self.failure = "it does not answer"
            return
        self._asked += 1
        self._due_s = now_s + _ANSWER_S
        if not self._block_size:
            command = sdo.BLOCK_DOWNLOAD | sdo.BLOCK_CRC | sdo.BLOCK_SIZE_TOLD
            size = len(self._data).to_bytes(4, "little")
            yield Frame(self._can_id, bytes((command,)) + self._place + size)
        elif self._awaits == sdo.BLOCK_END:
            # Once: a cell that has ended the transfer would refuse another end.
            self._asked, self._due_s = _NUDGES, now_s + _END_S
            yield self._end()
        else:
            self.repeated += 1
            yield self._segment(self._sent)

    def _end(self) -> Frame:
        unused = -len(self._data) % _SEGMENT
        crc = binascii.crc_hqx(self._data, 0)
        command = sdo.BLOCK_DOWNLOAD | unused << 2 | sdo.BLOCK_END
        return Frame(self._can_id, bytes((command, crc & 0xFF, crc >> 8)) + bytes(5))
