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

BAND = 0.05
PAPER = Motor()
MOTORS = [PAPER] + [
    Motor(force_per_ampere=PAPER.force_per_ampere * constant, resistance_ohm=4.0 * resistance)
    for constant, resistance in ((0.7, 1), (1.3, 1), (1, 0.7), (1, 1.3))
]


@pytest.mark.parametrize("supply_v", [12, 24])
@pytest.mark.parametrize("reference_m_s", [0.0635, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("own", MOTORS, ids=["nominal", "Ke-30", "Ke+30", "Rm-30", "Rm+30"])
def test_step_settles_in_30_ms_and_overshoots_by_at_most_a_tenth(own, reference_m_s, supply_v):
    made = motor.registers(supply_mv=supply_v * 1000)
    made[s.TARGET] = round(reference_m_s * 1e6)
    speeds = motor.run(made, own, supply_v, 200)
    final = own.free_speed(reference_m_s, 10.0)
    assert statistics.mean(speeds[100:]) == pytest.approx(final, rel=0.01)
    assert max(speeds) < 1.1 * final
    assert all(abs(speed / final - 1) < BAND for speed in speeds[29:])


@pytest.mark.parametrize("own", MOTORS)
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
