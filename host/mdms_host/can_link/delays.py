"""Delays of the host and of what brings it frames: noticed, and kept short.

They are the reason behind many a fault. The thread of a run comes first, and turns are short.
"""

import gc
import os
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from statistics import median

from mdms_host.clock import Clock

#: An older delay has nothing to do with a fault [s].
_WINDOW_S = 1.0
#: A setpoint that is a cycle late may be held up again on its way, and cells wait for 50 ms.
LATE_S = 0.01
#: While SYNC goes out every 10 ms something comes in as often; this is a pause.
PAUSE_S = 0.03
#: Pauses that come to so much in a second leave little of the 0.3 s that a cell may be silent.
PAUSES_S = 0.1
#: Heartbeats are due every 0.1 s. When most cells' come this late, time passes slowly beyond the
#: link, though something may come in all the while.
SLOW_S = 0.2


class Delays:
    """Late cycles, pauses in the incoming frames, and late heartbeats of the last second.

    Cycles are reported by one thread and arrivals by another.
    """

    def __init__(self) -> None:
        self._late: deque[tuple[float, float]] = deque(maxlen=200)
        self._pauses: deque[tuple[float, float]] = deque(maxlen=200)
        self._blocked: deque[tuple[float, str]] = deque(maxlen=20)
        self._arrived_s: float | None = None
        #: By node: when its last heartbeat came, when one last came late, and how late [s].
        self._heartbeats: dict[int, tuple[float, float, float]] = {}

    def on_cycle(self, due_s: float, now_s: float) -> None:
        """Something that was due is done now."""
        if now_s - due_s >= LATE_S:
            self._late.append((now_s, now_s - due_s))

    def on_blocked(self, where: str, took_s: float, now_s: float) -> None:
        """The program that a person wrote has just computed for so long."""
        text = f"the program itself blocked for {took_s * 1e3:.0f} ms, in {where}"
        self._blocked.append((now_s, text))

    def on_arrival(self, now_s: float) -> None:
        """A frame was read."""
        if self._arrived_s is not None and now_s - self._arrived_s >= PAUSE_S:
            self._pauses.append((now_s, now_s - self._arrived_s))
        self._arrived_s = now_s

    def on_heartbeat(self, node_id: int, now_s: float) -> None:
        """A heartbeat was read."""
        before_s, late_s, gap_s = self._heartbeats.get(node_id, (now_s, now_s, 0.0))
        if now_s - before_s >= SLOW_S:
            late_s, gap_s = now_s, now_s - before_s
        self._heartbeats[node_id] = now_s, late_s, gap_s

    def reason(self, now_s: float) -> str | None:
        """The parts that were held up in the last second; None if nothing was."""
        blocked = [text for time_s, text in self._blocked if now_s - time_s <= _WINDOW_S]
        if blocked:
            return blocked[-1]
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
                f"the host's own cycle was up to {late_s * 1e3:.0f} ms late: "
                "the computer is too busy or too slow"
            )
        return self.slow_reason(now_s)

    def slow_reason(self, now_s: float) -> str | None:
        """The evidence of heartbeats alone, with or without SYNC; None if they come in time."""
        slow_s = self._usual_gap_s(now_s)
        if slow_s < SLOW_S:
            return None
        return (
            f"heartbeats of most cells, due every 100 ms, came after {slow_s * 1e3:.0f} ms: "
            "the bus is open, or the adapter, its driver or the served array was held up"
        )

    def _usual_gap_s(self, now_s: float) -> float:
        """How late the heartbeats of half of the cells were at least; one alone says nothing."""
        gaps_s = [
            max(now_s - last_s, gap_s if now_s - late_s <= _WINDOW_S else 0.0)
            for last_s, late_s, gap_s in list(self._heartbeats.values())
        ]
        return median(gaps_s) if len(gaps_s) > 1 else 0.0


def _recent(delays: deque[tuple[float, float]], now_s: float) -> list[float]:
    return [delay_s for time_s, delay_s in list(delays) if now_s - time_s <= _WINDOW_S]


#: How long a thread may compute while another waits for its turn [s]; Python's own is 5 ms.
_TURN_S = 0.001
#: The lowest of the real-time priorities: before all that have none.
_PRIORITY = 1


@contextmanager
def punctual(clock: Clock) -> Iterator[None]:
    """While it lasts, this thread comes first, turns are short, and garbage is soon found.

    The collector looks at objects of that time only: the modules of a run have loaded some 70,000
    objects, and going through them takes tens of milliseconds. Where no real time passes, nothing
    can be late, and all stays as it is.
    """
    if not clock.is_real:
        yield
        return
    turn_s = sys.getswitchinterval()
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(_TURN_S)
    try:
        with first_in_line():
            yield
    finally:
        sys.setswitchinterval(turn_s)
        gc.unfreeze()


@contextmanager
def first_in_line() -> Iterator[None]:
    """While it lasts, this thread has the processor before other programs, if it may (Linux).

    Root may, and anyone with a limit for real-time priorities. So have the threads that it starts:
    one of the interpreter's threads that has to wait for the processor keeps all others waiting.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(PermissionError):
        if before[0] == os.SCHED_OTHER:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(_PRIORITY))
    try:
        yield
    finally:
        with suppress(PermissionError):
            os.sched_setscheduler(0, *before)
