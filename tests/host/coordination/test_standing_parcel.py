"""A parcel that has arrived, for half a minute: with firmware, bus and physics."""

import numpy as np
import pytest

from mdms_array.host import coordinator_of, estimates_of
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import simulate

#: On this small table it is turned and shifted to be felt first.
ARRIVED_S = 5.0


@pytest.mark.slow
def test_a_parcel_that_stands_for_half_a_minute_stays_and_so_does_its_belief() -> None:
    overrides = (
        "array.columns=5",
        "array.rows=2",
        "parcel.0.x_m=0.05",
        "parcel.0.goal.x_m=0.1",
        f"run.duration_s={ARRIVED_S + 30}",
    )
    scenario = load_scenario("array18", list(overrides))
    coordinator = coordinator_of(scenario)
    record = simulate(
        scenario, [coordinator], estimates=lambda: estimates_of(coordinator, scenario)
    ).record
    assert coordinator.finished
    standing = record.time_s >= ARRIVED_S
    pose, estimate = record.pose[standing, 0], record.estimate[standing, 0]
    assert np.ptp(pose[:, :2], axis=0).max() < 1e-4
    assert np.degrees(np.ptp(pose[:, 2])) < 0.01
    away = estimate - pose
    assert np.degrees(np.ptp(away[:, 2])) < 0.01
    assert np.degrees(np.abs(away[:, 2]).max()) < 0.2
    assert np.hypot(*away[:, :2].T).max() < 1e-3
