import pytest
from tests.sim_bus.bus.ear import Ear

from mdms_sim.bus.bus import Bus
from mdms_sim.bus.exchange import Disturbance
from mdms_sim.kernel import Kernel


class Bench:
    """A bus at 1 Mbit/s, where a bit is a microsecond, with `count` nodes."""

    def __init__(self, count):
        self.kernel = Kernel()
        self.bus = Bus(self.kernel)
        self.ears = []
        self.nodes = []
        for _ in range(count):
            self.attach()
        self.error_ends_us = []
        self.states = []
        self.bus.observe_errors(lambda now_ns: self.error_ends_us.append(now_ns // 1000))
        self.bus.observe_states(
            lambda node, now_ns: self.states.append((self.nodes.index(node), node.state))
        )

    def attach(self):
        self.ears.append(Ear())
        self.nodes.append(self.bus.attach(self.ears[-1]))

    def run_us(self, time_us):
        self.kernel.run_until(time_us * 1000)

    def at_us(self, time_us, action):
        self.kernel.at(time_us * 1000, 0, action)

    def disturb_first(self, count, **how):
        """The first `count` transmissions are disturbed."""
        left = [count]

        def disturb(sender, frame):
            left[0] -= 1
            return Disturbance(**how) if left[0] >= 0 else None

        self.bus.disturb(disturb)

    def counters(self):
        return [(node.errors.transmit, node.errors.receive) for node in self.nodes]

    def heard_us(self):
        """When each node has heard a frame."""
        return [[now_ns // 1000 for _, now_ns in ear.heard] for ear in self.ears]


@pytest.fixture(scope="session")
def bench_of():
    """Makes a bus with so many nodes."""
    return Bench
