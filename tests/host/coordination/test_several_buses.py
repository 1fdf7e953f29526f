"""A coordinator of cells on two buses that have the same node ids."""

import numpy as np

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.recovery import Policy
from mdms_host.coordination.run_state import Phase
from mdms_host.layout import Layout
from mdms_host.motion.program import FieldProgram
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame

#: Cells 1 and 3 are on bus 0, cells 2 and 4 on bus 1.
LAYOUT = Layout(2, 2, node_ids=(1, 2, 2, 1), buses=(0, 1, 0, 1))
STEP_S = 0.001


class Table:
    """The cells of a layout, each on its bus, and the frames that the host has sent."""

    def __init__(self, kinematic_cell, layout=LAYOUT):
        self.cells = [kinematic_cell(node_id) for node_id in layout.node_ids]
        self.buses = layout.buses
        self.sent = []
        self.now_s = 0.0
        self.cut = set()

    def run(self, coordinator, until_s):
        while self.now_s < until_s:
            heard = []
            if coordinator.wake_s <= self.now_s:
                for bus, frame in coordinator.poll_buses(self.now_s):
                    self.sent.append((round(self.now_s, 3), bus, frame))
                    for cell, own in zip(self.cells, self.buses, strict=True):
                        if own == bus and bus not in self.cut:
                            answers = cell.on_frame(frame, tuple(cell.target_um_s))
                            heard += [(bus, answer) for answer in answers]
            for cell, bus in zip(self.cells, self.buses, strict=True):
                heard += [(bus, frame) for frame in cell.poll(self.now_s, 0)]
            for bus, frame in heard:
                if bus not in self.cut:
                    coordinator.on_frame(frame, self.now_s, bus)
            self.now_s += STEP_S

    def times(self, bus, can_id):
        return [at_s for at_s, to, frame in self.sent if (to, frame.can_id) == (bus, can_id)]


def moving(speeds_m_s=(0.01, 0.02, 0.03, 0.04)):
    return Coordinator(LAYOUT, FieldProgram(np.repeat(speeds_m_s, 2)), policy=Policy(pauses=0))


def test_each_cell_gets_its_setpoint_on_its_own_bus(kinematic_cell):
    coordinator, table = moving(), Table(kinematic_cell)
    table.run(coordinator, 1.0)
    assert coordinator.phase is Phase.RUNNING
    assert [cell.target_um_s[0] for cell in table.cells] == [10_000, 20_000, 30_000, 40_000]
    np.testing.assert_allclose(coordinator.speeds_m_s, np.repeat([0.01, 0.02, 0.03, 0.04], 2))


def test_sync_and_heartbeat_go_out_on_all_buses_at_the_same_instants(kinematic_cell):
    coordinator, table = moving(), Table(kinematic_cell)
    table.run(coordinator, 1.0)
    for can_id in (cob.SYNC, cob.HEARTBEAT_BASE + cob.NODE_MAX):
        assert table.times(0, can_id) == table.times(1, can_id)
        assert table.times(0, can_id)


def test_frame_of_another_bus_is_another_cells(kinematic_cell):
    coordinator, table = moving(), Table(kinematic_cell)
    table.run(coordinator, 1.0)
    lost = Frame(pdo.STATUS.can_id(1), pdo.STATUS.encode((0x08, 0x08, 0)))
    coordinator.on_frame(lost, table.now_s, 1)
    table.run(coordinator, 1.02)
    assert coordinator.fault.startswith("cell 4 (node 1 of bus 1) has disabled its drives")


def test_forwarded_state_of_a_cell_of_another_bus_changes_nothing(kinematic_cell):
    coordinator, table = moving(), Table(kinematic_cell)
    table.run(coordinator, 1.0)
    before = coordinator.speeds_m_s
    foreign = Frame(pdo.ACTUAL_VELOCITY.can_id(126), pdo.ACTUAL_VELOCITY.encode((1, 1)))
    coordinator.on_frame(foreign, table.now_s, 1)
    np.testing.assert_array_equal(coordinator.speeds_m_s, before)
    assert coordinator.fault is None


def test_bus_that_falls_silent_stops_the_cells_of_all(kinematic_cell):
    coordinator, table = moving(), Table(kinematic_cell)
    table.run(coordinator, 1.0)
    table.cut.add(1)
    table.run(coordinator, 2.0)
    assert "cell 2 (node 2 of bus 1) has fallen silent" in coordinator.fault
    assert "cell 4 (node 1 of bus 1) has fallen silent" in coordinator.fault
    assert [cell.states for cell in table.cells[::2]] == [[cia402.SWITCH_ON_DISABLED] * 2] * 2
    # It goes on sending to the cells that it does not hear, for they may hear it.
    stops = [frame for at_s, bus, frame in table.sent if at_s > 1.0 and bus == 1]
    assert (
        Frame(pdo.CONTROLWORD.can_id(1), pdo.CONTROLWORD.encode((cia402.QUICK_STOP,) * 2)) in stops
    )


def test_other_host_on_any_bus_is_met(kinematic_cell):
    coordinator, table = moving(), Table(kinematic_cell)
    table.run(coordinator, 1.0)
    coordinator.on_frame(nmt.heartbeat(cob.NODE_MAX, nmt.OPERATIONAL), table.now_s, 1)
    table.run(coordinator, 1.01)
    assert coordinator.fault.startswith("another host runs on this bus")
