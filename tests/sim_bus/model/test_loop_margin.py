"""The largest gain, against the eigenvalues of the closed loop and against the firmware itself."""

import math
from array import array
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdms_cell.drive import speed_loop, tuning
from mdms_model import loop_margin
from mdms_model.loop_margin import (
    DEFAULT,
    NEW_TICKS,
    SHARES,
    TICK_S,
    GainError,
    Observer,
    check_gain,
    largest_gain,
    motor_of,
    phase_margin,
)
from mdms_model.scenario.scenario import Cell

PAPER = motor_of(Cell(rotor_inertia_kg_m2=5e-6))


def spectral_radius(motor, gain, observer, share):
    """Of the closed loop in (speed, innovation, expected speed, mean voltage) a tick.

    Built from the difference equations, with no transform.
    """
    alpha, beta = (share * each for each in observer.gains)
    fed = observer.acceleration_m_s2_per_v * TICK_S**2
    braking, force = motor.braking_n_s_per_m, motor.force_n_per_a / motor.resistance_ohm
    decay = math.exp(-braking * TICK_S / motor.mass_kg)
    lasting = (1 - decay) * motor.mass_kg / braking

    def tick(state):
        speed, innovation, expected, mean = state
        expected = expected + beta * innovation
        voltage = -gain * expected / TICK_S
        expected = expected + fed * (voltage - mean)
        mean = mean + (voltage - mean) / NEW_TICKS
        settled = voltage * force / braking
        moved = settled * TICK_S + (speed - settled) * lasting
        innovation = innovation - alpha * innovation + moved - expected
        return settled + (speed - settled) * decay, innovation, expected, mean

    matrix = np.array([tick(column) for column in np.eye(4)]).T
    return max(abs(np.linalg.eigvals(matrix)))


@pytest.mark.parametrize("acceleration", [0.0, 5.0, 17.0])
@pytest.mark.parametrize("lag_s", [0.001, 0.0019, 0.005, 0.01])
@pytest.mark.parametrize("mass_factor", [0.3, 1.0, 5.0])
def test_no_margin_left_is_the_border_of_stability(monkeypatch, acceleration, lag_s, mass_factor):
    monkeypatch.setattr(loop_margin, "DELAY_S", 0.0)
    observer = Observer(lag_s, acceleration)
    motor = replace(PAPER, mass_kg=PAPER.mass_kg * mass_factor)
    loaded = [replace(motor, mass_kg=load * motor.mass_kg) for load in loop_margin.LOADS]
    gain = largest_gain(motor, observer, margin_rad=0.0)

    def radius(factor):
        return max(
            spectral_radius(each, factor * gain, observer, share)
            for share in SHARES
            for each in (*loaded, replace(motor, mass_kg=1e6))
        )

    assert radius(1.0) == pytest.approx(1.0, abs=2e-3)
    assert radius(0.95) < 1.0
    assert radius(1.05) > 1.0


FED = st.just(0.0) | st.floats(0.001, 65.0)
OBSERVERS = st.builds(Observer, st.floats(0.0005, 0.02), FED)


@settings(max_examples=25)
@given(st.floats(0.05, 20.0), OBSERVERS, st.floats(SHARES[1], SHARES[0]))
def test_any_share_between_the_two_leaves_no_smaller_gain(mass_factor, observer, share):
    motor = replace(PAPER, mass_kg=PAPER.mass_kg * mass_factor)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop_margin, "SHARES", (share,))
        between = largest_gain(motor, observer)
    assert between >= 0.999 * largest_gain(motor, observer)


@settings(max_examples=25)
@given(st.floats(1.0, 1000.0), OBSERVERS)
def test_any_load_leaves_no_smaller_gain(mass_factor, observer):
    loaded = replace(PAPER, mass_kg=PAPER.mass_kg * mass_factor)
    assert largest_gain(loaded, observer) >= 0.98 * largest_gain(PAPER, observer)


def test_largest_gain_has_just_the_margin():
    gain = largest_gain(PAPER)
    assert phase_margin(PAPER, gain) == pytest.approx(math.radians(45), abs=0.01)
    assert phase_margin(PAPER, 0.8 * gain) > math.radians(45)


def test_slow_loop_has_the_margin_of_a_first_order_lag():
    heavy = replace(PAPER, mass_kg=100.0)
    gain = 10.0
    crossover = gain * PAPER.force_n_per_a / PAPER.resistance_ohm / heavy.mass_kg
    braking = heavy.braking_n_s_per_m / heavy.mass_kg
    expected = math.pi - math.atan(math.sqrt(crossover**2 - braking**2) / braking)
    by_encoder = replace(DEFAULT, acceleration_m_s2_per_v=0.0)
    assert phase_margin(heavy, gain, by_encoder) == pytest.approx(expected, abs=0.01)


@settings(max_examples=25)
@given(st.floats(0.05, 20.0), st.floats(0.2, 5.0), OBSERVERS)
def test_any_motor_keeps_the_margin_up_to_its_largest_gain(
    mass_factor, resistance_factor, observer
):
    motor = replace(
        PAPER,
        mass_kg=PAPER.mass_kg * mass_factor,
        resistance_ohm=PAPER.resistance_ohm * resistance_factor,
    )
    gain = largest_gain(motor, observer)
    assert phase_margin(motor, 0.99 * gain, observer) >= math.radians(45)
    assert phase_margin(motor, 1.01 * gain, observer) <= math.radians(46)


def test_prototype_gain_is_allowed_and_a_large_one_refused_with_the_limit():
    check_gain(PAPER, 10.0)
    largest = largest_gain(PAPER)
    with pytest.raises(GainError, match=f"largest that leaves 45 is {largest:.4g} V s/m"):
        check_gain(PAPER, 3 * largest)


def test_wheel_behind_a_gear_weighs_as_the_same_rotor():
    behind = motor_of(Cell(rotor_inertia_kg_m2=2e-6, wheel_inertia_kg_m2=2.7e-5))
    assert behind.mass_kg == pytest.approx(PAPER.mass_kg)


def test_massless_wheel_is_limited_by_the_observer_alone():
    massless = replace(PAPER, mass_kg=0.0)
    assert 0.0 < largest_gain(massless) < largest_gain(PAPER)


def test_known_voltage_leaves_room_for_three_times_the_gain():
    by_encoder = replace(DEFAULT, acceleration_m_s2_per_v=0.0)
    assert largest_gain(PAPER) > 3 * largest_gain(PAPER, by_encoder)


@pytest.mark.parametrize("lag_us", [1_000, 1_900, 20_000])
def test_observer_is_that_of_the_firmware(lag_us):
    registers = [0] * speed_loop.REGISTERS
    tuning.set_encoder(registers, 0, 37_596, lag_us)
    alpha, beta = replace(DEFAULT, lag_s=lag_us * 1e-6).gains
    assert registers[speed_loop.ALPHA] / 4096 == pytest.approx(alpha, abs=2e-4)
    assert registers[speed_loop.BETA] / 4096 == pytest.approx(beta, abs=2e-4)
    assert pytest.approx(DEFAULT.lag_s) == tuning.LAG_US * 1e-6


def test_new_voltage_is_fed_as_the_firmware_does():
    registers = array("i", [0] * speed_loop.REGISTERS)
    speed_loop.reset(registers)
    registers[speed_loop.AGE_LIMIT] = 1 << 29
    tuning.set_encoder(registers, 0, 37_596)
    tuning.set_feed(registers, 0, 37_596)
    tuning.set_law(registers, 0, 10_000, 24_000)
    registers[speed_loop.ALPHA] = registers[speed_loop.BETA] = 0
    registers[speed_loop.MODE] = speed_loop.RUN
    registers[speed_loop.TARGET] = 1_000_000
    speed_m_s = mean_v = 0.0
    for _ in range(100):
        speed_loop.step(registers)
        assert registers[speed_loop.ACTUAL] * 1e-6 == pytest.approx(speed_m_s, rel=2e-3, abs=1e-4)
        new_v = registers[speed_loop.VOLTAGE] * 1e-6 - mean_v
        mean_v += new_v / NEW_TICKS
        speed_m_s += DEFAULT.acceleration_m_s2_per_v * TICK_S * new_v


@pytest.mark.parametrize(("innovation", "share"), [(0.4, SHARES[1]), (-0.4, SHARES[1])])
def test_share_within_half_a_count_is_that_of_the_firmware(innovation, share):
    assert first_rate(innovation) == pytest.approx(share * innovation, abs=1e-3)


@pytest.mark.parametrize("innovation", [30.5, -30.5])
def test_all_beyond_half_a_count_counts(innovation):
    within = math.copysign((1 - SHARES[1]) / 2, innovation)
    assert first_rate(innovation) == pytest.approx(innovation - within, abs=1e-3)


def first_rate(innovation):
    """The rate that the firmware's observer takes from an innovation [counts], over its beta."""
    registers = array("i", [0] * speed_loop.REGISTERS)
    tuning.set_encoder(registers, 0, 37_596)
    registers[speed_loop.BETA] = 4096
    count = math.ceil(innovation)
    registers[speed_loop.COUNT] = count
    registers[speed_loop.POSITION] = round((count - innovation) * 2**14)
    speed_loop.step(registers)
    return registers[speed_loop.RATE] / 2**14
