"""Three cells, a box over the middle one, and a tool on their bus, while faults are at work."""

from mdms_model.scenario.scenario import Array, Cell, Parcel, Run, Scenario, Wheel, Wire
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

CELLS = 3


def scenario(*faults, seed=1, bitrate=1_000_000, length_m=0.2):
    parcel = Parcel("box", 1.0, length_m, 0.1)
    run = Run(fidelity="firmware", seed=seed)
    cell = Cell(wheel=(Wheel(0.0), Wheel(1.5708)))
    wire = Wire(bitrate=bitrate)
    return Scenario("faults", Array(CELLS, 1), cell, (parcel,), run=run, fault=faults, wire=wire)


class Tool:
    """Starts the nodes after a while, sends SYNC every 10 ms and records the received frames."""

    def __init__(self):
        self.heard = []
        self.wake_s = 0.2
        self._started = False

    def on_frame(self, frame, now_s):
        self.heard.append((now_s, frame))

    def poll(self, now_s):
        self.wake_s = now_s + 0.01
        if not self._started:
            self._started = True
            return [Frame(cob.NMT, bytes([nmt.START, nmt.ALL_NODES]))]
        return [Frame(cob.SYNC, b"")]

    def times(self, can_id):
        return [now_s for now_s, frame in self.heard if frame.can_id == can_id]


class Life:
    """A scenario with faults, run for a while."""

    def __init__(self, *faults, until_s=2.0, kind=PythonBank, **more):
        bank = kind(range(1, CELLS + 1))
        self.tool = Tool()
        self.simulation = Simulation(scenario(*faults, **more), bank, [self.tool])
        self.simulation.run_until(until_s)
        self.outcome = self.simulation.outcome()
        bank.close()
        self.events = [
            (each.time_s, each.detail, each.cell)
            for each in self.outcome.record.events
            if each.kind == "fault"
        ]

    def speeds(self, cell, start_s, end_s):
        """How many state frames of a cell, counted from 1, the tool heard."""
        times = self.tool.times(cob.TPDO_BASES[0] + cell)
        return sum(1 for each in times if start_s <= each < end_s)
