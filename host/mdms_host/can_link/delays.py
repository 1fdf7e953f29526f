"""When the host itself, or what brings it frames, was held up: the reason behind many a fault."""

from collections import deque

#: What is older has nothing to do with a fault [s].
_WINDOW_S = 1.0
#: A cycle this late leaves little of the 50 ms after which a cell gives up waiting for setpoints.
LATE_S = 0.02
#: While SYNC goes out every 10 ms something comes in as often; this is a pause.
PAUSE_S = 0.03
#: Pauses that come to so much in a second leave little of the 0.3 s that a cell may be silent.
PAUSES_S = 0.1


class Delays:
    """Late cycles, and pauses in what comes in, of the last second, while SYNC goes out.

    Cycles are reported by one thread and arrivals by another.
    """

    def __init__(self) -> None:
        self._late: deque[tuple[float, float]] = deque(maxlen=200)
        self._pauses: deque[tuple[float, float]] = deque(maxlen=200)
        self._arrived_s: float | None = None

    def on_cycle(self, due_s: float, now_s: float) -> None:
        """Something that was due is done now."""
        if now_s - due_s >= LATE_S:
            self._late.append((now_s, now_s - due_s))

    def on_arrival(self, now_s: float) -> None:
        """A frame was read."""
        if self._arrived_s is not None and now_s - self._arrived_s >= PAUSE_S:
            self._pauses.append((now_s, now_s - self._arrived_s))
        self._arrived_s = now_s

    def reason(self, now_s: float) -> str | None:
        """What was held up in the last second, and where; None if nothing was."""
        late_s = max(_recent(self._late, now_s), default=0.0)
        pauses = _recent(self._pauses, now_s)
        if self._arrived_s is not None and now_s - self._arrived_s >= PAUSE_S:
            pauses.append(now_s - self._arrived_s)
        paused_s = sum(pauses)
        if paused_s >= max(PAUSES_S, late_s * 2):
            return (
                f"nothing at all was received for {paused_s * 1e3:.0f} ms of the last second: the "
                "bus is open, or the adapter, its driver or the served array was held up"
            )
        if late_s >= LATE_S:
            return (
                f"this program's own cycle was up to {late_s * 1e3:.0f} ms late: "
                "the computer is too busy or too slow"
            )
        return None


def _recent(delays: deque[tuple[float, float]], now_s: float) -> list[float]:
    return [delay_s for time_s, delay_s in list(delays) if now_s - time_s <= _WINDOW_S]
