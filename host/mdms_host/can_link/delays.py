"""When the host itself, or what brings it frames, was held up: the reason behind many a fault."""

from collections import deque

#: What is older has nothing to do with a fault [s].
_WINDOW_S = 1.0
#: A cycle this late leaves little of the 50 ms after which a cell gives up waiting for setpoints.
LATE_S = 0.02
#: A bus with cells is never silent for so long: each sends a heartbeat every 0.1 s.
SILENCE_S = 0.15


class Delays:
    """Late cycles and silences of the last second.

    Cycles are reported by one thread and arrivals by another.
    """

    def __init__(self) -> None:
        self._late: deque[tuple[float, float]] = deque(maxlen=200)
        self._silent: deque[tuple[float, float]] = deque(maxlen=200)
        self._arrived_s: float | None = None

    def on_cycle(self, due_s: float, now_s: float) -> None:
        """Something that was due is done now."""
        if now_s - due_s >= LATE_S:
            self._late.append((now_s, now_s - due_s))

    def on_arrival(self, now_s: float) -> None:
        """A frame was read."""
        if self._arrived_s is not None and now_s - self._arrived_s >= SILENCE_S:
            self._silent.append((now_s, now_s - self._arrived_s))
        self._arrived_s = now_s

    def reason(self, now_s: float) -> str | None:
        """What was held up in the last second, and where; None if nothing was."""
        late_s = _worst(self._late, now_s)
        silent_s = _worst(self._silent, now_s)
        if self._arrived_s is not None:
            silent_s = max(silent_s, now_s - self._arrived_s)
        if late_s >= LATE_S:
            return (
                f"this program's own cycle was up to {late_s * 1e3:.0f} ms late: "
                "the computer is too busy or too slow"
            )
        if silent_s >= SILENCE_S:
            return (
                f"nothing at all was received for {silent_s * 1e3:.0f} ms: the bus is open, or the "
                "adapter or the program that serves the array was held up"
            )
        return None


def _worst(delays: deque[tuple[float, float]], now_s: float) -> float:
    recent = (delay_s for time_s, delay_s in list(delays) if now_s - time_s <= _WINDOW_S)
    return max(recent, default=0.0)
