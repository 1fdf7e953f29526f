"""Real time: the only module of the simulator that looks at the machine's clock."""

import time
from collections.abc import Callable

NS_PER_S = 1_000_000_000
#: Well below the 50 ms after which a cell gives up waiting for setpoints: while the simulation
#: catches up, its time runs fast, and what clients send by the machine's clock comes late.
PATIENCE_NS = 20_000_000


def epoch_now_s() -> float:
    """Seconds since 1970."""
    return time.time()


class RealTime:
    """Simulated time that passes with the machine's, `speed` times as fast.

    What a slow machine cannot catch up with is given up after `patience_ns`; `late_ns` adds it up.
    `settling_ns` adds up how long the machine took to carry what is on a terminal's line.
    """

    def __init__(self, speed: float = 1.0, patience_ns: int = PATIENCE_NS) -> None:
        self.late_ns = 0
        self.settling_ns = 0
        self._speed = speed
        self._patience_ns = patience_ns
        self._started_ns = time.monotonic_ns()
        self._epoch_s = time.time()

    def sim_ns(self, reached_ns: int) -> int:
        """What time it should be in the simulation, which has reached `reached_ns`."""
        due_ns = round((time.monotonic_ns() - self._started_ns) * self._speed) - self.late_ns
        behind_ns = due_ns - reached_ns - self._patience_ns
        if behind_ns > 0:
            self.late_ns += behind_ns
            due_ns -= behind_ns
        return due_ns

    def settle(self, settle: Callable[[], object]) -> None:
        """Call `settle`, and count the time that it takes."""
        started_ns = time.monotonic_ns()
        settle()
        self.settling_ns += time.monotonic_ns() - started_ns

    def wait_s(self, sim_ns: int, reached_ns: int) -> float:
        """How long until it should be `sim_ns` in the simulation [s of the machine's time]."""
        return max(0.0, (sim_ns - self.sim_ns(reached_ns)) / NS_PER_S / self._speed)

    def epoch_s(self, sim_ns: int) -> float:
        """A simulated instant as seconds since 1970, as tools want their timestamps."""
        return self._epoch_s + sim_ns / NS_PER_S
