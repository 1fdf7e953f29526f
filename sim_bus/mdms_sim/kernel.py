"""Simulated time: one queue of events in integer nanoseconds, and nothing else that could give it.

Events at one instant run by priority, those of one priority in the order in which they were asked
for; so the same calls always give the same run.
"""

from collections.abc import Callable
from heapq import heappop, heappush
from itertools import count

Action = Callable[[], object]


class Kernel:
    """Runs actions in the order (time, priority, sequence); `now_ns` is the time they see."""

    __slots__ = ("_end_ns", "_heap", "_sequence", "now_ns")

    def __init__(self) -> None:
        self.now_ns = 0
        self._end_ns = 0
        self._heap: list[tuple[int, int, int, Action]] = []
        self._sequence = count()

    def at(self, time_ns: int, priority: int, action: Action) -> None:
        """Has `action` called at `time_ns`, lowest `priority` first; ValueError for the past."""
        if time_ns < self.now_ns:
            raise ValueError(f"asked for {time_ns} ns, but it is {self.now_ns} ns already")
        heappush(self._heap, (time_ns, priority, next(self._sequence), action))

    def run_until(self, time_ns: int) -> None:
        """Runs every event up to and including `time_ns`, then lets the clock stand there."""
        heap = self._heap
        self._end_ns = time_ns
        while heap and heap[0][0] <= time_ns:
            self.now_ns, _, _, action = heappop(heap)
            action()
        self.now_ns = max(self.now_ns, time_ns)

    def nothing_until(self, time_ns: int) -> bool:
        """Whether an action could as well be done now as at `time_ns`.

        That is so when no event comes before it ends, and nobody outside gets to act before.
        """
        heap = self._heap
        return time_ns <= self._end_ns and (not heap or heap[0][0] > time_ns)

    @property
    def next_ns(self) -> int | None:
        """When the next event is due, None when there is none."""
        return self._heap[0][0] if self._heap else None
