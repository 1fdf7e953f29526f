from math import exp

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.scenario.scenario import Array, Cell, Run, Scenario
from mdms_sim.physics.motor import applied_voltage, coast, true_cells

STEP_S = 1e-3


def scenario(cell, seed=1):
    return Scenario("motors", Array(6, 3), cell, run=Run(seed=seed))


@given(st.floats(0.001, 10.0), st.floats(0.0, 100.0), st.floats(-1.0, 1.0), st.floats(-50.0, 50.0))
def test_coasting_solves_the_wheel_under_constant_force(mass_kg, loss, speed_m_s, force_n):
    decay, gain, glide, stride = coast(mass_kg, loss, STEP_S)
    steps = 200
    tiny = STEP_S / steps
    speed, travel = speed_m_s, 0.0
    for _ in range(steps):  # midpoint rule, error below 1e-6 of a step this short
        middle = speed + 0.5 * tiny * (force_n - loss * speed) / mass_kg
        travel += tiny * middle
        speed += tiny * (force_n - loss * middle) / mass_kg
    assert decay * speed_m_s + gain * force_n == pytest.approx(speed, rel=1e-4, abs=1e-9)
    assert glide * speed_m_s + stride * force_n == pytest.approx(travel, rel=1e-4, abs=1e-12)


def test_coasting_is_smooth_where_the_formula_changes():
    for below, above in zip(coast(1.0, 0.0999999, 1e-3), coast(1.0, 0.1000001, 1e-3), strict=True):
        assert below == pytest.approx(above, rel=1e-9)
    assert coast(1.0, 2.0, 1.0)[0] == pytest.approx(exp(-2.0))


def test_a_wheel_without_mass_follows_at_once():
    assert coast(0.0, 2.0, STEP_S) == (0.0, 0.5, 0.0, STEP_S / 2)


@given(st.floats(-100.0, 100.0))
def test_the_bridge_gives_whole_steps_within_the_supply(voltage_v):
    applied = applied_voltage(voltage_v, 24.0, 100)
    assert abs(applied) <= 24.0
    assert applied / 0.24 == pytest.approx(round(applied / 0.24), abs=1e-9)
    assert applied == pytest.approx(np.clip(voltage_v, -24.0, 24.0), abs=0.12 + 1e-9)


def test_cells_are_alike_without_spread():
    cell = Cell()
    assert true_cells(scenario(cell)) == [cell] * 18


def test_spread_keeps_its_bounds_and_follows_the_seed():
    cell = Cell(motor_spread=0.1, friction_spread=0.3)
    cells = true_cells(scenario(cell, seed=7))
    for name, spread in (("resistance_ohm", 0.1), ("friction", 0.3)):
        share = np.array([getattr(one, name) for one in cells]) / getattr(cell, name) - 1.0
        assert np.abs(share).max() <= spread
        assert np.ptp(share) > spread / 2
    assert cells == true_cells(scenario(cell, seed=7))
    assert cells != true_cells(scenario(cell, seed=8))
