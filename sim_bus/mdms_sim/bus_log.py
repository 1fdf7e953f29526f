"""Every frame of a run in candump's log format, and the digest that tells two runs apart."""

from hashlib import sha256
from typing import BinaryIO

from mdms_protocol.frame import Frame
from mdms_sim.bus.flags import EXTENDED, EXTENDED_MASK, REMOTE, STANDARD_MASK

NS_PER_US = 1000
US_PER_S = 1_000_000
INTERFACE = "mdms"


def log_line(frame: Frame, now_ns: int) -> str:
    """One line as `candump -L` writes it, in simulated time: `(0.001234) mdms 181#0011`."""
    can_id, data = frame
    now_us = now_ns // NS_PER_US
    name = f"{can_id & EXTENDED_MASK:08X}" if can_id & EXTENDED else f"{can_id & STANDARD_MASK:03X}"
    body = f"R{len(data)}" if can_id & REMOTE else data.hex().upper()
    return f"({now_us // US_PER_S}.{now_us % US_PER_S:06d}) {INTERFACE} {name}#{body}\n"


class BusLog:
    """Writes frames to `file`, if any; `log_sha256` is the digest of all the bytes so far."""

    def __init__(self, file: BinaryIO | None = None) -> None:
        self._file = file
        self._digest = sha256()

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """Appends one line; an observer of the bus."""
        line = log_line(frame, now_ns).encode()
        self._digest.update(line)
        if self._file is not None:
            self._file.write(line)

    @property
    def log_sha256(self) -> str:
        """Hexadecimal SHA-256 of the log."""
        return self._digest.hexdigest()
