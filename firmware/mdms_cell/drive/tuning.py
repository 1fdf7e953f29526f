"""Settings in the units of the object table, turned into the parameters of the speed loop.

Called from the background when a setting changes, in integers of any size; `speed_loop.step` is
left with multiplications and shifts. `base` is 0 for axis 1 and `speed_loop.AXIS` for axis 2.
A value out of range raises ValueError.
"""

from mdms_cell.drive import speed_loop

COUNTS_PER_METRE_MIN = 300
COUNTS_PER_METRE_MAX = 3_900_000
LAG_MIN_US = 500
LAG_MAX_US = 20_000
LAG_US = 1_900
ACCELERATION_PER_VOLT_MM_S2 = 20_053
ACCELERATION_PER_VOLT_MAX_MM_S2 = 65_535
GAIN_MAX_MV_S_M = 65_536_000
CURRENT_MAX_MA = 1_000_000
TIME_MAX_MS = 65_535
STALL_SPEED_MM_S = 2
STALL_REACH_MAX = (1 << 15) - 1

_RATE_MAX = 1 << 27


def set_direction(registers, base, inverted):
    """Set whether motor and encoder are mounted the other way round (1); only while they are off.

    The observer begins anew at the count. Otherwise it would take its new sign for a motion.
    """
    if registers[base + speed_loop.INVERTED] == inverted:
        return
    count = registers[base + speed_loop.LAST_COUNT]
    count = ((-count if inverted else count) & 0xFFFF ^ 0x8000) - 0x8000
    # In this order: a tick may come between any two.
    registers[base + speed_loop.INVERTED] = inverted
    registers[base + speed_loop.POSITION] = count << 14
    registers[base + speed_loop.RATE] = 0


def set_encoder(registers, base, counts_per_metre, lag_us=LAG_US):
    """Track an encoder of so many counts per metre of wheel rim.

    A unit of RATE is 10**9 / (2**14 counts_per_metre) um/s. It is kept as a fraction of 15 bits,
    which is exact to 3e-5. The velocity of an alpha-beta filter trails a steady acceleration by
    alpha / beta - 1/2 ticks. This filter is critically damped: the fading memory of first degree of
    Morrison's 'Introduction to Sequential Smoothing and Prediction' (1969). `step` uses three
    eighths of its gains within a count, and the loop still has a margin then.
    """
    _check(counts_per_metre, COUNTS_PER_METRE_MIN, COUNTS_PER_METRE_MAX)
    _check(lag_us, LAG_MIN_US, LAG_MAX_US)
    shift = 14
    while _scale(shift, counts_per_metre) >= 1 << 15:
        shift -= 1
    registers[base + speed_loop.SHIFT] = shift
    registers[base + speed_loop.SCALE] = _scale(shift, counts_per_metre)
    fastest = speed_loop.SPEED_MAX_UM_S * (counts_per_metre << 14) // 1_000_000_000
    registers[base + speed_loop.RATE_LIMIT] = min(fastest, _RATE_MAX)
    ratio_us = lag_us + 500
    alpha = 4 * 1000 * 4096 * ratio_us
    beta = 4 * 1000 * 4096 * 1000
    divisor = (ratio_us + 1000) ** 2
    registers[base + speed_loop.ALPHA] = (alpha + divisor // 2) // divisor
    registers[base + speed_loop.BETA] = (beta + divisor // 2) // divisor


def set_feed(registers, base, counts_per_metre, acceleration_per_volt=ACCELERATION_PER_VOLT_MM_S2):
    """Set by how much the observer expects new voltage to speed the wheel up [mm/s2 per V].

    0 leaves it to the encoder. The new part of a voltage fades with a time constant of 16 ticks. So
    the speed of a wheel with more load than its motor's data is off for that time only. With more
    than half a million counts per metre, FEED limits the value for the strongest motors.
    """
    high = ACCELERATION_PER_VOLT_MAX_MM_S2
    _check(acceleration_per_volt, 0, high)
    feed = ((acceleration_per_volt * counts_per_metre << 30) + 10**15 // 2) // 10**15
    registers[base + speed_loop.FEED] = min(feed, speed_loop.FEED_MAX)


def _scale(shift, counts_per_metre):
    denominator = counts_per_metre << 14
    return ((1_000_000_000 << (shift + 6)) + denominator // 2) // denominator


def set_law(registers, base, gain_mv_s_m, voltage_limit_mv):
    """Set the gain G [mV s/m, in steps of 62.5] and voltage limit [mV] of the law V = G (r - v)."""
    _check(gain_mv_s_m, 0, GAIN_MAX_MV_S_M)
    _check(voltage_limit_mv, 0, speed_loop.VOLTAGE_MAX_UV // 1000)
    gain = (gain_mv_s_m * 16 + 500) // 1000
    # A tick may come between, with the old limit and the new gain.
    registers[base + speed_loop.ERROR_LIMIT] = 0
    registers[base + speed_loop.GAIN] = gain
    registers[base + speed_loop.ERROR_LIMIT] = voltage_limit_mv * 16_000 // gain if gain else 0


def set_brake(registers, base, gain_mv_s_m, voltage_limit_mv):
    """Set the gain of the law in BRAKE, as `set_law`; a smaller one than the law's means the law's.

    To be called after `set_law`. A reference of 0 brakes with b u only, u the speed, and friction
    would allow more for a heavy parcel at a low speed.
    """
    _check(gain_mv_s_m, 0, GAIN_MAX_MV_S_M)
    gain = max((gain_mv_s_m * 16 + 500) // 1000, registers[base + speed_loop.GAIN])
    registers[base + speed_loop.BRAKE_LIMIT] = 0
    registers[base + speed_loop.BRAKE_GAIN] = gain
    registers[base + speed_loop.BRAKE_LIMIT] = voltage_limit_mv * 16_000 // gain if gain else 0


def set_ramps(registers, base, acceleration, deceleration, quick_stop):
    """Set how fast the reference may change [um/s2]; 0 lets it jump."""
    registers[base + speed_loop.ACCELERATION] = _per_tick(acceleration)
    registers[base + speed_loop.DECELERATION] = _per_tick(deceleration)
    registers[base + speed_loop.QUICK_STOP] = _per_tick(quick_stop)


def set_times(registers, setpoint_timeout_ms, braking_ms):
    """Set how old a target may grow, and how long an axis brakes at most; of both axes."""
    registers[speed_loop.AGE_LIMIT] = setpoint_timeout_ms * speed_loop.TICK_HZ // 1000
    registers[speed_loop.BRAKE_TICKS] = braking_ms * speed_loop.TICK_HZ // 1000


def set_over_current(registers, base, limit_ma, time_ms):
    """Make more than `limit_ma` for `time_ms` a fault; a time of 0 does not watch.

    A limit of 0 is watched as one of 1 mA. So a bridge that shuts off is a fault at any limit.
    """
    _check(limit_ma, 0, CURRENT_MAX_MA)
    _check(time_ms, 0, TIME_MAX_MS)
    registers[base + speed_loop.CURRENT_TICKS] = time_ms
    registers[base + speed_loop.CURRENT_LIMIT] = max(limit_ma, 1) if time_ms else 0


def set_stall(registers, base, counts_per_metre, voltage_mv, time_ms):
    """Make standing still under `voltage_mv` or more for `time_ms` a fault; 0 does not watch."""
    _check(voltage_mv, 0, speed_loop.VOLTAGE_MAX_UV // 1000)
    _check(time_ms, 0, TIME_MAX_MS)
    reach = STALL_SPEED_MM_S * time_ms * counts_per_metre // 1_000_000 + 1
    registers[base + speed_loop.STALL_SPAN] = 2 * min(reach, STALL_REACH_MAX)
    registers[base + speed_loop.STALL_TICKS] = time_ms
    registers[base + speed_loop.STALL_VOLTAGE] = voltage_mv * 1000 if time_ms else 0


def set_reversal(registers, base, voltage_mv, time_ms):
    """Make turning against `voltage_mv` or more for `time_ms` a fault; 0 does not watch."""
    _check(voltage_mv, 0, speed_loop.VOLTAGE_MAX_UV // 1000)
    _check(time_ms, 0, TIME_MAX_MS)
    registers[base + speed_loop.REVERSAL_TICKS] = time_ms
    registers[base + speed_loop.REVERSAL_VOLTAGE] = voltage_mv * 1000 if time_ms else 0


def set_following(registers, base, limit_um_s, time_ms):
    """Make a speed this far off the reference for `time_ms` a fault; 0 does not watch."""
    _check(limit_um_s, 0, 2 * speed_loop.SPEED_MAX_UM_S)
    _check(time_ms, 0, TIME_MAX_MS)
    registers[base + speed_loop.FOLLOWING_TICKS] = time_ms
    registers[base + speed_loop.FOLLOWING_LIMIT] = limit_um_s if time_ms else 0


def _per_tick(acceleration_um_s2):
    _check(acceleration_um_s2, 0, 1_000_000_000)
    return -(-acceleration_um_s2 // speed_loop.TICK_HZ)


def _check(value, low, high):
    if not low <= value <= high:
        raise ValueError("must be %d to %d, got %d" % (low, high, value))
