"""Six by two cells, a box over the first columns, and a tool that drives all wheels alike.

The deliberately broken part is the test's: a patched firmware, a bank that holds voltages, the
tool.
"""

from contextlib import closing

from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Array, Parcel, Run, Scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

COLUMNS, ROWS = 6, 2
CELLS = COLUMNS * ROWS
PERIOD_S = 0.01
TARGETS_UM_S = (50_000, 20_000)


def scenario(*faults):
    parcel = Parcel("box", 1.0, 0.28, 0.2, x_m=-0.19, y_m=-0.02)
    run, cell = Run(fidelity="firmware"), load_scenario("array18").cell
    return Scenario("referee", Array(COLUMNS, ROWS), cell, (parcel,), run=run, fault=faults)


class Tool:
    """Enables all wheels, and gives them setpoints with SYNC until `silent_s`.

    `more` has other frames to send, by time.
    """

    def __init__(self, silent_s, targets_um_s, more):
        self._silent_s = silent_s
        self._data = pdo.TARGET_VELOCITY.encode(targets_um_s)
        words = (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)
        enabling = [
            (0.3 + 0.02 * number, control(node_id, word))
            for number, word in enumerate(words)
            for node_id in range(1, CELLS + 1)
        ]
        start = (0.25, nmt.command(nmt.START))
        self._queue = sorted([start, *enabling, *more], key=lambda each: each[0])
        self._next_s = 0.34
        self.wake_s = 0.2

    def on_frame(self, frame, now_s):
        """Nothing is heeded."""

    def poll(self, now_s):
        self.wake_s = now_s + 0.001
        while self._queue and self._queue[0][0] <= now_s + 1e-9:
            yield self._queue.pop(0)[1]
        if self._next_s <= now_s + 1e-9 and now_s < self._silent_s:
            self._next_s += PERIOD_S
            for node_id in range(1, CELLS + 1):
                yield Frame(pdo.TARGET_VELOCITY.can_id(node_id), self._data)
            yield Frame(cob.SYNC, b"")


class Holding(PythonBank):
    """Cells; cell number `cell`, from 0, holds its voltages [uV] from a time on [s]."""

    cell, from_s, voltages_uv = 0, float("inf"), (0, 0)
    measures_high = None
    _now_ms = 0

    def set_supply(self, cell, supply_uv):
        if cell != self.measures_high:
            super().set_supply(cell, supply_uv)

    def tick(self, *sensed):
        voltages_uv = super().tick(*sensed)
        self._now_ms += 1
        if self._now_ms > self.from_s * 1000:
            voltages_uv = voltages_uv.copy()
            voltages_uv[self.cell] = self.voltages_uv
            self._awake[self.cell] = 1
        return voltages_uv


def judge(
    *faults,
    until_s=1.5,
    silent_s=9.0,
    targets_um_s=TARGETS_UM_S,
    more=(),
    held=None,
    measures_high=None,
):
    """The violations of a run, as (rule, cell, time) in their order.

    `held` are a cell (from 1), a time and voltages that it holds from then on. The cell (from 1)
    that `measures_high` measures the full supply, whatever it is.
    """
    with closing(Holding(range(1, CELLS + 1))) as bank:
        if held is not None:
            cell, bank.from_s, bank.voltages_uv = held
            bank.cell = cell - 1
        simulation = Simulation(scenario(*faults), bank, [Tool(silent_s, targets_um_s, more)])
        if measures_high is not None:
            bank.measures_high = measures_high - 1
            simulation.referee.measures_high(measures_high - 1)
        simulation.run_until(until_s)
        outcome = simulation.outcome()
    return [(each.rule, each.cell, each.time_s) for each in outcome.violations]


def control(node_id, word):
    """The frame that gives both axes of a cell a controlword."""
    return Frame(pdo.CONTROLWORD.can_id(node_id), pdo.CONTROLWORD.encode((word, word)))


def write(node_id, index, sub, value, size=4):
    """The frame that writes an object."""
    data = sdo.write_request(index, sub, value.to_bytes(size, "little"))
    return Frame(cob.SDO_REQUEST_BASE + node_id, data)


def heartbeats(from_s, to_s):
    """The host's, every 20 ms."""
    alive = nmt.heartbeat(cob.HOST_NODE, nmt.OPERATIONAL)
    return [(from_s + 0.02 * number, alive) for number in range(round((to_s - from_s) / 0.02))]
