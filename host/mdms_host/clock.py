"""Real time: the only module of the host that looks at the machine's clock."""

import time
from typing import Protocol


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


class MonotonicClock:
    """The machine's monotonic clock, counted from when this was made."""

    is_real = True

    def __init__(self) -> None:
        self._start_s = time.monotonic()

    def now_s(self) -> float:
        """See `Clock`."""
        return time.monotonic() - self._start_s

    def sleep(self, seconds: float) -> None:
        """See `Clock`."""
        time.sleep(max(0.0, seconds))
