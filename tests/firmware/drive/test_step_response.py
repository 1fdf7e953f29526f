"""The closed loop: speed loop, PWM, motor and encoder after a step of the reference."""

import importlib.util
import itertools
import statistics
import sys
from pathlib import Path

import pytest

from mdms_cell.drive import speed_loop as s
from mdms_cell.drive import tuning

_spec = importlib.util.spec_from_file_location("motor", Path(__file__).with_name("motor.py"))
assert _spec is not None
assert _spec.loader is not None
motor = importlib.util.module_from_spec(_spec)
sys.modules["motor"] = motor
_spec.loader.exec_module(motor)

PAPER = motor.MOTORS["Ke Rm"]
each_motor = pytest.mark.parametrize("own", motor.MOTORS.values(), ids=motor.MOTORS)


@pytest.mark.parametrize("supply_v", motor.SUPPLIES_V)
@pytest.mark.parametrize("reference_m_s", motor.REFERENCES_M_S)
@each_motor
def test_step_settles_in_less_than_30_ms_and_overshoots_by_less_than_a_tenth(
    own, reference_m_s, supply_v
):
    for speeds in motor.steps(own, supply_v, reference_m_s):
        assert statistics.mean(speeds[100:]) == pytest.approx(1.0, rel=0.01)
        assert max(speeds) < 1.1
        assert motor.settled_ms(speeds) < 30


@each_motor
def test_ramped_step_does_not_overshoot(own):
    made = motor.registers(10_000)
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


def test_wheel_that_was_held_recovers_the_same_however_long_it_was_held():
    assert motor.released(PAPER, 500) == motor.released(PAPER, 2_000)


def test_wheel_that_is_let_go_is_settled_after_50_ms():
    speeds = motor.released(PAPER, 1_000)
    assert max(speeds) < 1.2
    assert motor.settled_ms(speeds) < 50


def test_gains_far_apart_settle_where_the_paper_says():
    for gain, supply_v in itertools.product((2, 5, 10), (12, 24)):
        made = motor.registers(gain * 1000, supply_v * 1000)
        made[s.TARGET] = 200_000
        speeds = motor.run(made, PAPER, supply_v, 600)
        free = PAPER.free_speed(0.2, gain)
        pwm_step = supply_v / motor.PWM_STEPS / (gain + 1)
        assert statistics.mean(speeds[400:]) == pytest.approx(free, abs=pwm_step)
