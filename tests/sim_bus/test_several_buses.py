"""Four cells in a row on two buses, and a tool that is on both."""

from contextlib import closing
from io import BytesIO

import pytest
from tests.micropython_builds import skipping_without_micropython

from mdms_model.scenario.fault import Fault
from mdms_model.scenario.scenario import Array, Cell, Parcel, Run, Scenario, Wheel
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_sim.simulation import Recording, Simulation, addresses_of, open_bank

LISTS = ((1, 2), (3, 4))
SPEEDS = cob.TPDO_BASES[0]


def scenario(*faults, buses=LISTS, forwarded=()):
    return Scenario(
        "buses",
        Array(4, 1, buses=buses, forwarded=forwarded),
        Cell(wheel=(Wheel(0.0), Wheel(1.5708))),
        (Parcel("box", 1.0, 0.2, 0.1),),
        run=Run(fidelity="firmware"),
        fault=faults,
    )


class Tool:
    """Starts the nodes of all buses after a while, then sends SYNC on all every 10 ms."""

    def __init__(self, buses=2):
        self.heard = []
        self.wake_s = 0.2
        self._buses = range(buses)
        self._started = False

    def on_frame(self, frame, now_s, bus=0):
        self.heard.append((bus, frame.can_id, now_s))

    def poll_buses(self, now_s):
        self.wake_s = now_s + 0.01
        frame = Frame(cob.SYNC, b"")
        if not self._started:
            frame = Frame(cob.NMT, bytes([nmt.START, nmt.ALL_NODES]))
        self._started = True
        return [(bus, frame) for bus in self._buses]

    def count(self, bus, can_id, start_s=0.0, end_s=10.0):
        return sum(each[:2] == (bus, can_id) and start_s <= each[2] < end_s for each in self.heard)


class PlainTool(Tool):
    """A tool without a method for buses."""

    poll_buses = None

    def poll(self, now_s):
        return [frame for _, frame in Tool.poll_buses(self, now_s)]


def life(*faults, until_s=0.6, tool=None, nodes="cpython", **more):
    """A tool that has heard a run, the run, and its bus log."""
    tool, log = tool or Tool(), BytesIO()
    scene = scenario(*faults, **more)
    with closing(open_bank(nodes, addresses_of(scene).node_ids)) as bank:
        simulation = Simulation(scene, bank, [tool], recording=Recording(log))
        simulation.run_until(until_s)
        simulation.outcome()
    return tool, simulation, log.getvalue().decode()


def test_cells_of_two_buses_have_the_same_node_ids_and_answer_on_their_own():
    tool, simulation, _ = life()
    answers = [tool.count(bus, SPEEDS + node) for bus in (0, 1) for node in (1, 2, 3)]
    assert answers == [39, 39, 0, 39, 39, 0]
    assert [bus.frames for bus in simulation.buses] == [simulation.outcome().bus.frames // 2] * 2


def test_log_names_the_bus_of_every_frame():
    _, _, log = life(until_s=0.3)
    names = [line.split()[1] for line in log.splitlines()]
    assert {*names} == {"can0", "can1"}
    assert names.count("can0") == names.count("can1")


def test_sync_goes_out_on_all_buses_at_one_instant():
    _, _, log = life(until_s=0.3)
    times = [
        [line.split()[0] for line in log.splitlines() if f"{name} 080#" in line]
        for name in ("can0", "can1")
    ]
    assert times[0] == times[1]
    assert len(times[0]) == 9


def test_load_is_that_of_the_busiest_bus():
    lists = ((1, 2, 3), (4,))
    _, simulation, _ = life(buses=lists)
    loads = [bus.load() for bus in simulation.buses]
    assert loads[0] > 1.5 * loads[1]
    assert simulation.outcome().bus.load == loads[0]


def test_same_seed_gives_the_same_bytes():
    noise = Fault("loss", start_s=0.3, probability=0.3)
    digests = [life(noise)[1].outcome().bus.log_sha256 for _ in range(2)]
    assert digests[0] == digests[1]


def test_micropython_processes_give_the_same_bytes():
    with skipping_without_micropython():
        micropython = life(until_s=0.4, nodes="micropython", forwarded=(1,))
    python = life(until_s=0.4, forwarded=(1,))
    digests = [run.outcome().bus.log_sha256 for _, run, _ in (micropython, python)]
    assert digests[0] == digests[1]


def test_participant_without_a_word_for_buses_is_on_the_first():
    tool, simulation, _ = life(tool=PlainTool(1))
    assert {bus for bus, *_ in tool.heard} == {0}
    assert tool.count(0, SPEEDS + 1) == 39
    # Nobody sends SYNC on the other; its cells still boot and beat.
    assert 0 < simulation.buses[1].frames < simulation.buses[0].frames


def test_states_of_cells_at_a_border_are_heard_beyond_it():
    tool, simulation, _ = life(forwarded=(1,))
    # Cell 2 is node 2 of bus 0, cell 3 node 1 of bus 1; over the border both are node 126.
    assert tool.count(1, SPEEDS + 126) == tool.count(0, SPEEDS + 2) == 39
    assert tool.count(0, SPEEDS + 126) == tool.count(1, SPEEDS + 1) == 39
    assert [way.dropped for way in simulation.gateways[0].ways] == [0, 0]


# Faults


def test_frames_lost_on_one_bus_do_not_concern_the_other():
    tool, _, _ = life(Fault("loss", start_s=0.4, bus=1))
    assert tool.count(0, SPEEDS + 1, 0.41) == 19
    assert tool.count(1, SPEEDS + 1, 0.41) == 0


@pytest.mark.parametrize("kind", ["loss", "corruption"])
def test_cells_lose_frames_on_their_own_bus_alone(kind):
    tool, simulation, _ = life(Fault(kind, start_s=0.4, duration_s=0.1, cells=(3,)))
    counted = [each.detail for each in simulation.outcome().record.events if "ends" in each.detail]
    assert counted != [f"{kind} ends: 0 frames"]
    assert tool.count(0, SPEEDS + 1, 0.41, 0.5) == 9
    assert tool.count(1, SPEEDS + 1, 0.41, 0.5) == 0
    assert simulation.buses[0].errors == 0


def test_babbler_is_on_the_bus_of_its_cell():
    babble = Fault("babble", start_s=0.3, cells=(4,), can_id=1)
    tool, _, _ = life(babble)
    assert tool.count(0, 1) == 0
    assert tool.count(1, 1) > 1000
    assert tool.count(0, SPEEDS + 1, 0.41) == 19


def test_cut_splits_each_bus_between_its_cells_and_heals():
    tool, _, _ = life(Fault("cut", start_s=0.4, duration_s=0.1, cells=(2, 3)))
    assert tool.count(0, SPEEDS + 1, 0.41, 0.49) == tool.count(1, SPEEDS + 2, 0.41, 0.49) == 8
    assert tool.count(0, SPEEDS + 2, 0.41, 0.5) == tool.count(1, SPEEDS + 1, 0.41, 0.5) == 0
    assert tool.count(0, SPEEDS + 2, 0.52) > 0


def test_host_that_is_gone_from_one_bus_stays_on_the_other():
    tool, _, _ = life(Fault("host", start_s=0.4, duration_s=0.1, bus=1))
    assert tool.count(0, SPEEDS + 1, 0.41, 0.5) == 9
    assert tool.count(1, SPEEDS + 1, 0.41, 0.5) == 0
    assert tool.count(1, SPEEDS + 1, 0.51) > 5
