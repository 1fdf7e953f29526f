"""Real time, and lateness: the only module of the simulator that reads the machine's clock."""

import time
from collections.abc import Callable

NS_PER_S = 1_000_000_000
#: Well below the 50 ms after which a cell gives up waiting for setpoints: while the simulation
#: catches up, its time runs fast, and what clients send by the machine's clock comes late.
PATIENCE_NS = 20_000_000
#: How often somebody looks, at least, whether time passes at another speed, or ends [s].
LOOK_S = 0.01


def epoch_now_s() -> float:
    """Seconds since 1970."""
    return time.time()


class RealTime:
    """Simulated time that passes with the machine's, `speed` times as fast; at 0 it stands still.

    Time that a slow machine cannot make up is given up after `patience_ns`; `late_ns` adds it up.
    `settling_ns` adds up how long the machine took to carry the bytes on a terminal's line.
    """

    def __init__(self, speed: float = 1.0, patience_ns: int = PATIENCE_NS) -> None:
        self.late_ns = 0
        self.settling_ns = 0
        self.speed = speed
        self._patience_ns = patience_ns
        self._began_ns = self._started_ns = time.monotonic_ns()
        self._base_ns = 0
        self._epoch_s = time.time()

    def change_speed(self, speed: float, reached_ns: int) -> None:
        """Pass so many times as fast from now on, when the simulation has reached `reached_ns`."""
        self.speed = speed
        self._base_ns = reached_ns + self.late_ns
        self._started_ns = time.monotonic_ns()

    def wall_ns(self) -> int:
        """How much of the machine's time has passed since the start."""
        return time.monotonic_ns() - self._began_ns

    def sim_ns(self, reached_ns: int) -> int:
        """The time that it should be in the simulation, which has reached `reached_ns`."""
        passed_ns = round((time.monotonic_ns() - self._started_ns) * self.speed)
        due_ns = self._base_ns + passed_ns - self.late_ns
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
        """How long until it should be `sim_ns` in the simulation [s of the machine's time].

        It is a hundredth of a second at most, to look after all else.
        """
        if not self.speed:
            return LOOK_S
        return min(LOOK_S, max(0.0, (sim_ns - self.sim_ns(reached_ns)) / NS_PER_S / self.speed))

    def epoch_s(self, sim_ns: int) -> float:
        """A simulated instant as seconds since 1970, as tools want their timestamps."""
        return self._epoch_s + sim_ns / NS_PER_S


#: Looked at once a second of simulated time.
_PERIOD_NS = 1_000_000_000
#: Clients that go by the machine's clock find heartbeats of 0.1 s overdue at 0.3 s.
_REPORTED_NS = 100_000_000


class Lateness:
    """`report(text)` gets a line for each second in which much time was left out."""

    def __init__(self, time: RealTime, report: Callable[[str], object]) -> None:
        self._time = time
        self._report = report
        self._due_ns = _PERIOD_NS
        self._late_ns = 0
        self._settling_ns = 0

    def look(self, now_ns: int) -> None:
        """It is `now_ns` in the simulation."""
        if now_ns < self._due_ns:
            return
        late_ns = self._time.late_ns - self._late_ns
        settling_ns = self._time.settling_ns - self._settling_ns
        self._due_ns = now_ns + _PERIOD_NS
        self._late_ns, self._settling_ns = self._time.late_ns, self._time.settling_ns
        if late_ns < _REPORTED_NS:
            return
        text = f"the machine is too busy: {late_ns / 1e9:.2f} s of the array's time were left out"
        if 2 * settling_ns > late_ns:
            text += (
                f"; it took {settling_ns / 1e9:.2f} s to carry the bytes on the pseudo-terminal "
                "(python-can's `-i mdms` and --tcp do without)"
            )
        self._report(text)
