"""Time in a served array, on a machine whose clock and whose terminals are scripted."""

import os
from itertools import pairwise
from types import SimpleNamespace

import pytest
from tests.sim_bus.bus.ear import Ear

from mdms_sim.bus.bus import Bus
from mdms_sim.kernel import Kernel
from mdms_sim.serve import endpoint
from mdms_sim.serve.clock import PATIENCE_NS
from mdms_sim.serve.server import SLICE_NS, Server

MS = 1_000_000
TURN_NS = MS // 4
PERIOD_NS = 10 * MS
OPEN, SETPOINT = b"S8\rO\r", b"t2010\r"
#: The longest time for which a busy machine was seen to leave data for a terminal.
STALL = range(100 * MS, 300 * MS)


class Machine:
    """The clock, and a kernel that carries over nothing from terminals during a stall."""

    def __init__(self, stall: range) -> None:
        self.now_ns = 0
        self.sent: list[int] = []
        self._stall = stall
        self._on_its_way = bytearray(OPEN)
        self.carry_to = -1

    def monotonic_ns(self) -> int:
        return self.now_ns

    def time(self) -> float:
        return self.now_ns / 1e9

    def write(self, line: bytes) -> None:
        self._on_its_way += line
        self.sent.append(self.now_ns)

    def turn(self) -> None:
        """Time passes, and a client sends a setpoint now and then."""
        self.now_ns += TURN_NS
        if self.now_ns % PERIOD_NS == 0:
            self.write(SETPOINT)
        self.carry()

    def carry(self) -> None:
        if self._on_its_way and self.now_ns not in self._stall:
            os.write(self.carry_to, self._on_its_way)
            self._on_its_way.clear()

    def wait_until_carried(self) -> None:
        if self._on_its_way and self.now_ns in self._stall:
            self.now_ns = self._stall.stop
        self.carry()


@pytest.fixture
def machine(monkeypatch):
    machine = Machine(STALL)

    class Terminal(endpoint.Terminal):
        def __init__(self) -> None:
            super().__init__()
            machine.carry_to = self._client_end

        def settle(self) -> None:
            machine.wait_until_carried()
            super().settle()

    monkeypatch.setattr("mdms_sim.serve.clock.time", machine)
    monkeypatch.setattr("mdms_sim.serve.server.Terminal", Terminal)
    return machine


def bare_simulation():
    """A bus and its time, and nothing that would be on it."""
    kernel = Kernel()
    bus = Bus(kernel, 1_000_000)
    return SimpleNamespace(kernel=kernel, bus=bus, buses=[bus], tipped=False, blinking=[])


def test_setpoints_come_in_time_when_the_kernel_leaves_a_terminal_alone(machine, tmp_path):
    simulation, ear = bare_simulation(), Ear()
    simulation.bus.attach(ear)

    def over() -> bool:
        machine.turn()
        return machine.now_ns == STALL.stop + 10 * PERIOD_NS + PERIOD_NS // 2

    with Server(simulation, str(tmp_path / "bus.sock")) as server:
        server.run(over)
        lost_ns = server.time.late_ns
    assert len(ear.heard) == len(machine.sent)
    gaps_ns = [later - earlier for (_, earlier), (_, later) in pairwise(ear.heard)]
    assert max(gaps_ns) <= PERIOD_NS + PATIENCE_NS + 2 * SLICE_NS
    assert lost_ns == pytest.approx(len(STALL) - PATIENCE_NS, abs=SLICE_NS)


def test_time_that_a_terminal_takes_from_the_array_is_reported(machine, tmp_path):
    told = []

    def over() -> bool:
        for _ in range(SLICE_NS // TURN_NS):
            machine.turn()
        return machine.now_ns >= 1250 * MS

    with Server(bare_simulation(), str(tmp_path / "bus.sock"), report=told.append) as server:
        server.run(over)
    assert len(told) == 1
    assert "0.18 s of the array's time were left out; it took 0.20 s to carry" in told[0]


def test_time_passes_with_the_machines_while_a_terminal_works(machine, tmp_path):
    simulation = bare_simulation()

    def over() -> bool:
        machine.turn()
        return machine.now_ns == STALL.start - TURN_NS

    with Server(simulation, str(tmp_path / "bus.sock")) as server:
        server.run(over)
        assert server.time.late_ns == 0
    assert simulation.kernel.now_ns == pytest.approx(machine.now_ns, abs=SLICE_NS)


def test_first_steps_are_made_before_anybody_can_come_in(tmp_path):
    """Code that is compiled at its first use takes seconds where nothing was compiled before."""
    simulation, path = bare_simulation(), tmp_path / "bus.sock"
    open_then = []
    simulation.kernel.at(SLICE_NS, 0, lambda: open_then.append(path.exists()))
    with Server(simulation, str(path)):
        assert open_then == [False]
        assert path.exists()
