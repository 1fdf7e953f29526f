"""Parameters of the speed loop that depend on each other, worked out in integers of any size.

Called from the background when a setting changes; `speed_loop.step` only multiplies and shifts.
`base` is 0 for axis 1 and `speed_loop.AXIS` for axis 2. Values out of range raise ValueError.
"""

from mdms_cell import speed_loop

COUNTS_PER_METRE_MIN = 300
COUNTS_PER_METRE_MAX = 3_900_000
LAG_MIN_US = 1_000
LAG_MAX_US = 20_000
GAIN_MAX = 1 << 20

_RATE_MAX = 1 << 27


def set_encoder(registers, base, counts_per_metre):
    """Scale the tracked velocity to um/s, for an encoder of so many counts per metre of wheel rim.

    A unit of RATE is 10**9 / (2**14 counts_per_metre) um/s. It is kept as a fraction of 15 bits,
    which is exact to 6e-5.
    """
    _check("counts per metre", counts_per_metre, COUNTS_PER_METRE_MIN, COUNTS_PER_METRE_MAX)
    shift = 14
    while _scale(shift, counts_per_metre) >= 1 << 15:
        shift -= 1
    registers[base + speed_loop.SHIFT] = shift
    registers[base + speed_loop.SCALE] = _scale(shift, counts_per_metre)
    fastest = speed_loop.SPEED_MAX_UM_S * (counts_per_metre << 14) // 1_000_000_000
    registers[base + speed_loop.RATE_LIMIT] = min(fastest, _RATE_MAX)


def _scale(shift, counts_per_metre):
    denominator = counts_per_metre << 14
    return ((1_000_000_000 << (shift + 6)) + denominator // 2) // denominator


def set_observer(registers, base, lag_us):
    """Make the observer's velocity trail a steady acceleration by `lag_us` less half a tick.

    An alpha-beta filter with both poles at z (critically damped) has alpha = 1 - z**2 and
    beta = (1 - z)**2, and trails by alpha / beta = (1 + z) / (1 - z) ticks, less one half.
    """
    _check("observer lag [us]", lag_us, LAG_MIN_US, LAG_MAX_US)
    square = (lag_us + 1000) ** 2
    registers[base + speed_loop.ALPHA] = (4 * 4096 * 1000 * lag_us + square // 2) // square
    registers[base + speed_loop.BETA] = (4 * 4096 * 1000 * 1000 + square // 2) // square


def set_law(registers, base, gain, voltage_limit_uv):
    """Set the gain G [V s/m / 16] and the largest voltage [uV] of the law V = G (r - v)."""
    _check("gain [V s/m / 16]", gain, 0, GAIN_MAX)
    _check("voltage limit [uV]", voltage_limit_uv, 0, speed_loop.VOLTAGE_MAX_UV)
    registers[base + speed_loop.GAIN] = gain
    registers[base + speed_loop.VOLTAGE_LIMIT] = voltage_limit_uv
    limit = -(-voltage_limit_uv * 16 // gain) if gain else 0
    registers[base + speed_loop.ERROR_LIMIT] = limit


def _check(name, value, low, high):
    if not low <= value <= high:
        raise ValueError("%s must be %d to %d, got %d" % (name, low, high, value))
