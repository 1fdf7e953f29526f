"""A seeded stream of everything that may stand in the speed loop's registers, extremes included."""

from binascii import crc32

from mdms_cell.drive import speed_loop as s
from mdms_cell.drive import tuning


class Chance:
    """Random numbers that are the same on every interpreter (a Lehmer generator, modulus 65537)."""

    def __init__(self, seed):
        self.state = seed % 65536 + 1

    def below(self, count):
        """A number from 0 to `count` - 1, for counts up to 65536."""
        self.state = self.state * 75 % 65537
        return self.state % count

    def within(self, low, high):
        """A number of a range: one of its ends every other time, else any magnitude."""
        pick = self.below(4)
        if pick < 2:
            return high if pick else low
        span = (high - low) >> self.below(30)
        value = low + (self.below(65536) * 16411 + self.below(16411)) % (span + 1)
        return value if pick == 2 else high - (value - low)


def configure(registers, chance):
    """Give both axes settings from anywhere in their ranges."""
    s.reset(registers)
    for base in (0, s.AXIS):
        low = tuning.COUNTS_PER_METRE_MIN
        counts_per_metre = chance.within(low, tuning.COUNTS_PER_METRE_MAX)
        lag_us = chance.within(tuning.LAG_MIN_US, tuning.LAG_MAX_US)
        tuning.set_encoder(registers, base, counts_per_metre, lag_us)
        feed = chance.within(0, tuning.ACCELERATION_PER_VOLT_MAX_MM_S2)
        tuning.set_feed(registers, base, counts_per_metre, feed)
        gain = chance.within(0, tuning.GAIN_MAX_MV_S_M)
        tuning.set_law(registers, base, gain, chance.within(0, 60_000))
        ramps = [chance.within(0, 1_000_000_000) for _ in range(3)]
        tuning.set_ramps(registers, base, *ramps)
        tuning.set_over_current(registers, base, chance.within(0, 100_000), chance.below(20))
        stall_mv, stall_ms = chance.within(0, 60_000), chance.below(20)
        tuning.set_stall(registers, base, counts_per_metre, stall_mv, stall_ms)
        tuning.set_following(registers, base, chance.within(0, 20_000_000), chance.below(20))
        registers[base + s.INVERTED] = chance.below(2)
    registers[s.AGE_LIMIT] = chance.below(50)


def disturb(registers, chance):
    """Give both axes new inputs and commands."""
    for base in (0, s.AXIS):
        jump = chance.within(-(1 << 14), 1 << 14) if chance.below(8) == 0 else chance.below(64) - 24
        count = registers[base + s.COUNT] + jump
        registers[base + s.COUNT] = count if -(1 << 30) <= count < 1 << 30 else 0
        if chance.below(4) == 0:
            registers[base + s.TARGET] = chance.within(-s.SPEED_MAX_UM_S, s.SPEED_MAX_UM_S)
            registers[base + s.AGE] = 0
            registers[base + s.CURRENT] = chance.within(-1_000_000, 1_000_000)
        if chance.below(32) == 0:
            registers[base + s.MODE] = chance.below(3)
            registers[base + s.FAULTS] = 0


def digest(step, registers, seed, ticks):
    """Run `step` for some ticks on random settings; a checksum of all registers at every tick."""
    chance = Chance(seed)
    configure(registers, chance)
    view = memoryview(registers)[: s.WIDEN]
    checksum = 0
    for _ in range(ticks):
        disturb(registers, chance)
        step(registers)
        checksum = crc32(view, checksum)
    return checksum
