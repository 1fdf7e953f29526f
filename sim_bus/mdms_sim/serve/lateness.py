"""Reports when the machine does not grant a served array the time that it needs, and why."""

from collections.abc import Callable

from mdms_sim.serve.clock import RealTime

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
                f"; it took {settling_ns / 1e9:.2f} s to carry what was on the pseudo-terminal "
                "(python-can's `-i mdms` and --tcp do without)"
            )
        self._report(text)
