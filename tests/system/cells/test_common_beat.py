"""18 cells on the virtual bus keep a common beat: without a host, through crashes and cuts."""

from contextlib import closing
from dataclasses import replace
from itertools import pairwise

import pytest

from mdms_model.scenario.fault import Fault
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

CELLS = range(1, 19)
STARTED_S = 0.1
BEAT_S = 0.01
#: A frame on a busy bus and a turn of the background.
SLACK_S = 0.002
SETPOINT_TIMEOUT_S = 0.05


class Starter:
    """Has each cell take over where SYNC is missed, starts it, and gives SYNC itself at times."""

    def __init__(self, gives):
        self.wake_s = STARTED_S
        self._gives = gives
        self._owed = list(CELLS)

    def on_frame(self, frame, now_s):
        if frame.data == b"\x00" and frame.can_id > cob.HEARTBEAT_BASE and now_s > STARTED_S:
            self._owed.append(frame.can_id - cob.HEARTBEAT_BASE)

    def poll(self, now_s):
        self.wake_s = now_s + BEAT_S
        frames = (
            [Frame(cob.SYNC, b"")] if any(low <= now_s < high for low, high in self._gives) else []
        )
        for node in self._owed:
            write = sdo.write_request(0x3014, 3, b"\x01")
            frames += [Frame(cob.SDO_REQUEST_BASE + node, write), nmt.command(nmt.START, node)]
        self._owed = []
        return frames


class Beats:
    """When each cell has seen a beat, by the speeds that it answers with; and all SYNCs."""

    def __init__(self, *faults, until_s=0.7, gives=()):
        scenario = replace(load_scenario("array18"), fault=faults)
        self.cells = {node: [] for node in CELLS}
        self.syncs_s = []
        with closing(PythonBank(CELLS)) as bank:
            simulation = Simulation(scenario, bank, [Starter(gives)], recording=None)
            simulation.bus.observe(self._on_frame)
            simulation.run_until(until_s)
        self.errors = simulation.bus.errors

    def _on_frame(self, frame, now_ns):
        if frame.can_id == cob.SYNC:
            self.syncs_s.append(now_ns / 1e9)
        elif frame.can_id - cob.TPDO_BASES[0] in self.cells:
            self.cells[frame.can_id - cob.TPDO_BASES[0]].append(now_ns / 1e9)

    def largest_gap_s(self, node):
        times_s = self.cells[node]
        return max(after - before for before, after in pairwise(times_s))

    def regular_since_s(self):
        """From when on there is one SYNC a beat, until the end."""
        times_s = self.syncs_s
        for place in range(len(times_s) - 1, 0, -1):
            if abs(times_s[place] - times_s[place - 1] - BEAT_S) > SLACK_S:
                return times_s[place]
        return times_s[0]


def test_cells_find_a_beat_without_a_host():
    beats = Beats(until_s=0.4)
    assert beats.syncs_s[0] < STARTED_S + 3 * BEAT_S
    assert beats.regular_since_s() < STARTED_S + 5 * BEAT_S
    assert len({len(times_s) for times_s in beats.cells.values()}) == 1


def test_loss_of_producer_and_successor_is_made_up_for_within_three_beats_each():
    gone = Fault("off", start_s=0.3, cells=(1,)), Fault("off", start_s=0.334, cells=(2,))
    beats = Beats(*gone)
    for node in CELLS[2:]:
        assert beats.largest_gap_s(node) < 3 * BEAT_S + SLACK_S
        assert beats.cells[node][-1] > 0.68
    assert beats.regular_since_s() < 0.334 + 3 * BEAT_S + SLACK_S


def test_last_cells_go_on_before_their_setpoints_are_stale():
    beats = Beats(Fault("off", start_s=0.3, cells=tuple(range(1, 18))))
    assert beats.largest_gap_s(18) < SETPOINT_TIMEOUT_S
    assert beats.cells[18][-1] > 0.68


def test_cell_that_restarts_does_not_disturb_the_beat():
    beats = Beats(Fault("off", start_s=0.3, duration_s=0.1, cells=(1,)))
    assert beats.regular_since_s() < 0.3 + 3 * BEAT_S + SLACK_S
    assert beats.cells[1][-1] > 0.68


@pytest.mark.parametrize("healed_s", [0.5, 0.5025, 0.505, 0.5099])
def test_after_a_partition_two_beats_coexist_for_one_beat_at_most(healed_s):
    cut = Fault("cut", start_s=0.3, duration_s=healed_s - 0.3, cells=tuple(range(1, 10)))
    beats = Beats(cut)
    for node in CELLS:
        assert beats.largest_gap_s(node) < SETPOINT_TIMEOUT_S
    apart = [time_s for time_s in beats.syncs_s if 0.4 < time_s < 0.5]
    assert len(apart) == pytest.approx(20, abs=1)
    assert beats.regular_since_s() < healed_s + BEAT_S + SLACK_S


@pytest.mark.parametrize("node", [6, 18])
def test_cell_that_was_cut_off_alone_brings_no_burst_of_late_beats(node):
    beats = Beats(Fault("cut", start_s=0.3, duration_s=0.3, cells=(node,)), until_s=0.8)
    late = [time_s for time_s in beats.syncs_s if 0.595 < time_s < 0.695]
    assert len(late) <= 10 + 4
    assert beats.regular_since_s() < 0.6 + 4 * BEAT_S


def test_cells_yield_to_the_host_that_is_back():
    beats = Beats(gives=((0.1, 0.3), (0.505, 1.0)))
    assert beats.regular_since_s() < 0.505 + 2 * BEAT_S
    for node in CELLS:
        assert beats.largest_gap_s(node) < 3 * BEAT_S + SLACK_S
