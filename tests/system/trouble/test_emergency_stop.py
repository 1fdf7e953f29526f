"""Emergency stops under a moving box: with a short it stays on the table, and coasting it tips."""

from contextlib import closing

import numpy as np
import pytest
from tests.benchmarks.sim_bus.stopping import hardware

import mdms_array as mdms
from mdms_array.host import coordinator_of
from mdms_model.scenario.file import load_scenario
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

#: The demo's box is at its fastest.
PRESSED_S = 0.93


def demo(fault):
    """The record of the demo under a fault of the supply from then on."""
    struck = f"fault=[{{kind='supply', start_s={PRESSED_S}{fault}}}]"
    return mdms.simulate(load_scenario("array18", [struck, "run.duration_s=3"])).record


def tips(record):
    return [event.time_s for event in record.events if event.kind == "tip"]


def test_the_demos_box_coasts_over_the_edge_when_the_bridges_only_lose_their_supply():
    (tipped_s,) = tips(demo(""))
    assert tipped_s == pytest.approx(2.0, abs=0.1)


def test_the_demos_box_stays_on_the_table_when_the_motors_are_shorted():
    record = demo(", brake=true")
    assert not tips(record)
    slow = np.abs(record.twist[:, 0]).max(axis=1) < 0.02
    assert slow[record.time_s > PRESSED_S + 1.0].all()
    # The cells' own volts are off, and their measurements are no supply.
    assert not np.abs(record.voltage_v[record.time_s > PRESSED_S + 0.01]).any()
    codes = [event.detail for event in record.events if "sends emergency 0x3220" in event.detail]
    assert len(codes) == 36


def test_a_box_that_waits_stands_when_the_contacts_open_again():
    """Released after 1 s: no cell drives until somebody resets it."""
    record = demo(", brake=true, duration_s=1.0")
    later = record.time_s > PRESSED_S + 1.0
    assert not np.abs(record.voltage_v[later]).any()
    assert np.abs(record.twist[later, 0]).max() < 0.02


def test_category_1_holds_the_demos_box_and_then_lets_its_wheels_coast():
    """The fault that began last counts, and goes on to when the first one ends."""
    short = "{kind='supply', start_s=0.9, brake=true, duration_s=1.2}"
    cut = "{kind='supply', start_s=1.9, duration_s=0.5}"
    scenario = load_scenario("array18", [f"fault=[{short}, {cut}]", "run.duration_s=3"])
    seen = {}

    def look(simulation):
        bridges = simulation.world.bridges
        return int(bridges.shorted.sum()), float(bridges.supply_v.max())

    with closing(PythonBank(range(1, 19))) as bank:
        simulation = Simulation(scenario, bank, [coordinator_of(scenario)], recording=None)
        for time_s in (0.5, 1.5, 2.2, 2.9):
            simulation.run_until(time_s)
            seen[time_s] = look(simulation)
        speed = np.abs(simulation.world.twist[0]).max()
    assert seen == {0.5: (0, 24.0), 1.5: (18, 0.0), 2.2: (0, 0.0), 2.9: (0, 24.0)}
    assert speed < 0.02


@pytest.mark.parametrize(
    ("form", "mass_kg", "speed_m_s", "least_m", "most_m"),
    [
        ("short", 2, 0.4, 0.06, 0.09),
        ("short", 10, 0.4, 0.20, 0.31),
        ("category 1", 2, 0.4, 0.06, 0.09),
        # It is not slow enough when the supply goes, and coasts on.
        ("category 1", 10, 0.4, 0.50, 0.90),
    ],
)
def test_boxes_run_on_as_far_as_the_firmwares_guide_has_it(
    form, mass_kg, speed_m_s, least_m, most_m
):
    assert least_m < hardware(form, mass_kg, speed_m_s).way_m < most_m
