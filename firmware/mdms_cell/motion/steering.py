"""From a parcel's pose and goal to the twist that takes it there, as gently as its program asks."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from mdms_cell.perception import belief
from mdms_cell.perception.angle import ARM_UM, ROOT_MAX, TURN_UM, root
from mdms_cell.perception.outline import REACH
from mdms_protocol.compat import WIDEN, const, micropython, ptr32
from mdms_protocol.neighbours import frames as wire

# Registers of a steering
VX = const(0)  # the commanded twist [um/s], changed no faster than the program allows
VY = const(1)
TURN = const(2)
WISH = const(3)  # what it is to become, three numbers as well
LEFT = const(6)  # what is left to go: x, y and turn [um]; before `find_wish` the goal's place
ACCELERATION = const(9)  # of the program, as the wire has them
SPEED = const(10)
_FLAGS = const(11)
ARRIVED = const(12)  # 1 until the parcel is found outside twice the tolerance
_SETTLED = const(13)  # beats within the tolerance, up to _SETTLED_BEATS
_CHANGE = const(14)  # of the twist in this beat
REGISTERS = const(17)

#: The parcel has arrived within this, for so many beats; it is steered again outside twice as much.
_TOLERANCE_UM = const(2_000)
_TOLERANCE_TURN_UM = const(1_500)
_SETTLED_BEATS = const(30)
#: The same as a time [ms].
SETTLED_MS = const(300)
#: A beat may change the twist by at least this, whatever the program says: every ramp ends [um/s].
_CHANGE_MIN_UM_S = const(100)
#: Near the goal the speed is so many times the way left a second.
_STIFFNESS_PER_S = const(3)
#: Parts of a corner's way, in which turning and going are one motion.
_SHARE = const(64)
#: The longest way whose products with a speed are words [16 um].
_FAR = const(1 << 19)
#: The largest number of which `length` is exact.
_LONG = const(3_000_000)

# Shared constants, which would be looked up
_BELIEF_X = const(10)
_BELIEF_Y = const(11)
_BELIEF_TURN = const(12)
_REACH = const(31)
assert (_BELIEF_X, _BELIEF_Y, _BELIEF_TURN) == (belief.X, belief.Y, belief.TURN)
assert _REACH == REACH
_ARM_UM = const(128_000)
_TURN_UM = const(804_248)
assert (_ARM_UM, _TURN_UM) == (ARM_UM, TURN_UM)
_STEP_UM = const(250)
_TURN = const(4096)
_ACCELERATION_MM_S2 = const(10)
_SPEED_UM_S = const(5_000)
assert (_STEP_UM, _TURN, _ACCELERATION_MM_S2) == (wire.STEP_UM, wire.TURN, wire.ACCELERATION_MM_S2)
assert _SPEED_UM_S == wire.SPEED_MM_S * 1000
_ANY_YAW = const(2)
assert _ANY_YAW == wire.ANY_YAW


@micropython.viper
def find_wish(  # noqa: PLR0915 - it is one thought
    registers: ptr32, parcel: ptr32, x_um: int, y_um: int
):
    """Find what is left to go, whether the parcel has arrived, and the twist that takes it there.

    The program was read by `read_way`. The parcel's pose is from the cell's own centre, which is at
    `x_um` and `y_um`.
    """
    widen = int(WIDEN)
    x = (registers[LEFT] << widen >> widen) * _STEP_UM - x_um
    x -= parcel[_BELIEF_X] << widen >> widen
    y = (registers[LEFT + 1] << widen >> widen) * _STEP_UM - y_um
    y -= parcel[_BELIEF_Y] << widen >> widen
    # As `angle.turn_um`, within half a turn.
    turn = (registers[LEFT + 2] << widen >> widen) * (_TURN_UM // 8) // (_TURN // 8)
    turn += _TURN_UM // 2 - (parcel[_BELIEF_TURN] << widen >> widen)
    turn = turn % _TURN_UM - _TURN_UM // 2
    registers[LEFT] = x
    registers[LEFT + 1] = y
    registers[LEFT + 2] = turn
    if registers[_FLAGS] & _ANY_YAW:
        turn = 0
    near = _TOLERANCE_UM << registers[ARRIVED]
    near_turn = _TOLERANCE_TURN_UM << registers[ARRIVED]
    if 0 - near <= x <= near and 0 - near <= y <= near and 0 - near_turn <= turn <= near_turn:
        settled = registers[_SETTLED] + 1
        registers[_SETTLED] = settled if settled < _SETTLED_BEATS else _SETTLED_BEATS
        if settled >= _SETTLED_BEATS:
            registers[ARRIVED] = 1
    else:
        registers[_SETTLED] = 0
        registers[ARRIVED] = 0
    way = 1
    speed = 0
    if registers[ARRIVED] == 0:
        corner = parcel[_REACH] * _SHARE // _ARM_UM
        way = int(length(x, y, turn * (corner if corner else 1) // _SHARE))
        acceleration_mm_s2 = registers[ACCELERATION] * _ACCELERATION_MM_S2
        # As fast as it may go with this way left: never faster than it can brake.
        square = int(ROOT_MAX)
        if acceleration_mm_s2 == 0 or way <= square // acceleration_mm_s2:
            square = acceleration_mm_s2 * way
        speed = int(root(square)) * 316 // 10
        most = registers[SPEED] * _SPEED_UM_S
        speed = speed if speed < most else most
        most = _STIFFNESS_PER_S * way
        speed = speed if speed < most else most
        way = way >> 4 if way >> 4 else 1
    x >>= 4
    y >>= 4
    turn >>= 4
    while way > _FAR:
        way >>= 1
        x >>= 1
        y >>= 1
        turn >>= 1
    registers[WISH] = x
    registers[WISH + 1] = y
    registers[WISH + 2] = turn
    for axis in range(3):
        # Speed * part // way, in two pieces that words have room for.
        part = registers[WISH + axis] << widen >> widen
        upper = (speed >> 10) * part
        lower = (upper % way << 10) + (speed & 0x3FF) * part
        registers[WISH + axis] = (upper // way << 10) + lower // way


@micropython.viper
def approach(registers: ptr32, parcel: ptr32, may_go: int, step_ms: int) -> bool:
    """Bring the twist nearer to the wish, or to 0 if it may not go; returns whether it is 0."""
    widen = int(WIDEN)
    for axis in range(3):
        wish = registers[WISH + axis] << widen >> widen if may_go else 0
        registers[_CHANGE + axis] = wish - (registers[axis] << widen >> widen)
    x = registers[_CHANGE] << widen >> widen
    y = registers[_CHANGE + 1] << widen >> widen
    turn = registers[_CHANGE + 2] << widen >> widen
    if x or y or turn:
        corner = parcel[_REACH] * _SHARE // _ARM_UM
        size = int(length(x, y, turn * (corner if corner else 1) // _SHARE))
        most = registers[ACCELERATION] * _ACCELERATION_MM_S2 * step_ms
        most = most if most > _CHANGE_MIN_UM_S else _CHANGE_MIN_UM_S
        clipped = size > most
        size = size >> 4 if size >> 4 else 1
        most >>= 4
        for axis in range(3):
            change = registers[_CHANGE + axis] << widen >> widen
            if clipped:
                # Change * most // size, in pieces that words have room for.
                rest = change % size
                upper = (most >> 7) * rest
                lower = (upper % size << 7) + (most & 0x7F) * rest
                change = change // size * most + (upper // size << 7) + lower // size
            registers[axis] += change
    return registers[VX] | registers[VY] | registers[TURN] == 0


@micropython.viper
def length(x: int, y: int, z: int) -> int:
    """The length of a vector, within a part in a thousand or 16; beyond 3 m it is rougher."""
    longer = 0
    while x > _LONG or x < -_LONG or y > _LONG or y < -_LONG or z > _LONG or z < -_LONG:
        x >>= 1
        y >>= 1
        z >>= 1
        longer += 1
    x >>= 5
    y >>= 5
    z >>= 5
    # Squares of (4 * a + r), whose sum words may have no room for: of 16ths, and what is left.
    sixteenths = (x >> 2) * (x >> 2) + (y >> 2) * (y >> 2) + (z >> 2) * (z >> 2)
    rest = (x & 3) * (2 * x - (x & 3)) + (y & 3) * (2 * y - (y & 3)) + (z & 3) * (2 * z - (z & 3))
    if sixteenths + (rest + 15 >> 4) > int(ROOT_MAX) >> 4:
        return int(root(sixteenths + (rest >> 4))) << 7 + longer
    return int(root((sixteenths << 4) + rest)) << 5 + longer


@micropython.viper
def has_arrived(registers: ptr32) -> bool:
    """Whether the parcel stands at its goal."""
    return registers[ARRIVED] != 0 and registers[VX] | registers[VY] | registers[TURN] == 0
