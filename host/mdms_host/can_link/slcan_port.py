"""The serial line of python-can's slcan interface, read in pieces as large as there are.

python-can opens and closes it. Its own reader asks the kernel twice for every byte, some 50 times
for a frame of 8 bytes: 90 us of processor time a frame where a whole array sends 2000 frames/s.
Its writer waits for the adapter after each frame, and after a time-out has written half a line.
"""

import os
import re
import select
from collections import deque
from threading import Lock

import can
from can.interfaces.slcan import slcanBus

_READ_BYTES = 1 << 16
_END = b"\r"
_REFUSED = b"\a"
#: More than any line of SLCAN has, FD's included: a longer line is noise.
_LINE_MAX = 160
#: An adapter that takes no bytes is closed without its last line after so long [s].
_CLOSES_S = 1.0


class GarbledError(ValueError):
    """A line from the adapter is none that it could have sent."""


class SlcanPort:
    """Receives and sends like a python-can bus; `refused` counts frames the adapter did not take.

    One thread may receive while others send. POSIX only, for the sake of `select`.
    """

    def __init__(self, bus: slcanBus) -> None:
        self.refused = 0
        self._port = bus.serialPortOrig
        # python-can alone writes through it from here on, when it closes the channel.
        self._port.write_timeout = _CLOSES_S
        # Bytes that python-can has read itself while it opened the channel.
        self._partial = bytearray(bus._buffer)
        self._lines: deque[bytes] = deque()
        self._sending = Lock()
        self._sent = 0
        self._rest = b""

    def recv(self, timeout: float | None) -> can.Message | None:
        """The next frame, None when none comes in time.

        Raises GarbledError, and can.CanOperationError for a device that cannot be read.
        """
        if not self._lines:
            self._fill(timeout)
        while self._lines:
            message = self._parse(self._lines.popleft())
            if message is not None:
                return message
        return None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Write one frame, whole or not at all.

        Raises can.CanTimeoutError when the line takes none in time, can.CanOperationError when it
        cannot be written.
        """
        line = _line(msg)
        with self._sending:
            self._rest = self._write(self._rest, timeout)
            rest = line if self._rest else self._write(line, timeout)
            if rest == line:
                raise can.CanTimeoutError("the serial line takes no more bytes")
            self._rest += rest
            self._sent += 1

    def flush(self) -> None:
        """Drop the received bytes that nobody has read."""
        self._partial.clear()
        self._lines.clear()

    def _fill(self, timeout: float | None) -> None:
        try:
            if not select.select([self._port.fileno()], [], [], timeout)[0]:
                return
            data = os.read(self._port.fileno(), _READ_BYTES)
        except BlockingIOError:
            return
        except (OSError, ValueError, TypeError) as error:
            raise can.CanOperationError(f"the serial line cannot be read: {error}") from None
        if not data:
            raise can.CanOperationError(
                "the serial line is closed at its other end, or another program reads it, too"
            )
        *lines, rest = data.replace(_REFUSED, _REFUSED + _END).split(_END)
        for line in lines:
            self._lines.append(bytes(self._partial) + line)
            self._partial.clear()
        self._partial += rest
        if len(self._partial) > _LINE_MAX:
            self._partial.clear()
            raise GarbledError("bytes without an end of line")

    def _write(self, data: bytes, timeout: float | None) -> bytes:
        """Write as much as the line takes in time; return the rest."""
        try:
            while data and select.select([], [self._port.fileno()], [], timeout)[1]:
                data = data[os.write(self._port.fileno(), data) :]
        except BlockingIOError:
            return data
        except (OSError, ValueError, TypeError) as error:
            raise can.CanOperationError(f"the serial line cannot be written: {error}") from None
        return data

    def _parse(self, line: bytes) -> can.Message | None:
        """A frame; None for an answer. Raises GarbledError."""
        if line.endswith(_REFUSED):
            # The first may be meant for python-can's opening of a channel that was open.
            self.refused += self._sent > 0
            return None
        if line[:1] not in _HEADS:
            if line in _ANSWERS or line[:1] in _QUERIES:
                return None
            if line == _CUT:
                raise GarbledError("the adapter went off the bus; frames sent last may be lost")
            lost = _LOST.fullmatch(line)
            if lost is not None:
                raise GarbledError(f"the adapter has dropped {int(lost[1], 16)} frames of the bus")
            raise GarbledError(f"a line that is no frame: {line[:20]!r}")
        try:
            return _message(line)
        except (ValueError, IndexError):
            raise GarbledError(f"a frame that is cut short: {line[:40]!r}") from None


_HEADS = (b"t", b"T", b"r", b"R")
#: Our own adapter (`firmware/adapter_main.py`) reports frames without room.
_LOST = re.compile(rb"x([0-9A-F]{4})")
#: And that its bus went off.
_CUT = b"y"
_ANSWERS = (b"", b"z", b"Z")
#: Answers to questions after version, serial number and state.
_QUERIES = (b"V", b"v", b"N", b"F")


def _message(line: bytes) -> can.Message:
    """Raises ValueError for anything but digits, and for too few of them."""
    if not line.isalnum():
        raise ValueError("digits are expected")
    extended, remote = line[0] in b"TR", line[0] in b"rR"
    start = 10 if extended else 5
    size = int(line[start - 1 : start])
    digits = line[start : start + 2 * size]
    if len(digits) != 2 * size and not remote:
        raise ValueError("data is missing")
    return can.Message(
        arbitration_id=int(line[1 : start - 1], 16),
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=size,
        data=None if remote else bytes.fromhex(digits.decode("ascii")),
        check=True,
    )


def _line(message: can.Message) -> bytes:
    head = "r" if message.is_remote_frame else "t"
    digits = f"{message.arbitration_id:03X}"
    if message.is_extended_id:
        head, digits = head.upper(), f"{message.arbitration_id:08X}"
    data = "" if message.is_remote_frame else bytes(message.data).hex().upper()
    return f"{head}{digits}{message.dlc}{data}\r".encode("ascii")
