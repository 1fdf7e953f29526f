"""Real time, and the machine's load: the only module of the host that looks at the clock."""

import math
import os
import sys
import time
from datetime import UTC, datetime
from typing import Protocol

try:
    import resource
except ModuleNotFoundError:
    # Windows has none.
    resource = None  # type: ignore[assignment]


class Clock(Protocol):
    """Seconds since some moment, and waiting for them to pass.

    `is_real` says that the machine's own time passes, so that its pauses make a run late.
    """

    is_real: bool

    def now_s(self) -> float:
        """The time [s]; never goes back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Return after so many seconds."""
        ...


def _machine_s() -> float:
    """The machine's monotonic clock [s]; on Linux its usual one stops while it is suspended."""
    if sys.platform == "linux":
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()


class MonotonicClock:
    """The machine's monotonic clock, counted from when this was made."""

    is_real = True

    def __init__(self) -> None:
        self._start_s = _machine_s()

    def now_s(self) -> float:
        """See `Clock`."""
        return _machine_s() - self._start_s

    def sleep(self, seconds: float) -> None:
        """See `Clock`."""
        time.sleep(max(0.0, seconds))


def wall_text() -> str:
    """The date and the time of day, with the offset from UTC, as ISO 8601 has it."""
    return datetime.now(UTC).astimezone().isoformat(timespec="milliseconds")


def wall_s() -> float:
    """The time since 1970 [s]."""
    return time.time()


def process_s() -> float:
    """The processor time that this process has taken [s]."""
    return time.process_time()


def load_average() -> float:
    """How many programs have wanted a processor in the last minute; NaN where nobody counts."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan


def memory_bytes() -> int:
    """The most memory that this process has had; 0 where nobody counts."""
    if resource is None:
        return 0
    most: int = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024
