"""A parcel that is parked, and another that comes near it: with firmware, bus and physics."""

import numpy as np
import pytest

import mdms_array as mdms

BOX = {"mass_kg": 2.0, "length_m": 0.28, "width_m": 0.22}
CELL = {
    "rotor_inertia_kg_m2": 2e-6,
    "wheel_inertia_kg_m2": 2e-5,
    "current_limit_a": 3.0,
    "motor_spread": 0.05,
    "friction_spread": 0.1,
    "sensor_delay_s": 0.001,
    "wheel": [
        {"offset_m": [-0.03, 0.0]},
        {"direction_rad": 1.5707963267948966, "offset_m": [0.03, 0.0]},
    ],
}


@pytest.mark.parametrize(("gap_m", "seed"), [(0.005, 1), (0.010, 2), (0.015, 3)])
def test_a_parked_parcel_stays_where_a_neighbour_passes_close_by(gap_m, seed) -> None:
    y_m = -0.13 + 0.22 + gap_m
    goal = {"x_m": 0.16, "y_m": y_m, "yaw_rad": 0.0}
    scenario = {
        "title": "Two parcels",
        "array": {"columns": 5, "rows": 4},
        "motion": {"field": "goal", "speed_m_s": 0.1},
        "run": {"fidelity": "firmware", "duration_s": 7.0, "seed": seed},
        "cell": CELL,
        "parcel": [
            BOX | {"name": "first", "x_m": 0.01, "y_m": -0.13},
            BOX | {"name": "second", "x_m": -0.16, "y_m": y_m, "goal": goal},
        ],
    }
    run = mdms.simulate(scenario)
    first, second = run.record.pose[:, 0], run.record.pose[:, 1]
    assert np.hypot(*(first - first[0])[:, :2].T).max() < 0.0005
    # The neighbour may brush against it while it is turned to where it was found to be.
    assert np.degrees(np.abs(first[:, 2]).max()) < 0.2
    assert run.status == "reached"
    assert np.hypot(*(second[-1, :2] - (0.16, y_m))) < 0.01
