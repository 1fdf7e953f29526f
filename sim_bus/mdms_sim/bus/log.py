"""Every frame of a run in candump's log format, and the digest in which two runs differ."""

from functools import lru_cache
from hashlib import sha256
from typing import BinaryIO

from mdms_model.run.folder import START_S
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.identifier import EXTENDED, EXTENDED_MASK, REMOTE, STANDARD_MASK

NS_PER_S = 1_000_000_000
NS_PER_US = 1000
US_PER_S = 1_000_000
#: Lines are made, hashed and written so many at a time.
BATCH_LINES = 1024


@lru_cache(maxsize=4096)
def _name(can_id: int) -> str:
    if can_id & EXTENDED:
        return f"{can_id & EXTENDED_MASK:08X}"
    return f"{can_id & STANDARD_MASK:03X}"


class BusLog:
    """Writes frames to `file`, if any, as `candump -L` does: `(946684800.001234) mdms 181#0011`.

    The name is that of the frame's bus; of several they are `can0`, `can1` and so on. Times are
    simulated and begin at `START_S`. `log_sha256` is the digest of all lines so far with times that
    begin at 0.
    """

    def __init__(self, file: BinaryIO | None = None) -> None:
        self._file = file
        self._digest = sha256()
        self._waiting: list[tuple[Frame, int, str]] = []

    def on_frame(self, interface: str, frame: Frame, now_ns: int) -> None:
        """Appends one line; an observer of the bus of that name."""
        self._waiting.append((frame, now_ns, interface))
        if len(self._waiting) >= BATCH_LINES:
            self.flush()

    def flush(self) -> None:
        """Writes what waits; to be called before the file is closed."""
        self._digest.update(self._text(0))
        if self._file is not None:
            self._file.write(self._text(START_S))
        self._waiting.clear()

    def _text(self, start_s: int) -> bytes:
        lines = [
            f"({start_s + ns // NS_PER_S}.{ns // NS_PER_US % US_PER_S:06d}) {interface} "
            f"{_name(can_id)}#{f'R{len(data)}' if can_id & REMOTE else data.hex().upper()}\n"
            for (can_id, data), ns, interface in self._waiting
        ]
        return "".join(lines).encode()

    @property
    def log_sha256(self) -> str:
        """Hexadecimal SHA-256 of the lines from time 0 on; writes what waits."""
        self.flush()
        return self._digest.hexdigest()
