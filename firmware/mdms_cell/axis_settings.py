"""The stored settings of an axis on their way into the speed loop, loaded when one has changed."""

from mdms_cell import axis, speed_loop, tuning

_VELOCITY_REVERSED = 0x40


def load(registers, base, setting):
    """Bring the settings into the registers; `setting(index)` tells them by those of axis 1."""
    rated_ma = setting(axis.RATED_CURRENT)
    reversed_ = setting(axis.POLARITY) & _VELOCITY_REVERSED
    registers[base + speed_loop.INVERTED] = 1 if reversed_ else 0
    resolution = setting(axis.RESOLUTION)
    tuning.set_encoder(registers, base, resolution, setting(axis.OBSERVER_LAG))
    tuning.set_feed(registers, base, resolution, setting(axis.ACCELERATION_PER_VOLT))
    tuning.set_law(registers, base, setting(axis.GAIN), setting(axis.VOLTAGE_LIMIT))
    tuning.set_ramps(
        registers,
        base,
        setting(axis.ACCELERATION),
        setting(axis.DECELERATION),
        setting(axis.QUICK_STOP),
    )
    limit_ma = setting(axis.MAX_CURRENT) * rated_ma // 1000
    tuning.set_over_current(registers, base, limit_ma, setting(axis.OVER_CURRENT_TIME))
    stall_voltage_mv, stall_time_ms = setting(axis.STALL_VOLTAGE), setting(axis.STALL_TIME)
    tuning.set_stall(registers, base, resolution, stall_voltage_mv, stall_time_ms)
    tuning.set_following(registers, base, setting(axis.MAX_SLIPPAGE), setting(axis.SLIPPAGE_TIME))
    registers[base + speed_loop.WINDOW] = setting(axis.WINDOW)
    registers[base + speed_loop.WINDOW_TICKS] = setting(axis.WINDOW_TIME)
