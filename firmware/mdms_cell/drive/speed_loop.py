"""The speed loop of a cell's two axes: one function over one buffer of 32-bit integers.

`step(registers)` is one control period of 1 ms. It tracks both encoders, ramps the targets, and
applies the paper's law V = G (r - v). It watches for faults, brakes axes that are off, and reports
events to the background by ATTENTION. Its integers stay within 31 bits, so nothing is allocated.
The same source runs as plain Python over an `array('i')`, as MicroPython bytecode, as viper machine
code, and compiled by numba.

The registers of axis 1 start at 0, those of axis 2 at `AXIS`: `registers[AXIS + TARGET]` is the
target of axis 2. COUNT, CURRENT and VOLTAGE are as wired. All others are signed along the wheel's
own direction. No register may leave -2**30..2**30 - 1; the ranges stand beside each.
"""

import sys

from mdms_protocol.compat import const, micropython, ptr32

# Of each axis. Commands:
TARGET = const(0)  # reference r [um/s], within +-SPEED_MAX_UM_S
MODE = const(1)  # OFF, RUN, STOP, BRAKE or SWITCHED_ON
AGE = const(2)  # ticks since the last target, counted here, zeroed by the writer of TARGET
# Parameters; those marked * are written by `drive.tuning` only, for they depend on each other:
INVERTED = const(3)  # 1: motor and encoder are mounted the other way round
ACCELERATION = const(4)  # ramp of the reference away from 0 [um/s per tick]; 0: it jumps
DECELERATION = const(5)  # ramp of the reference towards 0 [um/s per tick]; 0: it jumps
QUICK_STOP = const(6)  # ramp in STOP and BRAKE [um/s per tick]; 0: it jumps
GAIN = const(7)  # * G [V s/m / 16], 0..2**20
ERROR_LIMIT = const(8)  # * speed error that takes the largest voltage [um/s]; times GAIN it fits
ALPHA = const(9)  # * share of the innovation that corrects the position [1/4096], 0..4096
BETA = const(10)  # * and the velocity [1/4096], 0..4096
SCALE = const(11)  # * um/s of one unit of RATE, times 2**(SHIFT + 6), 0..2**15 - 1
SHIFT = const(12)  # * 1..14
RATE_LIMIT = const(13)  # * of the tracked velocity, so that times SCALE it fits, 0..2**27
FEED = const(14)  # * RATE gained a tick by 4096 uV of new voltage [1/16], 0..FEED_MAX
CURRENT_LIMIT = const(15)  # [mA]; 0: not watched
CURRENT_TICKS = const(16)  # ticks of over-current that are a fault
STALL_VOLTAGE = const(17)  # a wheel is stalled at this voltage or more [uV]; 0: not watched ...
STALL_SPAN = const(18)  # * ... while it stays within so many counts, 0..0xFFFE ...
STALL_TICKS = const(19)  # ... for so many ticks
REVERSAL_VOLTAGE = const(20)  # a wheel that turns against this voltage or more [uV] ...
REVERSAL_TICKS = const(21)  # ... for so many ticks and does not slow down runs away; 0: not watched
FOLLOWING_LIMIT = const(22)  # largest difference of reference and speed [um/s]; 0: not watched
FOLLOWING_TICKS = const(23)  # ticks of a larger one that are a fault
WINDOW = const(24)  # an axis is at its target when so near to it [um/s], 0..65535 ...
WINDOW_TICKS = const(25)  # ... for so many ticks; and stands when it has been slow for so many
# Read from the board:
COUNT = const(26)  # encoder [counts]; only the low 16 bits are looked at
CURRENT = const(27)  # [mA], as wired, within +-2**29
# State and results:
POSITION = const(28)  # tracked position [2**-14 counts], modulo 2**30
RATE = const(29)  # velocity expected in the next tick [2**-14 counts per tick], within 2**28
ACTUAL = const(30)  # tracked velocity [um/s]
DEMAND = const(31)  # the ramped reference r that the law sees [um/s]
VOLTAGE = const(32)  # the voltage for the board to apply [uV], as wired
MEAN_VOLTAGE = const(33)  # of the last 16 ticks or so, along the wheel's own direction [uV]
FAULTS = const(34)  # bits below; kept until cleared from outside, and the voltage is 0 while set,
# but for STALE alone while the wheel is braked
CURRENT_COUNT = const(35)  # ticks of over-current so far
STALL_COUNT = const(36)  # ticks of stall so far
STALL_FROM = const(37)  # the lowest count of the span in which a stalled wheel stays
REVERSAL_COUNT = const(38)  # ticks against the voltage so far
REVERSAL_PEAK = const(39)  # largest speed in these [um/s]
FOLLOWING_COUNT = const(40)  # ticks of following error so far
NEAR_COUNT = const(41)  # ticks near the target so far, up to WINDOW_TICKS
SLOW_COUNT = const(42)  # ticks of standstill so far, up to WINDOW_TICKS + HOLD_TICKS
STOP_COUNT = const(43)  # ticks in STOP or BRAKE so far, up to BRAKE_TICKS
BRAKE_COUNT = const(44)  # ticks of braking since the axis went off, up to BRAKE_TICKS
LAST_COUNT = const(45)  # the low 16 bits of COUNT in the last tick
TURNS = const(46)  # how often COUNT has passed over its 16 bits, modulo 2**16
SIGNS = const(47)  # bits below
# Parameters again:
REACTION = const(48)  # 1: a stale target has the wheel braked as in BRAKE; 0: voltage 0 at once
BRAKE_GAIN = const(49)  # * G in BRAKE [V s/m / 16], 0..2**20
BRAKE_LIMIT = const(50)  # * ERROR_LIMIT in BRAKE [um/s]
# State again:
IDLE_COUNT = const(51)  # ticks since COUNT has followed RATE, up to IDLE_TICKS ...
# ... and IDLE_TICKS once it has changed against it

AXIS = const(52)  # registers of an axis
AXES = const(2)

# Of the cell:
TICKS = const(104)  # ticks since the start, modulo 2**30
AGE_LIMIT = const(105)  # a target of this age is stale [ticks]
SUPPLY = const(106)  # supply voltage as the board measures it [uV], 0..VOLTAGE_MAX_UV
SUPPLY_MIN = const(107)  # a supply below this drives no motor [uV]
LOW_COUNT = const(108)  # ticks of too low a supply so far, up to LOW_TICKS
CUT = const(109)  # not 0: voltage 0 on both axes, for interrupts, which see no state machine
BRAKE_TICKS = const(110)  # ticks after which braking ends, standstill or not
AWAKE = const(111)  # 1: the bridges are to be awake, for an axis is on or brakes; 0: they sleep
ATTENTION = const(112)  # set to 1 when FAULTS or SIGNS change; zeroed by the background
WIDEN = const(113)  # bits to shift for sign extension of a loaded register, see `reset`
REGISTERS = const(114)

# Values of MODE; STOP and BRAKE ramp down.
OFF = const(0)  # voltage 0: brake until the wheel has stood for HOLD_TICKS, then sleep
RUN = const(1)  # follow TARGET
STOP = const(2)  # ramp to standstill at any TARGET; over after BRAKE_TICKS at the latest
#: As STOP, with a gain of its own, and hold the wheel for STILL_TICKS: the parcel may slide.
BRAKE = const(3)
#: As OFF, but too low a supply is a fault: from here a cell may drive without another command.
SWITCHED_ON = const(4)

# Bits of FAULTS.
STALE = const(1)
OVER_CURRENT = const(2)
STALLED = const(4)
FOLLOWING = const(8)
REVERSED = const(16)
UNDERVOLTAGE = const(32)

# Bits of SIGNS.
AT_TARGET = const(1)
STANDING = const(2)
STOPPED = const(4)  # at standstill in STOP, or the time of STOP or BRAKE is over
LOW_SUPPLY = const(8)  # too low a supply for LOW_TICKS

TICK_HZ = const(1000)
SPEED_MAX_UM_S = const(10_000_000)
VOLTAGE_MAX_UV = const(60_000_000)
FEED_MAX = const((1 << 15) - 1)
HALF_COUNT = const(1 << 13)  # in units of POSITION
SLOW_UM_S = const(10_000)
#: A heavy parcel drags braking wheels at less than this for a while [um/s].
REVERSAL_UM_S = const(100_000)
#: A wheel that loses so much speed [um/s] while it turns against its voltage is braking.
REVERSAL_DROP_UM_S = const(20_000)
#: Ticks for which a wheel that stands is still braked.
HOLD_TICKS = const(800)
#: Ticks for which a wheel that stands is held in BRAKE.
STILL_TICKS = const(300)
#: Ticks without a count after which BRAKE shorts a wheel, for its encoder may be stuck. A count
#: against the tracked velocity shorts it at once, for it has turned round. In both cases the speed
#: that the law expects of it may push it on. Other modes short only a wheel that is not slow. In
#: all modes the reference is 0.
IDLE_TICKS = const(16)
#: Ticks of too low a supply that are a fault; the voltage is 0 from the first.
LOW_TICKS = const(5)


def reset(registers):
    """Zero all registers but WIDEN, which depends on the width of a machine word.

    Viper on a 64-bit machine loads a negative register as a large positive number. A shift up and
    down again by 32 bits repairs that. A shift by 0 bits does nothing where no repair is needed.
    """
    for index in range(REGISTERS):
        registers[index] = 0
    registers[WIDEN] = 32 if sys.maxsize >> 32 else 0


def let_sleep(registers):
    """Have the bridges sleep from now on; False where an axis is on, or a wheel brakes still.

    Wheels that stand are no longer held: the next tick would wake both bridges again.
    """
    for base in range(0, AXES * AXIS, AXIS):
        standing = registers[base + SIGNS] & STANDING
        if is_on(registers, base) or (registers[AWAKE] and not standing):
            return False
    registers[AWAKE] = 0
    return True


def is_on(registers, base):
    """Whether the axis whose registers start at `base` drives its motor."""
    return OFF < registers[base + MODE] < SWITCHED_ON


@micropython.viper
def step(registers: ptr32):  # noqa: PLR0912, PLR0915 - one function, so that it compiles to one
    """Advance both axes by one tick of 1 ms, in place."""
    base = 0
    widen = registers[WIDEN]
    awake = 0
    low_supply = 0
    if registers[SUPPLY] < registers[SUPPLY_MIN]:
        low_supply = registers[LOW_COUNT]
        if low_supply < LOW_TICKS:
            low_supply += 1
    registers[LOW_COUNT] = low_supply
    while base < AXES * AXIS:
        # Predict the position, and compare it with the count, modulo 2**16 counts.
        rate = registers[base + RATE] << widen >> widen
        position = registers[base + POSITION] + rate
        position = ((position & 0x3FFFFFFF) ^ 0x20000000) - 0x20000000
        count = registers[base + COUNT] & 0xFFFF
        moved = count - registers[base + LAST_COUNT]
        if moved > 0x8000:
            registers[base + TURNS] = registers[base + TURNS] - 1 & 0xFFFF
            moved -= 0x10000
        elif moved < 0 - 0x8000:
            registers[base + TURNS] = registers[base + TURNS] + 1 & 0xFFFF
            moved += 0x10000
        registers[base + LAST_COUNT] = count
        inverted = registers[base + INVERTED]
        if inverted:
            count = 0 - count
            moved = 0 - moved
        if moved != 0:
            registers[base + IDLE_COUNT] = IDLE_TICKS if moved ^ rate < 0 else 0
        elif registers[base + IDLE_COUNT] < IDLE_TICKS:
            registers[base + IDLE_COUNT] += 1
        count = ((count & 0xFFFF) ^ 0x8000) - 0x8000
        innovation = (count << 14) - position
        innovation = ((innovation & 0x3FFFFFFF) ^ 0x20000000) - 0x20000000

        # The wheel may be anywhere within its count: so much of an innovation means little.
        within = innovation
        if within > HALF_COUNT:
            within = HALF_COUNT
        elif within < 0 - HALF_COUNT:
            within = 0 - HALF_COUNT
        innovation -= within * 5 >> 3

        # Correct both. Products are taken in two halves, for the whole would not fit.
        high = innovation >> 12
        low = innovation & 0xFFF
        gain = registers[base + ALPHA]
        position += high * gain + (low * gain >> 12)
        registers[base + POSITION] = ((position & 0x3FFFFFFF) ^ 0x20000000) - 0x20000000
        gain = registers[base + BETA]
        rate += high * gain + (low * gain >> 12)
        limit = registers[base + RATE_LIMIT]
        if rate > limit:
            rate = limit
        elif rate < 0 - limit:
            rate = 0 - limit
        shift = registers[base + SHIFT]
        gain = registers[base + SCALE]
        low = rate & ((1 << shift) - 1)
        actual = ((rate >> shift) * gain + (low * gain >> shift)) >> 6
        registers[base + ACTUAL] = actual

        # Targets that have stopped coming are a fault, of which the wheel may be braked first.
        mode = registers[base + MODE]
        faults = registers[base + FAULTS]
        known = faults
        if mode == SWITCHED_ON:
            if low_supply == LOW_TICKS:
                faults |= UNDERVOLTAGE
            mode = OFF
        age = registers[base + AGE]
        if age < registers[AGE_LIMIT]:
            registers[base + AGE] = age + 1
        elif mode == RUN:
            faults |= STALE
        if mode == RUN and faults == STALE and registers[base + REACTION] != 0:
            mode = BRAKE

        # Ramp the reference.
        target = registers[base + TARGET] << widen >> widen
        remaining = target - actual
        if mode != RUN:
            target = 0
        demand = registers[base + DEMAND] << widen >> widen
        ramp = registers[base + ACCELERATION]
        if mode >= STOP:
            ramp = registers[base + QUICK_STOP]
        elif (demand > 0 and target < demand) or (demand < 0 and target > demand):
            ramp = registers[base + DECELERATION]
            # On the other side of 0 the reference is sped up, by the other ramp.
            if target ^ demand < 0:
                if ramp != 0:
                    target = 0
                else:
                    demand = 0
                    ramp = registers[base + ACCELERATION]
        if ramp == 0:
            demand = target
        elif target > demand + ramp:
            demand += ramp
        elif target < demand - ramp:
            demand -= ramp
        else:
            demand = target

        # The paper's law: V = G (r - v), within the largest voltage, for the error is so.
        error = demand - actual
        distance = error
        limit = registers[base + ERROR_LIMIT]
        gain = registers[base + GAIN]
        if mode == BRAKE:
            limit = registers[base + BRAKE_LIMIT]
            gain = registers[base + BRAKE_GAIN]
        speed = actual
        if speed < 0:
            speed = 0 - speed
        idle = registers[base + IDLE_COUNT] == IDLE_TICKS
        if demand == 0 and idle and (mode == BRAKE or speed > SLOW_UM_S):
            limit = 0
        if error > limit:
            error = limit
        elif error < 0 - limit:
            error = 0 - limit
        voltage = error * gain >> 4

        # Watch over the axis. A count of ticks stands still at its limit.
        if low_supply == LOW_TICKS and mode != OFF:
            faults |= UNDERVOLTAGE

        current = registers[base + CURRENT] << widen >> widen
        if current < 0:
            current = 0 - current
        limit = registers[base + CURRENT_LIMIT]
        ticks = 0
        if limit != 0 and current > limit:
            ticks = registers[base + CURRENT_COUNT] + 1
            if ticks >= registers[base + CURRENT_TICKS]:
                ticks = registers[base + CURRENT_TICKS]
                faults |= OVER_CURRENT
        registers[base + CURRENT_COUNT] = ticks

        level = voltage
        if level < 0:
            level = 0 - level
        limit = registers[base + STALL_VOLTAGE]
        ticks = 0
        if mode != OFF and limit != 0 and level >= limit:
            ticks = registers[base + STALL_COUNT] + 1
            low = registers[base + STALL_SPAN]
            if ticks == 1 or count - registers[base + STALL_FROM] & 0xFFFF > low:
                registers[base + STALL_FROM] = count - (low >> 1)
                ticks = 1
            elif ticks >= registers[base + STALL_TICKS]:
                ticks = registers[base + STALL_TICKS]
                faults |= STALLED
        registers[base + STALL_COUNT] = ticks

        # Braking, a wheel turns against its voltage too, but it slows down.
        limit = registers[base + REVERSAL_VOLTAGE]
        against = (actual < 0 and voltage > 0) or (actual > 0 and voltage < 0)
        ticks = 0
        if mode != OFF and limit != 0 and level >= limit and against and speed >= REVERSAL_UM_S:
            ticks = registers[base + REVERSAL_COUNT] + 1
            high = registers[base + REVERSAL_PEAK]
            if ticks == 1 or speed > high:
                registers[base + REVERSAL_PEAK] = speed
            if speed + REVERSAL_DROP_UM_S < high:
                registers[base + REVERSAL_PEAK] = speed
                ticks = 1
            elif ticks >= registers[base + REVERSAL_TICKS]:
                ticks = registers[base + REVERSAL_TICKS]
                faults |= REVERSED
        registers[base + REVERSAL_COUNT] = ticks

        if distance < 0:
            distance = 0 - distance
        limit = registers[base + FOLLOWING_LIMIT]
        ticks = 0
        if mode != OFF and limit != 0 and distance > limit:
            ticks = registers[base + FOLLOWING_COUNT] + 1
            if ticks >= registers[base + FOLLOWING_TICKS]:
                ticks = registers[base + FOLLOWING_TICKS]
                faults |= FOLLOWING
        registers[base + FOLLOWING_COUNT] = ticks

        mean = registers[base + MEAN_VOLTAGE] << widen >> widen
        off = mode == OFF or faults != 0 or registers[CUT] != 0
        if mode == BRAKE and faults | STALE == STALE and registers[CUT] == 0:
            off = registers[base + STOP_COUNT] >= registers[BRAKE_TICKS]
        if off:
            demand = 0
        if off or low_supply != 0:
            voltage = 0
            mean = 0

        # New voltage speeds the wheel up before its encoder shows it.
        high = voltage - mean
        registers[base + MEAN_VOLTAGE] = mean + (high >> 4)
        registers[base + RATE] = rate + ((high + 2048 >> 12) * registers[base + FEED] >> 4)

        if inverted:
            voltage = 0 - voltage
        registers[base + DEMAND] = demand
        registers[base + VOLTAGE] = voltage

        # Report events to the background.
        signs = LOW_SUPPLY if low_supply == LOW_TICKS else 0
        if remaining < 0:
            remaining = 0 - remaining
        ticks = 0
        if remaining <= registers[base + WINDOW]:
            ticks = registers[base + NEAR_COUNT]
            if ticks >= registers[base + WINDOW_TICKS]:
                signs |= AT_TARGET
            else:
                ticks += 1
        registers[base + NEAR_COUNT] = ticks
        ticks = 0
        held = 0
        if speed < SLOW_UM_S:
            ticks = registers[base + SLOW_COUNT]
            limit = registers[base + WINDOW_TICKS]
            if ticks >= limit:
                signs |= STANDING
            if ticks < limit + HOLD_TICKS:
                ticks += 1
            else:
                held = 1
            if mode == STOP and demand == 0:
                signs |= STOPPED
        registers[base + SLOW_COUNT] = ticks
        limit = registers[BRAKE_TICKS]
        ticks = 0
        if mode >= STOP:
            ticks = registers[base + STOP_COUNT]
            if mode == BRAKE and demand == 0 and speed < SLOW_UM_S and ticks < limit - STILL_TICKS:
                ticks = limit - STILL_TICKS
            if ticks >= limit:
                signs |= STOPPED
            else:
                ticks += 1
        registers[base + STOP_COUNT] = ticks

        # Off means braked: 0 V with the bridges awake. It ends when the wheel has stood for a
        # while, so that the parcel on it rests too, or when time is over.
        ticks = 0
        if off:
            ticks = registers[base + BRAKE_COUNT]
            if registers[AWAKE] == 0 or (held != 0 and ticks >= HOLD_TICKS):
                ticks = limit
            if ticks < limit:
                ticks += 1
                awake = 1
        else:
            awake = 1
        registers[base + BRAKE_COUNT] = ticks
        if signs != registers[base + SIGNS] or faults != known:
            registers[ATTENTION] = 1
        registers[base + SIGNS] = signs
        registers[base + FAULTS] = faults
        base += AXIS
    registers[AWAKE] = awake
    ticks = registers[TICKS]
    registers[TICKS] = 0 if ticks == 0x3FFFFFFF else ticks + 1
