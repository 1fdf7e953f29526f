"""Cells whose crystals are off: what their own clocks make of a simulated second."""

from itertools import accumulate, chain, pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.sim_bus.nodes.bench import BOOT_TICKS, CELLS, Bench

from mdms_sim.nodes.bank import PPM, Conditions
from mdms_sim.nodes.micropython_bank import MicropythonBank
from mdms_sim.nodes.python_bank import PythonBank

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


@settings(deadline=None, max_examples=6)
@given(drifts=st.tuples(DRIFTS, DRIFTS, DRIFTS), later=DRIFTS)
def test_both_kinds_of_cells_drift_the_same(drifts, later):
    def life(kind):
        bank = kind(range(1, CELLS + 1))
        bench = Bench(bank)
        for cell, drift_ppm in enumerate(drifts):
            bank.set_drift(cell, drift_ppm)
        bench.tick(100 + BOOT_TICKS)
        bench.enable()
        bench.drive(30)
        bank.set_drift(0, later)
        bank.hang(1)
        bank.set_bus_off(2, True)
        bench.drive(15)
        bank.restart(1)
        bank.set_bus_off(2, False)
        bench.drive(30)
        bank.close()
        return bench.heard

    assert life(PythonBank) == life(MicropythonBank)


@KINDS
def test_a_period_that_is_left_out_holds_the_voltages(kind):
    bank = kind(range(1, CELLS + 1))
    bench = Bench(bank)
    bench.tick(BOOT_TICKS)
    bench.enable()
    bench.drive(20)
    bank.set_drift(0, -500_000)
    voltages_uv = [bench.drive(1).tolist() for _ in range(8)]
    bank.close()
    changed = [before[0] != after[0] for before, after in pairwise(voltages_uv)]
    assert changed in (([True, False] * 4)[:7], ([False, True] * 4)[:7])
