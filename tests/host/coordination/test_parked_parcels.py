"""Parcels that are parked, and others that come near them: with firmware, bus and physics."""

import numpy as np
import pytest

from mdms_array.host import coordinator_of
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import simulate

SCENARIO = """
title = "Two parcels of {length} x {width} m"
array = {{ columns = {columns}, rows = {rows} }}
motion = {{ field = "goal", speed_m_s = 0.1 }}
run = {{ fidelity = "firmware", duration_s = {duration_s}, seed = {seed} }}

[cell]
rotor_inertia_kg_m2 = 2e-6
wheel_inertia_kg_m2 = 2e-5
current_limit_a = 3.0
motor_spread = 0.05
friction_spread = 0.1
sensor_delay_s = 0.001
wheel = [
  {{ offset_m = [-0.03, 0.0] }},
  {{ direction_rad = 1.5707963267948966, offset_m = [0.03, 0.0] }},
]

[[parcel]]
name = "first"
mass_kg = 2.0
length_m = {length}
width_m = {width}
x_m = {first[0]}
y_m = {first[1]}
{first_goal}

[[parcel]]
name = "second"
mass_kg = 2.0
length_m = {length}
width_m = {width}
x_m = {second[0]}
y_m = {second[1]}
goal = {{ x_m = {goal[0]}, y_m = {goal[1]}, yaw_rad = 0.0 }}
"""


@pytest.fixture
def carried(tmp_path):
    """The record of a run, and its coordinator."""

    def run(**values):
        path = tmp_path / "two.toml"
        path.write_text(SCENARIO.format(**{"seed": 1, "first_goal": "", **values}))
        scenario = load_scenario(str(path), [])
        coordinator = coordinator_of(scenario)
        return simulate(scenario, [coordinator]).record, coordinator

    return run


def way_m(record, parcel: int) -> float:
    """How far a parcel has been away from where it was put."""
    return float(np.hypot(*(record.pose[:, parcel] - record.pose[0, parcel])[:, :2].T).max())


def held_s(coordinator, name: str, by: str) -> float:
    """When a parcel was reported to wait for another."""
    told = f"{name} waits, for 5 s at most: parcel '{name}' has no way from "
    ((time_s, text),) = [each for each in coordinator.events if each[1].startswith(told)]
    assert f"blocked by '{by}' at its place" in text
    return time_s


@pytest.mark.parametrize(("gap_m", "seed"), [(0.005, 1), (0.010, 2), (0.015, 3)])
def test_a_parked_parcel_stays_where_a_neighbour_passes_close_by(carried, gap_m, seed) -> None:
    y_m = -0.13 + 0.22 + gap_m
    record, coordinator = carried(
        length=0.28,
        width=0.22,
        columns=5,
        rows=4,
        duration_s=7.0,
        seed=seed,
        first=(0.01, -0.13),
        second=(-0.16, y_m),
        goal=(0.16, y_m),
    )
    assert way_m(record, 0) < 0.0005
    # The neighbour may brush against it while it is turned to where it was found to be.
    assert np.degrees(np.abs(record.pose[:, 0, 2]).max()) < 0.2
    assert coordinator.finished
    assert np.hypot(*(record.pose[-1, 1, :2] - (0.16, y_m))) < 0.01


def test_a_parcel_that_goes_straight_at_a_parked_one_waits_before_it(carried) -> None:
    record, coordinator = carried(
        length=0.28,
        width=0.30,
        columns=7,
        rows=3,
        duration_s=4.0,
        first=(0.08, 0.0),
        second=(-0.27, 0.0),
        goal=(0.28, 0.0),
    )
    assert held_s(coordinator, "second", by="first") < 4.0
    assert not [event for event in record.events if event.kind == "touch"]
    assert way_m(record, 0) < 0.0005
    assert np.abs(record.twist[-1]).max() < 1e-3
    assert not coordinator.finished
    assert not [event for event in record.events if event.kind == "tip"]


def test_two_that_want_one_place_are_both_stopped(carried) -> None:
    record, coordinator = carried(
        length=0.28,
        width=0.30,
        columns=7,
        rows=3,
        duration_s=4.0,
        first=(0.22, 0.0),
        first_goal="goal = { x_m = 0.02, y_m = 0.0, yaw_rad = 0.0 }",
        second=(-0.22, 0.01),
        goal=(0.0, 0.0),
    )
    stopped = max(
        held_s(coordinator, "second", by="first"), held_s(coordinator, "first", by="second")
    )
    assert not [event for event in record.events if event.kind == "touch"]
    assert np.abs(record.twist[-1]).max() < 1e-3
    after = record.time_s > stopped + 0.6
    assert np.ptp(record.pose[after], axis=0).max() < 1e-3
