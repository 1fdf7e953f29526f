"""The control tick on whatever interpreter runs this."""

from array import array

try:
    from micropython import heap_lock, heap_unlock
except ImportError:

    def heap_lock():
        """CPython has no lock: there the 31-bit test stands for it."""

    def heap_unlock():
        """See `heap_lock`."""


from mdms_cell.drive import speed_loop as s
from mdms_cell.drive import tuning

COUNTS_PER_METRE = 37_596
EXTREMES = (-(1 << 30), -(1 << 29), -1, 0, 1, (1 << 29) - 1, (1 << 30) - 1)


def registers():
    made = array("i", [0] * s.REGISTERS)
    s.reset(made)
    made[s.AGE_LIMIT] = 50
    made[s.SUPPLY] = 24_000_000
    made[s.SUPPLY_MIN] = 10_000_000
    made[s.BRAKE_TICKS] = 1000
    for base in (0, s.AXIS):
        tuning.set_encoder(made, base, COUNTS_PER_METRE)
        tuning.set_law(made, base, 10_000, 24_000)
    return made


def run(made):
    made[s.TARGET] = 100_000
    made[s.AXIS + s.TARGET] = -100_000
    for base in (0, s.AXIS):
        made[base + s.MODE] = s.RUN
        made[base + s.AGE] = 0
    return made


def turn(made, ticks, counts_per_1000_ticks=0):
    for tick in range(ticks):
        made[s.COUNT] = tick * counts_per_1000_ticks // 1000
        made[s.AXIS + s.COUNT] = -made[s.COUNT]
        made[s.AGE] = made[s.AXIS + s.AGE] = 0
        s.step(made)


def test_voltage_is_gain_times_speed_error():
    made = run(registers())
    s.step(made)
    assert made[s.VOLTAGE] == 1_000_000
    assert made[s.AXIS + s.VOLTAGE] == -1_000_000


def test_steady_speed_is_measured_within_half_a_per_mille():
    made = run(registers())
    turn(made, 1500, 2387)
    expected = 2387 * 1_000_000 // COUNTS_PER_METRE * 1000 // 1000
    assert abs(made[s.ACTUAL] - expected) < 1_500
    assert abs(made[s.AXIS + s.ACTUAL] + expected) < 1_500


def test_count_may_wrap_at_16_bits_and_at_31():
    made = registers()
    for tick in range(100_000):
        made[s.COUNT] = ((tick * 7 + (1 << 30)) & 0x7FFFFFFF) - (1 << 30)
        made[s.AXIS + s.COUNT] = (tick * 7) & 0xFFFF
        s.step(made)
        if tick > 100:
            assert abs(made[s.ACTUAL] - 7_000_000_000 // COUNTS_PER_METRE) < 50
            assert made[s.AXIS + s.ACTUAL] == made[s.ACTUAL]
        if tick == 300:
            break


def test_inverted_axis_does_the_same_the_other_way_round():
    made = run(registers())
    made[s.AXIS + s.TARGET] = 100_000
    made[s.AXIS + s.INVERTED] = 1
    turn(made, 200, 1500)
    assert made[s.AXIS + s.ACTUAL] == made[s.ACTUAL]
    assert made[s.AXIS + s.VOLTAGE] == -made[s.VOLTAGE]


def test_ramps_limit_how_fast_the_reference_changes():
    made = run(registers())
    tuning.set_ramps(made, 0, 2_000_000, 5_000_000, 20_000_000)
    turn(made, 10)
    assert made[s.DEMAND] == 20_000
    turn(made, 60)
    assert made[s.DEMAND] == 100_000
    made[s.TARGET] = 0
    turn(made, 10)
    assert made[s.DEMAND] == 50_000
    made[s.TARGET] = 100_000
    made[s.MODE] = s.STOP
    turn(made, 2)
    assert made[s.DEMAND] == 10_000
    turn(made, 1)
    assert made[s.DEMAND] == 0


def test_feed_is_rounded_to_the_nearest():
    made = registers()
    for counts_per_metre, acceleration in ((37_596, 3_000), (37_596, 3_001), (10_000, 1_234)):
        tuning.set_feed(made, 0, counts_per_metre, acceleration)
        exact = acceleration * counts_per_metre * 2.0**30 / 1e15
        assert abs(made[s.FEED] - exact) <= 0.5


def test_reference_that_turns_round_is_sped_up_by_its_own_ramp():
    for target in (100_000, -100_000):
        sign = 1 if target > 0 else -1
        slowed = (-70_000, -40_000, -10_000, 0)
        # Towards 0 it jumps, or is slowed down faster than it is sped up.
        for deceleration, ways in ((0, (2_000, 4_000)), (30_000_000, slowed)):
            made = run(registers())
            tuning.set_ramps(made, 0, 2_000_000, deceleration, 0)
            made[s.TARGET] = -target
            turn(made, 60)
            assert made[s.DEMAND] == -target
            made[s.TARGET] = target
            for way in ways:
                turn(made, 1)
                assert made[s.DEMAND] == sign * way
            turn(made, 1)
            assert made[s.DEMAND] == sign * (ways[-1] + 2_000)


def test_reference_without_ramps_turns_round_at_once():
    made = run(registers())
    turn(made, 1)
    for target in (-100_000, 100_000):
        made[s.TARGET] = target
        turn(made, 1)
        assert made[s.DEMAND] == target


def test_over_current_is_a_fault_when_it_lasts():
    made = run(registers())
    tuning.set_over_current(made, 0, 3_000, 10)
    made[s.CURRENT] = -3_001
    turn(made, 9)
    assert made[s.FAULTS] == 0
    made[s.CURRENT] = 0
    turn(made, 1)
    made[s.CURRENT] = 3_001
    turn(made, 9)
    assert made[s.FAULTS] == 0
    turn(made, 1)
    assert made[s.FAULTS] == s.OVER_CURRENT
    assert made[s.VOLTAGE] == 0
    assert made[s.AXIS + s.FAULTS] == 0


def test_wheel_that_stands_under_voltage_is_stalled():
    made = run(registers())
    tuning.set_stall(made, 0, COUNTS_PER_METRE, 1_000, 30)
    turn(made, 29)
    assert made[s.FAULTS] == 0
    turn(made, 1)
    assert made[s.FAULTS] == s.STALLED
    assert made[s.VOLTAGE] == 0


def test_stall_is_seen_by_the_encoder_whatever_the_observer_expects():
    made = run(registers())
    tuning.set_feed(made, 0, COUNTS_PER_METRE)
    tuning.set_stall(made, 0, COUNTS_PER_METRE, 500, 30)
    turn(made, 29)
    assert made[s.ACTUAL] > 5_000
    assert made[s.FAULTS] == 0
    turn(made, 1)
    assert made[s.FAULTS] == s.STALLED


def stalls(counts_per_1000_ticks, start):
    """Whether a wheel of this speed is stalled within a second, from this count on."""
    made = run(registers())
    tuning.set_stall(made, 0, COUNTS_PER_METRE, 300, 100)
    for tick in range(1000):
        made[s.COUNT] = start + tick * counts_per_1000_ticks // 1000 & 0xFFFF
        made[s.AGE] = made[s.AXIS + s.AGE] = 0
        s.step(made)
    return made[s.FAULTS] == s.STALLED


def test_wheel_is_stalled_below_2_mm_s_either_way_and_across_the_wrap_of_the_encoder():
    for start in (0, 5, 65_530, 32_766):
        for sign in (-1, 1):
            assert stalls(sign * 65, start)
            assert not stalls(sign * 100, start)


def test_wheel_held_below_the_stall_voltage_is_not_stalled():
    made = run(registers())
    tuning.set_stall(made, 0, COUNTS_PER_METRE, 1_001, 30)
    turn(made, 100)
    assert made[s.FAULTS] == 0


def test_following_error_is_a_fault_when_it_lasts_either_way():
    made = run(registers())
    for base in (0, s.AXIS):
        tuning.set_following(made, base, 99_999, 20)
    turn(made, 19)
    assert made[s.FAULTS] == made[s.AXIS + s.FAULTS] == 0
    turn(made, 1)
    assert made[s.FAULTS] == made[s.AXIS + s.FAULTS] == s.FOLLOWING


def test_either_axis_may_be_mounted_the_other_way_round():
    for base, other in ((0, s.AXIS), (s.AXIS, 0)):
        made = run(registers())
        tuning.set_direction(made, base, 1)
        tuning.set_direction(made, base, 1)
        s.step(made)
        reference = made[base + s.TARGET]
        assert made[base + s.VOLTAGE] == -10 * reference
        assert made[other + s.VOLTAGE] == 10 * made[other + s.TARGET]
        tuning.set_direction(made, base, 0)
        s.step(made)
        assert made[base + s.VOLTAGE] == 10 * reference


def test_wheel_that_is_mounted_otherwise_from_now_on_is_taken_to_stand():
    for base, other in ((0, s.AXIS), (s.AXIS, 0)):
        made = run(registers())
        turn(made, 200, 1500)
        rate = made[other + s.RATE]
        assert abs(rate) > 1_000
        tuning.set_direction(made, base, 1)
        assert made[base + s.RATE] == 0
        assert made[other + s.RATE] == rate


def extreme(made, base, index):
    """Settings and inputs at an end of their ranges, chosen by the bits of `index`."""
    high = [index >> bit & 1 for bit in range(9)]
    counts_per_metre = tuning.COUNTS_PER_METRE_MAX if high[0] else tuning.COUNTS_PER_METRE_MIN
    lag_us = tuning.LAG_MAX_US if high[1] else tuning.LAG_MIN_US
    tuning.set_encoder(made, base, counts_per_metre, lag_us)
    feed = tuning.ACCELERATION_PER_VOLT_MAX_MM_S2 if high[8] else 0
    tuning.set_feed(made, base, counts_per_metre, feed)
    gain = tuning.GAIN_MAX_MV_S_M if high[2] else 63
    tuning.set_law(made, base, gain, 60_000 if high[3] else 0)
    ramp = 1_000_000_000 if high[4] else 1
    tuning.set_ramps(made, base, ramp, ramp, ramp)
    tuning.set_over_current(made, base, tuning.CURRENT_MAX_MA, 65_535)
    tuning.set_stall(made, base, counts_per_metre, 60_000, 65_535)
    tuning.set_following(made, base, 20_000_000, 65_535)
    made[base + s.INVERTED] = high[5]
    made[base + s.MODE] = s.RUN
    limit = made[base + s.RATE_LIMIT]
    made[base + s.RATE] = limit if high[6] else -limit
    made[base + s.MEAN_VOLTAGE] = s.VOLTAGE_MAX_UV if high[6] else -s.VOLTAGE_MAX_UV
    made[base + s.POSITION] = (1 << 29) - 1 if high[7] else -(1 << 29)
    made[base + s.DEMAND] = s.SPEED_MAX_UM_S if high[7] else -s.SPEED_MAX_UM_S


def locked_steps(made):
    """Step through all pairs of extreme counts and targets with the heap locked."""
    values = array("i", EXTREMES)
    targets = array("i", (-s.SPEED_MAX_UM_S, -1, 0, 1, s.SPEED_MAX_UM_S))
    heap_lock()
    try:
        for count in range(len(values)):
            for target in range(len(targets)):
                made[s.COUNT] = made[s.AXIS + s.COUNT] = values[count]
                made[s.TARGET] = made[s.AXIS + s.TARGET] = targets[target]
                made[s.CURRENT] = made[s.AXIS + s.CURRENT] = values[count] // 2
                made[s.AGE] = made[s.AXIS + s.AGE] = 0
                s.step(made)
    finally:
        heap_unlock()


def test_no_setting_and_no_input_makes_a_tick_allocate():
    made = registers()
    for index in range(512):
        extreme(made, 0, index)
        extreme(made, s.AXIS, 511 - index)
        locked_steps(made)
        assert made[s.FAULTS] in (0, s.STALLED, s.OVER_CURRENT, s.FOLLOWING)


def test_too_low_a_supply_drives_nothing_and_is_a_fault_within_5_ticks():
    made = run(registers())
    s.step(made)
    made[s.SUPPLY] = 9_999_999
    for tick in range(1, 6):
        s.step(made)
        assert made[s.VOLTAGE] == made[s.AXIS + s.VOLTAGE] == 0
        assert (made[s.FAULTS] == s.UNDERVOLTAGE) == (tick == 5)
    made[s.SUPPLY] = 24_000_000
    turn(made, 100)
    assert made[s.VOLTAGE] == made[s.AXIS + s.VOLTAGE] == 0
    assert made[s.AXIS + s.FAULTS] == s.UNDERVOLTAGE


def test_a_supply_that_is_low_for_a_moment_is_no_fault():
    made = run(registers())
    for _ in range(20):
        made[s.SUPPLY] = 0
        turn(made, 4)
        made[s.SUPPLY] = 24_000_000
        turn(made, 1)
        assert made[s.VOLTAGE] == 1_000_000
    assert made[s.FAULTS] == 0


def test_an_axis_that_is_switched_on_drives_nothing_and_has_a_fault_for_want_of_a_supply():
    made = registers()
    made[s.MODE] = s.SWITCHED_ON
    made[s.TARGET] = 100_000
    turn(made, 2000)
    assert made[s.VOLTAGE] == made[s.FAULTS] == made[s.AWAKE] == 0
    assert s.let_sleep(made)
    made[s.SUPPLY] = 0
    turn(made, 4)
    assert made[s.FAULTS] == 0
    turn(made, 1)
    assert made[s.FAULTS] == s.UNDERVOLTAGE
    assert made[s.AXIS + s.FAULTS] == 0


def spinning(speed_um_s, ticks=300):
    """A wheel at a steady speed under no load, and the function that goes on turning it."""
    made = run(registers())
    tuning.set_reversal(made, 0, 2_000, 80)
    travel = [0.0]

    def go_on(count, speed_um_s):
        for _ in range(count):
            travel[0] += speed_um_s * COUNTS_PER_METRE / 1e9
            made[s.COUNT] = int(travel[0] // 1)
            made[s.AGE] = made[s.AXIS + s.AGE] = 0
            s.step(made)

    made[s.TARGET] = speed_um_s
    go_on(ticks, speed_um_s)
    assert made[s.FAULTS] == 0
    return made, go_on


def test_a_wheel_that_turns_against_its_voltage_is_a_fault_after_its_time():
    made, go_on = spinning(-120_000)
    made[s.TARGET] = 300_000
    go_on(79, -120_000)
    assert made[s.FAULTS] == 0
    go_on(2, -120_000)
    assert made[s.FAULTS] == s.REVERSED
    assert made[s.VOLTAGE] == 0


def test_a_wheel_that_slows_down_against_its_voltage_is_braking():
    made, go_on = spinning(-1_000_000)
    made[s.TARGET] = 1_000_000
    for speed in range(-1_000_000, 0, 1_000):  # 1 m/s2
        go_on(1, speed)
    assert made[s.FAULTS] == 0


def test_a_wheel_that_is_to_stand_and_turns_round_is_not_pushed_on():
    made, go_on = spinning(-3_000_000)
    made[s.TARGET] = 0
    go_on(50, -2_000_000)
    assert made[s.VOLTAGE] > 15_000_000
    pushed = 0
    for _ in range(60):
        go_on(1, 240_000)
        if made[s.VOLTAGE] > 0:
            pushed += 1
    assert pushed <= 1
    assert made[s.VOLTAGE] < -2_000_000


def test_a_slow_wheel_that_is_to_stand_keeps_the_law_when_it_turns_round():
    made, go_on = spinning(-8_000)
    made[s.TARGET] = 0
    while made[s.IDLE_COUNT] != s.IDLE_TICKS:
        go_on(1, 30_000)
    assert -s.SLOW_UM_S <= made[s.ACTUAL] < 0
    assert made[s.VOLTAGE] == -10 * made[s.ACTUAL]


def test_a_wheel_that_is_to_turn_round_is_driven_through_its_standstill():
    made, go_on = spinning(-3_000_000)
    made[s.TARGET] = 240_000
    go_on(2, 240_000)
    assert made[s.ACTUAL] < -500_000
    assert made[s.VOLTAGE] > 7_000_000


def test_an_axis_that_goes_off_brakes_until_it_stands_and_then_the_bridges_sleep():
    made, go_on = spinning(200_000)
    made[s.WINDOW_TICKS] = 10
    made[s.AXIS + s.MODE] = s.OFF
    go_on(2000, 200_000)
    assert made[s.AWAKE] == 1
    made[s.MODE] = s.OFF
    for speed in range(200_000, 0, -2_000):
        go_on(1, speed)
        assert made[s.AWAKE] == 1
        assert made[s.VOLTAGE] == 0
    go_on(800, 0)
    assert made[s.AWAKE] == 1
    go_on(60, 0)
    assert made[s.AWAKE] == 0
    # A wheel that is pushed later rolls freely.
    go_on(60, 200_000)
    assert made[s.AWAKE] == 0


def test_a_wheel_that_is_pushed_on_soon_after_it_stood_is_braked_until_it_stands_again():
    made, go_on = spinning(200_000)
    made[s.WINDOW_TICKS] = 10
    made[s.BRAKE_TICKS] = 3000
    made[s.AXIS + s.MODE] = s.OFF
    made[s.MODE] = s.OFF
    for speed_um_s, ticks in ((0, 100), (200_000, 900), (0, 800)):
        go_on(ticks, speed_um_s)
        assert made[s.AWAKE] == 1
    go_on(60, 0)
    assert made[s.AWAKE] == 0


def test_a_wheel_whose_encoder_is_stuck_is_not_pushed_on_once_its_reference_is_0():
    made = registers()
    run(made)
    made[s.REACTION] = 1
    tuning.set_ramps(made, 0, 0, 0, 1_000_000)
    tuning.set_brake(made, 0, 65_000, 24_000)
    tuning.set_feed(made, 0, COUNTS_PER_METRE)
    for _ in range(500):
        made[s.AGE] = made[s.AXIS + s.AGE] = 0
        s.step(made)
    pushed = made[s.VOLTAGE]
    assert pushed > 500_000
    for tick in range(1000):
        s.step(made)
        if tick >= 50 and made[s.DEMAND] == 0:
            assert made[s.VOLTAGE] == 0, tick
    assert made[s.DEMAND] == 0


def test_bridges_sleep_after_a_reset():
    made = registers()
    turn(made, 100, 1000)
    assert made[s.AWAKE] == 0


def test_turns_of_the_count_are_counted_in_both_directions():
    made = registers()
    for count in (60_000, 70_000, 100_000, 130_000, 140_000, 110_000, 80_000, 60_000, 50_000):
        made[s.COUNT] = count & 0xFFFF
        s.step(made)
        turns = (made[s.TURNS] ^ 0x8000) - 0x8000
        # The first count is a small one that lies behind 0.
        assert turns * 65536 + made[s.LAST_COUNT] == count - 65536


class Interrupted:
    """Registers with a tick after each write; `volts` are the voltages [uV] of these."""

    def __init__(self, made):
        self.made = made
        self.volts = []

    def __getitem__(self, place):
        return self.made[place]

    def __setitem__(self, place, number):
        self.made[place] = number
        self.made[s.AGE] = self.made[s.AXIS + s.AGE] = 0
        s.step(self.made)
        self.volts.append(abs(self.made[s.VOLTAGE]))


def test_no_tick_amid_a_change_of_the_gain_exceeds_the_voltage_limit():
    for mode, change in ((s.RUN, tuning.set_law), (s.BRAKE, tuning.set_brake)):
        made = registers()
        tuning.set_law(made, 0, 1_000, 2_000)
        tuning.set_brake(made, 0, 1_000, 2_000)
        run(made)
        turn(made, 200, 20_000)
        made[s.MODE] = mode
        made[s.TARGET] = -500_000
        interrupted = Interrupted(made)
        change(interrupted, 0, 100_000, 2_000)
        assert max(interrupted.volts) <= 2_000_000
