import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.array import build_wheels
from mdms_model.motor import drive_of
from mdms_model.run.record import Contact
from mdms_model.scenario.file import load_scenario
from mdms_sim.physics.row.solver import solve_row
from mdms_sim.physics.row.trace import journey_of
from mdms_sim.physics.row_laws import rolling_law, sliding_law

WHEELS_M = (np.arange(4) - 1.5) * 0.127
BETA, GAMMA = 4, 5
STRETCH = 1


def paper(figure):
    scenario = load_scenario(f"paper-fig{figure}")
    return scenario, -np.sign(build_wheels(scenario).position_m[:, 0]) * scenario.motion.speed_m_s


@given(speeds=st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4), x_m=st.floats(-0.05, 0.05))
def test_spring_and_offset_sum_the_friction_of_every_wheel(speeds, x_m):
    matrix = np.array([np.ones(4), WHEELS_M])
    normal_n = matrix.T @ np.linalg.solve(matrix @ matrix.T, [20.0, 20.0 * x_m])
    law = sliding_law(WHEELS_M, np.array(speeds), 0.3, 20.0)
    force_n = 0.3 * np.sign(speeds) @ normal_n
    assert law.spring_n_per_m * x_m + law.offset_n == pytest.approx(force_n, abs=1e-12)


def test_inward_wheels_make_a_spring_about_the_origin():
    law = sliding_law(WHEELS_M, -np.sign(WHEELS_M), 0.3, 2.0 * 9.81)
    assert law.spring_n_per_m < 0.0
    assert law.equilibrium_m == pytest.approx(0.0, abs=1e-15)


def test_small_swing_has_the_period_of_the_spring():
    scenario, reference_m_s = paper(8)
    mass_kg = scenario.parcel[0].mass_kg
    law = sliding_law(WHEELS_M, reference_m_s[3:7], scenario.cell.friction, mass_kg * 9.81)
    nudged = load_scenario("paper-fig8", ["parcel.0.x_m=0.03"])
    events = solve_row(nudged, reference_m_s).events
    turns_s = np.array([event.time_s for event in events if event.kind == "reversal"])
    assert 2 * np.diff(turns_s) == pytest.approx(law.period_s(mass_kg), rel=1e-9)


@pytest.mark.parametrize(("figure", "contact"), [(7, "rolling"), (8, "sliding")])
def test_phases_of_the_exact_solution_follow_the_laws(figure, contact):
    scenario, reference_m_s = paper(figure)
    box, friction = scenario.parcel[0], scenario.cell.friction
    journey = journey_of(scenario, box, reference_m_s)
    row, trace = journey.row, journey.trace
    for phase, why in zip(trace.phases, trace.whys, strict=True):
        under = slice(row.first[why[STRETCH]], row.last[why[STRETCH]] + 1)
        wheel_x_m, its_m_s = row.wheel_x_m[under], reference_m_s[under]
        sliding = sliding_law(wheel_x_m, its_m_s, friction, row.weight_n)
        rolling = rolling_law(drive_of(scenario.cell), its_m_s)
        spring = sliding.spring_n_per_m if contact == "sliding" else 0.0
        damping = rolling.damping_ns_per_m if contact == "rolling" else 0.0
        assert phase[BETA] == pytest.approx(spring / box.mass_kg, rel=1e-12)
        assert phase[GAMMA] == pytest.approx(-damping / box.mass_kg, rel=1e-12)


def test_rolling_parcel_rests_where_the_references_under_it_sum_to_zero():
    scenario, reference_m_s = paper(7)
    record = solve_row(scenario, reference_m_s)
    under = record.contact[-1] == Contact.ROLLING
    law = rolling_law(drive_of(scenario.cell), reference_m_s[under])
    assert law.offset_n == pytest.approx(0.0, abs=1e-15)
    assert law.speed_m_s == pytest.approx(0.0, abs=1e-15)


def test_rolling_parcel_tends_to_the_mean_of_the_free_wheels():
    drive = drive_of(load_scenario("paper-fig7").cell)
    law = rolling_law(drive, np.array([0.1, 0.2, 0.3]))
    assert law.speed_m_s == pytest.approx(0.2 * drive.droop)
