"""Two parcels steered at once, with firmware, bus and physics in between."""

import numpy as np

from mdms_array.host import coordinator_of, estimates_of
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import simulate

SCENARIO = """
title = "Two parcels change their poses at once"
array = { columns = 6, rows = 3 }
motion = { field = "goal", speed_m_s = 0.1 }
run = { fidelity = "firmware", duration_s = 6.0 }

[cell]
rotor_inertia_kg_m2 = 5e-6
wheel = [
  { offset_m = [-0.03, 0.0] },
  { direction_rad = 1.5707963267948966, offset_m = [0.03, 0.0] },
]

[[parcel]]
name = "left"
mass_kg = 1.5
length_m = 0.25
width_m = 0.22
x_m = -0.22
y_m = 0.02
yaw_rad = 0.1
goal = { x_m = -0.15, y_m = 0.0, yaw_rad = 0.5 }

[[parcel]]
name = "right"
mass_kg = 1.5
length_m = 0.24
width_m = 0.24
x_m = 0.12
y_m = -0.02
yaw_rad = -0.2
goal = { x_m = 0.2, y_m = 0.02, yaw_rad = -0.6 }
"""


def test_two_parcels_reach_their_goals_independently(tmp_path) -> None:
    path = tmp_path / "two.toml"
    path.write_text(SCENARIO)
    scenario = load_scenario(str(path), [])
    coordinator = coordinator_of(scenario)
    record = simulate(
        scenario, [coordinator], estimates=lambda: estimates_of(coordinator, scenario)
    ).record
    assert coordinator.fault is None
    assert coordinator.finished
    for number, parcel in enumerate(scenario.parcel):
        error = record.pose[-1, number] - (parcel.goal.x_m, parcel.goal.y_m, parcel.goal.yaw_rad)
        assert np.hypot(*error[:2]) < 0.005
        assert abs(error[2]) < np.radians(1.5)
        away = record.estimate[-1, number] - record.pose[-1, number]
        assert np.hypot(*away[:2]) < 0.008
