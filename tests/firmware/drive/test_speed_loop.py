"""One source, four ways to run it, the same registers; and never a number of more than 31 bits."""

import re
import sys
from array import array
from pathlib import Path

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdms_cell.drive import speed_loop as s
from mdms_cell.drive import tuning

BENCH = Path(__file__).parents[2] / "both" / "bench"
sys.path.insert(0, str(BENCH))
from speed_loop_stream import Chance, configure, digest, disturb  # noqa: E402

sys.path.remove(str(BENCH))

SEEDS = range(24)
TICKS = 400  # as in the stream below
STREAM = """
from array import array
import speed_loop_stream
from mdms_cell.drive import speed_loop as s
for seed in range(%d, %d):
    print(speed_loop_stream.digest(s.step, array("i", [0] * s.REGISTERS), seed, 400))
"""
LOW, HIGH = -(1 << 30), (1 << 30) - 1


class Small(int):
    """An integer that refuses to leave 31 bits, as a small integer of 32-bit MicroPython would."""

    def __new__(cls, value):
        assert LOW <= value <= HIGH, f"{int(value)} is no small integer"
        return super().__new__(cls, value)


def _checked(name):
    operation = getattr(int, name)

    def checked(self, other):
        result = operation(self, other)
        return result if result is NotImplemented else Small(result)

    return checked


for _name in ("add", "sub", "mul", "and", "or", "xor", "lshift", "rshift"):
    setattr(Small, f"__{_name}__", _checked(f"__{_name}__"))
    setattr(Small, f"__r{_name}__", _checked(f"__r{_name}__"))


class SmallRegisters(list):
    """Registers that hold small integers only."""

    def __setitem__(self, index, value):
        super().__setitem__(index, Small(value))


def small_registers():
    return SmallRegisters([Small(0)] * s.REGISTERS)


def plain_digests():
    return [digest(s.step, array("i", [0] * s.REGISTERS), seed, TICKS) for seed in SEEDS]


@pytest.fixture(scope="module")
def expected():
    return plain_digests()


def test_streams_tell_seeds_apart(expected):
    assert len(set(expected)) == len(expected)


def test_numba_computes_the_same(expected):
    step = numba.njit(s.step)
    got = [digest(step, np.zeros(s.REGISTERS, np.int32), seed, TICKS) for seed in SEEDS]
    assert got == expected


@pytest.mark.parametrize("viper", [True, False], ids=["viper", "bytecode"])
@pytest.mark.parametrize("emit", ["bytecode", "native"])
def test_64_bit_micropython_computes_the_same(micropython, expected, viper, emit):
    code = STREAM % (0, len(SEEDS))
    printed = micropython(code, BENCH / "speed_loop_stream.py", emit=emit, viper=viper)
    assert [int(line) for line in printed.split()] == expected


def test_32_bit_micropython_computes_the_same(micropython32, expected):
    printed = ""
    for first in range(0, len(SEEDS), 4):
        code = STREAM % (first, first + 4)
        printed += micropython32(code, BENCH / "speed_loop_stream.py")
    assert [int(line) for line in printed.split()] == expected


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 65535))
def test_no_intermediate_value_leaves_31_bits_on_random_streams(seed):
    chance = Chance(seed)
    registers = small_registers()
    configure(registers, chance)
    registers[s.WIDEN] = 0
    for _ in range(60):
        disturb(registers, chance)
        s.step(registers)


#: The most that new voltage may add to RATE in a tick.
FEED_LIMIT = (2 * s.VOLTAGE_MAX_UV + 2048 >> 12) * s.FEED_MAX >> 4
SMALL = st.integers(LOW, HIGH) | st.sampled_from((LOW, LOW + 1, -1, 0, 1, HIGH - 1, HIGH))


def ranged(low, high):
    return st.integers(low, high) | st.sampled_from((low, high))


@st.composite
def axes(draw):
    """Registers of one axis, anywhere in their documented ranges, state included."""
    registers = small_registers()
    counts = draw(ranged(tuning.COUNTS_PER_METRE_MIN, tuning.COUNTS_PER_METRE_MAX))
    lag_us = draw(ranged(tuning.LAG_MIN_US, tuning.LAG_MAX_US))
    tuning.set_encoder(registers, 0, counts, lag_us)
    feed = draw(ranged(0, tuning.ACCELERATION_PER_VOLT_MAX_MM_S2))
    tuning.set_feed(registers, 0, counts, feed)
    gain = draw(ranged(0, tuning.GAIN_MAX_MV_S_M))
    tuning.set_law(registers, 0, gain, draw(ranged(0, 60_000)))
    ramp = ranged(0, 1_000_000_000)
    tuning.set_ramps(registers, 0, draw(ramp), draw(ramp), draw(ramp))
    time_ms = ranged(0, tuning.TIME_MAX_MS)
    tuning.set_over_current(registers, 0, draw(ranged(0, tuning.CURRENT_MAX_MA)), draw(time_ms))
    tuning.set_stall(registers, 0, counts, draw(ranged(0, 60_000)), draw(time_ms))
    tuning.set_following(registers, 0, draw(ranged(0, 20_000_000)), draw(time_ms))
    limit = int(registers[s.RATE_LIMIT]) + FEED_LIMIT
    volts = s.VOLTAGE_MAX_UV
    speed = s.SPEED_MAX_UM_S
    for index, values in (
        (s.INVERTED, ranged(0, 1)),
        (s.MODE, ranged(0, 2)),
        (s.COUNT, SMALL),
        (s.CURRENT, SMALL.filter(lambda value: value > LOW)),
        (s.TARGET, ranged(-speed, speed)),
        (s.AGE, ranged(0, HIGH)),
        (s.AGE_LIMIT, ranged(0, 60_000)),
        (s.POSITION, ranged(-(1 << 29), (1 << 29) - 1)),
        (s.RATE, ranged(-limit, limit)),
        (s.MEAN_VOLTAGE, ranged(-volts, volts)),
        (s.DEMAND, ranged(-speed, speed)),
        (s.FAULTS, ranged(0, 15)),
        (s.CURRENT_COUNT, ranged(0, tuning.TIME_MAX_MS)),
        (s.STALL_FROM, ranged(-(1 << 16), 1 << 16)),
        (s.STALL_COUNT, ranged(0, tuning.TIME_MAX_MS)),
        (s.FOLLOWING_COUNT, ranged(0, tuning.TIME_MAX_MS)),
        (s.TICKS, ranged(0, HIGH)),
    ):
        registers[index] = draw(values)
    return registers


@settings(max_examples=300, deadline=None)
@given(axes())
def test_from_any_state_no_value_leaves_31_bits_and_voltage_is_zero_when_off_or_faulty(registers):
    limit_uv = -(-registers[s.ERROR_LIMIT] * registers[s.GAIN] // 16)
    assert limit_uv <= s.VOLTAGE_MAX_UV
    rate_limit = registers[s.RATE_LIMIT] + FEED_LIMIT
    for _ in range(3):
        s.step(registers)
        off = registers[s.MODE] == s.OFF or registers[s.FAULTS]
        assert abs(registers[s.VOLTAGE]) <= (0 if off else limit_uv)
        assert abs(registers[s.RATE]) <= rate_limit
        assert abs(registers[s.MEAN_VOLTAGE]) <= s.VOLTAGE_MAX_UV
        assert abs(registers[s.DEMAND]) <= s.SPEED_MAX_UM_S
        assert -(1 << 29) <= registers[s.POSITION] < 1 << 29


@given(st.integers(0, tuning.GAIN_MAX_MV_S_M), st.integers(0, 60_000))
def test_voltage_reaches_its_limit_within_the_gains_step_and_never_exceeds_it(gain, limit_mv):
    registers = small_registers()
    registers[s.AGE_LIMIT] = 1
    tuning.set_encoder(registers, 0, 37_596)
    tuning.set_law(registers, 0, gain, limit_mv)
    registers[s.MODE] = s.RUN
    step_uv = int(registers[s.GAIN]) / 16
    largest_uv = min(limit_mv * 1000, s.SPEED_MAX_UM_S * step_uv)
    for target in (-s.SPEED_MAX_UM_S, s.SPEED_MAX_UM_S):
        registers[s.TARGET] = target
        registers[s.AGE] = 0
        s.step(registers)
        assert largest_uv - step_uv - 1 <= abs(registers[s.VOLTAGE]) <= largest_uv


def test_slices_by_axis_hold_two_registers():
    for first in (s.COUNT, s.CURRENT, s.ACTUAL, s.VOLTAGE, s.FAULTS):
        assert len(range(s.REGISTERS)[first :: s.AXIS]) == s.AXES


def test_each_register_has_a_place_of_its_own() -> None:
    source = Path(s.__file__).read_text(encoding="utf-8")
    registers = source.split("# Values of MODE", maxsplit=1)[0]
    places = [
        int(place)
        for name, place in re.findall(r"^(\w+) = const\((\d+)\)", registers, re.MULTILINE)
        if name not in {"AXIS", "AXES", "REGISTERS"}
    ]
    assert places == [*range(s.AXIS), *range(s.AXES * s.AXIS, s.REGISTERS)]
