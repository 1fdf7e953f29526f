"""Cells whose crystals are off: what their own clocks make of a simulated second."""

from itertools import accumulate, chain, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdms_protocol import cob, nmt
from mdms_protocol.frame import Frame
from mdms_sim.nodes.condition import PPM, Conditions
from mdms_sim.nodes.micropython_bank import MicropythonBank
from mdms_sim.nodes.python_bank import PythonBank

CELLS = 3
DRIFTS = st.integers(-500_000, 500_000)
KINDS = pytest.mark.parametrize("kind", [PythonBank, MicropythonBank])


def periods(conditions, steps):
    """The times that cell 0 shows in each of so many steps."""
    made = []
    for _ in range(steps):
        made.append([turn[0] for turn in conditions.turns() if 0 in turn])
        conditions.ticks += 1
    return made


@given(DRIFTS, st.integers(1, 3000))
def test_a_clock_makes_its_periods_by_its_own_time(drift_ppm, steps):
    conditions = Conditions(1)
    conditions.set_drift(0, drift_ppm)
    made = periods(conditions, steps)
    for step, total in enumerate(accumulate(map(len, made))):
        assert total == 1 + step * (PPM + drift_ppm) // PPM
    assert list(chain(*made)) == list(range(sum(map(len, made))))


@given(st.lists(st.tuples(DRIFTS, st.integers(0, 50)), max_size=8), st.booleans())
def test_a_clock_neither_leaps_nor_stops_when_its_drift_changes(changes, restarts):
    conditions = Conditions(1)
    made = periods(conditions, 7)
    for drift_ppm, steps in changes:
        conditions.set_drift(0, drift_ppm)
        made += periods(conditions, steps)
    assert list(chain(*made)) == list(range(sum(map(len, made))))
    assert all(len(each) <= 2 for each in made)
    if restarts:
        conditions.restart(0)
        assert periods(conditions, 1) == [[0]]


def test_a_cell_that_does_not_run_makes_none():
    conditions = Conditions(2)
    conditions.set_drift(1, 500_000)
    conditions.halt(0, (0, 0))
    assert [list(turn) for turn in conditions.turns()] == [[1]]


class Inputs:
    """Somebody who turns the wheels, and writes down all that the cells do."""

    def __init__(self, bank):
        self.bank = bank
        self.heard = []
        self._random = np.random.default_rng(1)
        self._counts = np.zeros((CELLS, 2), np.int32)
        self._presence = np.zeros(CELLS, np.uint8)

    def tick(self, ticks):
        for _ in range(ticks):
            self._counts += self._random.integers(-2, 5, (CELLS, 2)).astype(np.int32)
            currents_ma = self._random.integers(-900, 900, (CELLS, 2)).astype(np.int32)
            if self._random.random() < 0.1:
                self._presence[:] = self._random.integers(0, 32, CELLS)
            voltages_uv = self.bank.tick(self._counts, currents_ma, self._presence)
            self.heard.append((voltages_uv.tolist(), self.collect()))
        return self.heard[-1][0]

    def tell(self, can_id, data):
        for cell in range(CELLS):
            self.bank.deliver(cell, Frame(can_id, data))
        self.heard.append((None, self.collect()))

    def collect(self):
        return [list(self.bank.collect(cell)) for cell in range(CELLS)]

    def enable(self):
        self.tick(120)
        self.tell(cob.NMT, bytes([nmt.START, nmt.ALL_NODES]))
        for word in (0x06, 0x07, 0x0F):
            for cell in range(CELLS):
                self.tell(cob.RPDO_BASES[1] + cell + 1, bytes([word, 0, word, 0]))
            self.tick(3)

    def drive(self, ticks):
        for number in range(ticks):
            if number % 10 == 0:
                for cell in range(CELLS):
                    speeds = np.array([30_000 + number, -20_000 * cell], "<i4")
                    self.tell(cob.RPDO_BASES[0] + cell + 1, speeds.tobytes())
                self.tell(cob.SYNC, b"")
            voltages_uv = self.tick(1)
        return voltages_uv


@settings(deadline=None, max_examples=6)
@given(drifts=st.tuples(DRIFTS, DRIFTS, DRIFTS), later=DRIFTS)
def test_both_kinds_of_cells_drift_the_same(drifts, later):
    def life(kind):
        bank = kind(range(1, CELLS + 1))
        inputs = Inputs(bank)
        for cell, drift_ppm in enumerate(drifts):
            bank.set_drift(cell, drift_ppm)
        inputs.tick(100)
        inputs.enable()
        inputs.drive(30)
        bank.set_drift(0, later)
        bank.hang(1)
        bank.set_bus_off(2, True)
        inputs.drive(15)
        bank.restart(1)
        bank.set_bus_off(2, False)
        inputs.drive(30)
        bank.close()
        return inputs.heard

    assert life(PythonBank) == life(MicropythonBank)


@KINDS
def test_a_period_that_is_left_out_holds_the_voltages(kind):
    bank = kind(range(1, CELLS + 1))
    inputs = Inputs(bank)
    inputs.enable()
    inputs.drive(20)
    bank.set_drift(0, -500_000)
    voltages_uv = [inputs.drive(1) for _ in range(8)]
    bank.close()
    changed = [before[0] != after[0] for before, after in pairwise(voltages_uv)]
    assert changed in (([True, False] * 4)[:7], ([False, True] * 4)[:7])
