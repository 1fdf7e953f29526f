"""The closed loop: speed loop, PWM, motor and encoder after a step of the reference."""

import importlib.util
import itertools
import statistics
import sys
from pathlib import Path

import pytest

from mdms_cell import speed_loop as s
from mdms_cell import tuning

_spec = importlib.util.spec_from_file_location("motor", Path(__file__).with_name("motor.py"))
assert _spec is not None
assert _spec.loader is not None
motor = importlib.util.module_from_spec(_spec)
sys.modules["motor"] = motor
_spec.loader.exec_module(motor)
Motor = motor.Motor

LIMIT_MS = 30
PAPER = motor.MOTORS["Ke Rm"]
WEAKEST = motor.MOTORS["Ke-30 Rm+30"]
QUICK = {name: own for name, own in motor.MOTORS.items() if own is not WEAKEST}
each_motor = pytest.mark.parametrize("own", motor.MOTORS.values(), ids=motor.MOTORS)


def check_step(own, supply_v, reference_m_s, limit_ms, gain=10):
    for speeds in motor.steps(own, supply_v, reference_m_s, gain):
        assert statistics.mean(speeds[100:]) == pytest.approx(1.0, rel=0.01)
        assert max(speeds) < 1.1
        assert motor.settled_ms(speeds) <= limit_ms


@pytest.mark.parametrize("supply_v", motor.SUPPLIES_V)
@pytest.mark.parametrize("reference_m_s", motor.REFERENCES_M_S)
@pytest.mark.parametrize("own", QUICK.values(), ids=QUICK)
def test_step_settles_in_30_ms_and_overshoots_by_at_most_a_tenth(own, reference_m_s, supply_v):
    check_step(own, supply_v, reference_m_s, LIMIT_MS)


@pytest.mark.parametrize("supply_v", motor.SUPPLIES_V)
@pytest.mark.parametrize("reference_m_s", motor.REFERENCES_M_S)
def test_weakest_motor_settles_before_it_would_under_an_undelayed_law(reference_m_s, supply_v):
    undelayed_ms = 1000 * WEAKEST.settling_s(10.0, motor.BAND)
    assert undelayed_ms > 1.5 * LIMIT_MS
    check_step(WEAKEST, supply_v, reference_m_s, undelayed_ms)


@pytest.mark.parametrize("supply_v", motor.SUPPLIES_V)
@pytest.mark.parametrize("reference_m_s", motor.REFERENCES_M_S[:3])
def test_weakest_motor_takes_a_gain_of_15_to_settle_in_30_ms(reference_m_s, supply_v):
    check_step(WEAKEST, supply_v, reference_m_s, LIMIT_MS, gain=15)


@each_motor
def test_ramped_step_does_not_overshoot(own):
    made = motor.registers()
    tuning.set_ramps(made, 0, 2_000_000, 2_000_000, 0)
    made[s.TARGET] = 200_000
    speeds = motor.run(made, own, 24, 400)
    assert max(speeds) < 1.05 * own.free_speed(0.2, 10.0)


def test_all_of_the_range_is_stable_at_the_nominal_gain():
    for target in (-10_000_000, -1_000, 1_000, 10_000_000):
        made = motor.registers()
        made[s.TARGET] = target
        speeds = motor.run(made, PAPER, 24, 600)
        assert max(speeds[400:]) - min(speeds[400:]) < 0.005


def test_wheel_that_is_held_back_recovers_without_windup():
    made = motor.registers()
    made[s.TARGET] = 100_000
    stuck = Motor(mass_kg=1e6)
    motor.run(made, stuck, 24, 1000)
    made[s.COUNT] = 0
    speeds = motor.run(made, PAPER, 24, 100)
    assert max(speeds) < 1.1 * PAPER.free_speed(0.1, 10.0)


def test_gains_far_apart_settle_where_the_paper_says():
    for gain, supply_v in itertools.product((2, 5, 10), (12, 24)):
        made = motor.registers(gain * 1000, supply_v * 1000)
        made[s.TARGET] = 200_000
        speeds = motor.run(made, PAPER, supply_v, 600)
        free = PAPER.free_speed(0.2, gain)
        pwm_step = supply_v / motor.PWM_STEPS / (gain + 1)
        assert statistics.mean(speeds[400:]) == pytest.approx(free, abs=pwm_step)
