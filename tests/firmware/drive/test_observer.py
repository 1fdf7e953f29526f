"""The observer's speed of an ideal quadrature encoder."""

import itertools
import math
import statistics
from array import array

import pytest

from mdms_cell.drive import speed_loop as s
from mdms_cell.drive import tuning

COUNTS_PER_METRE = 37_596  # 26.6 um a count
TICK_S = 0.001


def observe(position_m, ticks, lag_us=tuning.LAG_US, counts_per_metre=COUNTS_PER_METRE):
    """Speeds [m/s] that the observer reports while the wheel follows `position_m(time_s)`."""
    registers = array("i", [0] * s.REGISTERS)
    s.reset(registers)
    tuning.set_encoder(registers, 0, counts_per_metre, lag_us)
    speeds = []
    for tick in range(ticks):
        count = math.floor(position_m(tick * TICK_S) * counts_per_metre)
        registers[s.COUNT] = (count + (1 << 30)) % (1 << 31) - (1 << 30)
        s.step(registers)
        speeds.append(registers[s.ACTUAL] * 1e-6)
    return speeds


@pytest.mark.parametrize("thousandths", range(63_000, 64_001, 100))
def test_speed_at_63_mm_s_has_a_standard_deviation_under_2_percent(thousandths):
    speed = thousandths * 1e-6
    told = observe(lambda time_s: speed * time_s, 3000)[300:]
    assert statistics.pstdev(told) < 0.02 * speed
    assert statistics.mean(told) == pytest.approx(speed, rel=5e-4)


def test_raw_differences_would_have_ten_times_the_noise():
    speed = 0.0635
    counts = [math.floor(speed * TICK_S * tick * COUNTS_PER_METRE) for tick in range(3000)]
    raw = [(b - a) / COUNTS_PER_METRE / TICK_S for a, b in itertools.pairwise(counts)]
    told = observe(lambda time_s: speed * time_s, 3000)[300:]
    assert statistics.pstdev(raw) > 10 * statistics.pstdev(told)


@pytest.mark.parametrize("lag_us", [500, 1_000, tuning.LAG_US, 10_000, 20_000])
def test_speed_trails_a_steady_acceleration_by_the_lag(lag_us):
    acceleration = 1.0
    told = observe(lambda time_s: 0.5 * acceleration * time_s**2, 1500, lag_us)
    lags_s = [tick * TICK_S - speed / acceleration for tick, speed in enumerate(told)][700:]
    assert statistics.mean(lags_s) == pytest.approx(lag_us * 1e-6, rel=0.03, abs=5e-5)


def test_default_lag_is_under_5_ms():
    assert tuning.LAG_US < 5_000


@pytest.mark.parametrize(
    ("counts_per_metre", "speed"),
    [(300, 5.0), (1_000, -5.0), (37_596, 10.0), (1_000_000, -2.0), (3_900_000, 1.0)],
)
def test_any_resolution_tells_metres_per_second(counts_per_metre, speed):
    told = observe(lambda time_s: speed * time_s, 1200, counts_per_metre=counts_per_metre)
    assert statistics.mean(told[200:]) == pytest.approx(speed, rel=5e-4)


def test_glitch_of_the_encoder_is_forgotten():
    registers = array("i", [0] * s.REGISTERS)
    s.reset(registers)
    tuning.set_encoder(registers, 0, COUNTS_PER_METRE)
    registers[s.COUNT] = 12_345
    for _ in range(100):
        s.step(registers)
    assert abs(registers[s.ACTUAL]) < 20


@pytest.mark.parametrize(
    "setting",
    [
        lambda r: tuning.set_encoder(r, 0, 299),
        lambda r: tuning.set_encoder(r, 0, 3_900_001),
        lambda r: tuning.set_encoder(r, 0, 37_596, 499),
        lambda r: tuning.set_law(r, 0, -1, 24_000),
        lambda r: tuning.set_law(r, 0, 10_000, 60_001),
        lambda r: tuning.set_ramps(r, 0, 0, 0, 1_000_000_001),
        lambda r: tuning.set_stall(r, 0, 37_596, 0, 65_536),
    ],
)
def test_setting_out_of_range_is_refused(setting):
    with pytest.raises(ValueError, match=r"must be \d+ to \d+, got -?\d+"):
        setting(array("i", [0] * s.REGISTERS))
