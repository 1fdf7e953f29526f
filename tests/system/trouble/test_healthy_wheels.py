"""Watching of stall and reversal is on by default, and a healthy wheel never meets it."""

import pytest
from tests.benchmarks.firmware.watching import faults

from mdms_array.host import coordinator_of
from mdms_cell.drive import axes
from mdms_model.scenario.file import load_scenario
from mdms_protocol.dictionary import ENTRIES
from mdms_sim.simulation import simulate

#: Of those that the benchmark tries, the ones that came nearest to a fault.
SEEDS = (5, 35, 120)


@pytest.mark.parametrize("seed", SEEDS)
def test_heavy_parcels_driven_to_and_fro_are_no_fault(seed):
    text, emergencies = faults(seed)
    assert emergencies == [], text


def test_watching_is_on_by_default_with_times_below_100_ms():
    for axis in (0, 0x800):
        assert 0 < ENTRIES[0x2004 + axis, 0].default <= 6_000  # mV
        assert 0 < ENTRIES[0x2005 + axis, 0].default < 100  # ms
        assert 0 < ENTRIES[0x200B + axis, 0].default <= 2_000
        assert 0 < ENTRIES[0x200C + axis, 0].default < 100


def test_goals_are_reached_with_watching_on():
    """The whole demo's goal with a parcel of 10 kg and motors 30 % off, and no emergency."""
    heavy = ["parcel.0.mass_kg=10", "cell.motor_spread=0.3", "run.duration_s=2.5"]
    scenario = load_scenario("array18", heavy)
    coordinator = coordinator_of(scenario)
    simulate(scenario, [coordinator])
    assert coordinator.fault is None
    assert coordinator.finished
    codes = (axes.STALLED, axes.REVERSED)
    assert not [text for _, text in coordinator.events if any(f"{c:04X}" in text for c in codes)]
