"""A link of the host to a whole simulated table, in virtual time: no machine is too slow for it."""

from collections import deque
from functools import partial
from math import ceil

from mdms_host.can_link.delays import Delays
from mdms_host.can_link.link import Incidents, Link, LinkCounts
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import NS_PER_S, Simulation, addresses_of

#: How far time goes before a frame that has come is handed over.
STEP_NS = 200_000
#: A link waits for a frame no longer than this, even if more is asked.
READ_TIMEOUT_S = 0.1


class SimulatedLink(Link):
    """A link whose table lives through exactly the time that the host waits, and its clock.

    The host thinks in no time at all. Left out: a device that fails, and several buses.
    """

    is_real = False

    def __init__(self, scenario):
        self._bank = PythonBank(addresses_of(scenario).node_ids)
        self._join(Simulation(scenario, self._bank, recording=None))

    @classmethod
    def around(cls, simulation):
        """A link to a table that lives already, and lives on when the link is closed."""
        link = cls.__new__(cls)
        link._bank = None
        link._join(simulation)
        return link

    def _join(self, simulation):
        self.delays = Delays()
        self._clock = self
        self._incidents = Incidents(self)
        self.simulation = simulation
        self._waiting = deque()
        self._mailbox = simulation.bus.attach(self)

    def on_frame(self, frame, now_ns):
        self._waiting.append((frame, now_ns / NS_PER_S))

    def now_s(self):
        return self.simulation.kernel.now_ns / NS_PER_S

    def sleep(self, seconds):
        self._pass_until(self.now_s() + seconds, lambda: False)

    @property
    def counts(self):
        return LinkCounts(0, 0, 0, 0)

    def send(self, frame, until_s=None):
        self._mailbox.send(frame)

    def receive(self, timeout_s, handle):
        wait_s = max(0.0, min(timeout_s, READ_TIMEOUT_S))
        self._pass_until(self.now_s() + wait_s, partial(bool, self._waiting))
        for _ in range(len(self._waiting)):
            handle(*self._waiting.popleft())

    def close(self):
        if self._bank is not None:
            self._bank.close()

    def _pass_until(self, end_s, over):
        kernel = self.simulation.kernel
        # A wait that is shorter than a nanosecond ends too.
        end_ns = max(ceil(end_s * NS_PER_S), kernel.now_ns + 1)
        while not over() and kernel.now_ns < end_ns:
            kernel.run_until(min(kernel.now_ns + STEP_NS, end_ns))
