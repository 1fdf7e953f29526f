"""Every frame of a run in candump's log format, and the digest that tells two runs apart."""

from functools import lru_cache
from hashlib import sha256
from typing import BinaryIO

from mdms_protocol.frame import Frame
from mdms_sim.bus.flags import EXTENDED, EXTENDED_MASK, REMOTE, STANDARD_MASK

NS_PER_US = 1000
US_PER_S = 1_000_000
INTERFACE = "mdms"
#: Lines are hashed and written so many at a time.
BATCH_LINES = 256


def log_line(frame: Frame, now_ns: int) -> str:
    """One line as `candump -L` writes it, in simulated time: `(0.001234) mdms 181#0011`."""
    can_id, data = frame
    seconds, us = divmod(now_ns // NS_PER_US, US_PER_S)
    body = f"R{len(data)}" if can_id & REMOTE else data.hex().upper()
    return f"({seconds}.{us:06d}) {INTERFACE} {_name(can_id)}#{body}\n"


@lru_cache(maxsize=4096)
def _name(can_id: int) -> str:
    if can_id & EXTENDED:
        return f"{can_id & EXTENDED_MASK:08X}"
    return f"{can_id & STANDARD_MASK:03X}"


class BusLog:
    """Writes frames to `file`, if any; `log_sha256` is the digest of all lines so far."""

    def __init__(self, file: BinaryIO | None = None) -> None:
        self._file = file
        self._digest = sha256()
        self._lines: list[str] = []

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """Appends one line; an observer of the bus."""
        self._lines.append(log_line(frame, now_ns))
        if len(self._lines) >= BATCH_LINES:
            self.flush()

    def flush(self) -> None:
        """Writes what waits; to be called before the file is closed."""
        text = "".join(self._lines).encode()
        self._lines.clear()
        self._digest.update(text)
        if self._file is not None:
            self._file.write(text)

    @property
    def log_sha256(self) -> str:
        """Hexadecimal SHA-256 of the log; writes what waits."""
        self.flush()
        return self._digest.hexdigest()
