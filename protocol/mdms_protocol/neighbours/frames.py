"""Messages between cells in the eight bytes of a frame: estimates and pages of a program.

A frame is one little-endian number; its fields lie from bit 0 on in the order of the constants. It
is taken apart and put together in three pieces of 24, 24 and 16 bits, so that no number on the way
leaves a small int of 31 bits. Fields stand in any buffer of integers, and the frame in any buffer
of bytes, from `at` on: nothing is allocated.

`pack_...` clips values that do not fit, for the cell. `messages` checks values for the host.
`unpack_...` returns False, and leaves the fields as they were, for a frame that no sender makes.
"""
# MicroPython's module has no types; viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false
# mypy: disable-error-code="untyped-decorator"

from array import array

from mdms_protocol.compat import WIDEN, const, micropython, ptr8, ptr16, ptr32

try:
    from typing import TYPE_CHECKING
except ImportError:
    TYPE_CHECKING = False  # type: ignore[misc]
if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence

LENGTH = const(8)

#: Steps of the wire: 0.25 mm, a 4096th of a turn, 10 mm/s2 and 5 mm/s.
STEP_UM = const(250)
TURN = const(4096)
ACCELERATION_MM_S2 = const(10)
SPEED_MM_S = const(5)

# Fields of an estimate, all from the cell's own point of view
X = const(0)  # of the parcel's centre from the cell's own centre [STEP_UM], 12 bits, signed
Y = const(1)
YAW = const(2)  # [turns / TURN], 12 bits, signed
IDENTITY = const(3)  # of the parcel, 1 to 63; 0: none
STATE = const(4)  # below, 2 bits
WANTS = const(5)  # mask by direction of the neighbours that the parcel needs next
CERTAINTY = const(6)  # 0: no pose, else deviation 16 mm * 2^(-(c - 1) / 2), 4 bits
HOLD = const(7)  # hops from a cell that lacks a promise, up to HOLD_NONE
SEQUENCE = const(8)  # of the program that the cell holds, 1 to 3; 0: none
FLAGS = const(9)  # below, 3 bits
ESTIMATE_FIELDS = const(10)

# Values of STATE
NONE = const(0)
NEAR = const(1)  # believes, and is not promised
PROMISED = const(2)  # free for the parcel
UNDER = const(3)  # under the parcel

HOLD_NONE = const(5)

# Bits of the FLAGS of an estimate
ARRIVED = const(1)  # the parcel stands at its goal
LACKING = const(2)  # the cell lacks the parcel's data or program
CONTRADICTED = const(4)  # by a neighbour

# Fields of a page of a program. The first three are in each ...
PARCEL_IDENTITY = const(0)  # 1 to 63
PAGE = const(1)  # below, 2 bits
PROGRAM_SEQUENCE = const(2)  # 1 to 3
# ... and these in page PARCEL ...
SHAPE = const(3)  # RECTANGLE or DISC, 2 bits
PARCEL_LENGTH = const(4)  # [STEP_UM], 12 bits
PARCEL_WIDTH = const(5)
ACCELERATION = const(6)  # [ACCELERATION_MM_S2], 8 bits, at least 1: with 0 no ramp would end
SPEED = const(7)  # [SPEED_MM_S], 8 bits, at least 1
PROGRAM_FLAGS = const(8)  # below, 6 bits
# ... and these in pages PLACE and GOAL ...
PLACE_X = const(3)  # [STEP_UM; table frame], 18 bits, signed
PLACE_Y = const(4)
PLACE_YAW = const(5)  # [turns / TURN], 12 bits, signed
# ... and these in page GOAL.
LEG = const(6)  # 0 or JOINS: the goal; 1 to LEGS_MAX: where the leg so many after it ends, 3 bits
LEGS = const(7)  # how many legs follow the goal, up to LEGS_MAX, 3 bits
PROGRAM_FIELDS = const(9)

# Values of PAGE
PARCEL = const(0)
PLACE = const(1)  # where the parcel is now
GOAL = const(2)
END = const(3)  # the identity is dropped, and its programs

#: A way is given to cells up to so many legs beyond its goal.
LEGS_MAX = const(6)
#: As LEG: a goal on the way that the program before has; it ends the first leg that followed, or
#: comes before it, and all further legs stay.
JOINS = const(7)

# Values of SHAPE
RECTANGLE = const(0)
DISC = const(1)

# Bits of PROGRAM_FLAGS
GO_ON = const(1)  # the host's silence does not end the motion
ANY_YAW = const(2)  # the yaw at the goal does not matter

IDENTITY_MAX = const(63)
SEQUENCE_MAX = const(3)


#: Of a frame that is read alone, and its fields; there once, so that nothing is allocated.
_FRESH = bytearray(1)
_ROW = array("h", [0] * ESTIMATE_FIELDS)


def clipped(number: int, low: int, high: int) -> int:
    """The number within these limits that is next to it."""
    if number < low:
        return low
    return high if number > high else number


@micropython.viper
def pack_estimate(fields: ptr32, frame: ptr8, at: int):  # type: ignore[no-untyped-def]
    """Write the frame of an estimate; yaw wraps, and all else is clipped."""
    widen = int(WIDEN)
    x = fields[X] << widen >> widen
    y = fields[Y] << widen >> widen
    identity = fields[IDENTITY] << widen >> widen
    state = fields[STATE] << widen >> widen
    certainty = fields[CERTAINTY] << widen >> widen
    hold = fields[HOLD] << widen >> widen
    sequence = fields[SEQUENCE] << widen >> widen
    x = x if x > -2048 else -2048
    y = y if y > -2048 else -2048
    identity = identity if identity > 0 else 0
    state = state if state > 0 else 0
    certainty = certainty if certainty > 0 else 0
    hold = hold if hold > 0 else 0
    sequence = sequence if sequence > 0 else 0
    wants = fields[WANTS]
    low = (x if x < 2047 else 2047) & 0xFFF
    low |= ((y if y < 2047 else 2047) & 0xFFF) << 12
    middle = fields[YAW] & 0xFFF
    middle |= (identity if identity < IDENTITY_MAX else IDENTITY_MAX) << 12
    middle |= (state if state < UNDER else UNDER) << 18
    middle |= (wants & 0xF) << 20
    high = wants >> 4 & 0xF
    high |= (certainty if certainty < 15 else 15) << 4
    high |= (hold if hold < HOLD_NONE else HOLD_NONE) << 8
    high |= (sequence if sequence < SEQUENCE_MAX else SEQUENCE_MAX) << 11
    high |= (fields[FLAGS] & 7) << 13
    frame[at] = low & 0xFF
    frame[at + 1] = low >> 8 & 0xFF
    frame[at + 2] = low >> 16
    frame[at + 3] = middle & 0xFF
    frame[at + 4] = middle >> 8 & 0xFF
    frame[at + 5] = middle >> 16
    frame[at + 6] = high & 0xFF
    frame[at + 7] = high >> 8


def unpack_estimate(frame: "Sequence[int]", fields: "MutableSequence[int]") -> bool:
    """Read the frame of an estimate into the fields; returns False if it is none."""
    if len(frame) != LENGTH:
        return False
    _FRESH[0] = 1
    if read_estimates(frame, _FRESH, _ROW, 1):
        return False
    for field in range(ESTIMATE_FIELDS):
        fields[field] = _ROW[field]
    return True


@micropython.viper
def read_estimates(frames: ptr8, fresh: ptr8, fields: ptr16, count: int) -> int:
    """Read those frames of a row that are `fresh`, each into its place in fields of 16 bits.

    A frame that is no estimate changes nothing, and is not fresh any more. Returns the number of
    these.
    """
    wrong = 0
    base = 0
    for number in range(count):
        at = LENGTH * number
        high = frames[at + 6] | frames[at + 7] << 8
        if fresh[number] and high >> 8 & 7 > HOLD_NONE:
            fresh[number] = 0
            wrong += 1
        if fresh[number]:
            low = frames[at] | frames[at + 1] << 8 | frames[at + 2] << 16
            middle = frames[at + 3] | frames[at + 4] << 8 | frames[at + 5] << 16
            fields[base + X] = ((low & 0xFFF) ^ 0x800) - 0x800
            fields[base + Y] = (low >> 12 ^ 0x800) - 0x800
            fields[base + YAW] = ((middle & 0xFFF) ^ 0x800) - 0x800
            fields[base + IDENTITY] = middle >> 12 & 63
            fields[base + STATE] = middle >> 18 & 3
            fields[base + WANTS] = middle >> 20 | (high & 0xF) << 4
            fields[base + CERTAINTY] = high >> 4 & 15
            fields[base + HOLD] = high >> 8 & 7
            fields[base + SEQUENCE] = high >> 11 & 3
            fields[base + FLAGS] = high >> 13
        base += ESTIMATE_FIELDS
    return wrong


def pack_program(fields: "Sequence[int]", frame: "MutableSequence[int]", at: int = 0) -> None:
    """Write the frame of a page; yaw wraps, and all else is clipped."""
    page = fields[PAGE] & 3
    low = clipped(fields[PARCEL_IDENTITY], 0, IDENTITY_MAX) | page << 6
    low |= clipped(fields[PROGRAM_SEQUENCE], 0, SEQUENCE_MAX) << 8
    middle = 0
    high = 0
    if page == PARCEL:
        low |= clipped(fields[SHAPE], 0, DISC) << 10
        low |= clipped(fields[PARCEL_LENGTH], 0, 4095) << 12
        middle = clipped(fields[PARCEL_WIDTH], 0, 4095)
        middle |= clipped(fields[ACCELERATION], 0, 255) << 12
        speed = clipped(fields[SPEED], 0, 255)
        middle |= (speed & 0xF) << 20
        high = speed >> 4 | (fields[PROGRAM_FLAGS] & 63) << 4
    elif page != END:
        x = clipped(fields[PLACE_X], -131_072, 131_071)
        yaw = fields[PLACE_YAW] & 0xFFF
        low |= (x & 0x3FFF) << 10
        middle = x >> 14 & 0xF
        middle |= (clipped(fields[PLACE_Y], -131_072, 131_071) & 0x3FFFF) << 4
        middle |= (yaw & 3) << 22
        high = yaw >> 2
        if page == GOAL:
            high |= clipped(fields[LEG], 0, JOINS) << 10
            high |= clipped(fields[LEGS], 0, LEGS_MAX) << 13
    _write(low, middle, high, frame, at)


def unpack_program(frame: "Sequence[int]", fields: "MutableSequence[int]") -> bool:
    """Read the frame of a page into the fields that it has; returns False if it is none.

    A page is of an identity and has a sequence, and a parcel has a speed and an acceleration; the
    bits that its fields leave mean nothing.
    """
    if len(frame) != LENGTH:
        return False
    low = frame[0] | frame[1] << 8 | frame[2] << 16
    page = low >> 6 & 3
    if not low & 63 or not low >> 8 & 3 or (page == PARCEL and low >> 10 & 3 > DISC):
        return False
    middle = frame[3] | frame[4] << 8 | frame[5] << 16
    high = frame[6] | frame[7] << 8
    speed = middle >> 20 | (high & 0xF) << 4
    if page == PARCEL and not (speed and middle >> 12 & 0xFF):
        return False
    if page == GOAL and (high >> 13 > LEGS_MAX or high >> 13 < high >> 10 & 7 < JOINS):
        return False
    fields[PARCEL_IDENTITY] = low & 63
    fields[PAGE] = page
    fields[PROGRAM_SEQUENCE] = low >> 8 & 3
    if page == PARCEL:
        fields[SHAPE] = low >> 10 & 3
        fields[PARCEL_LENGTH] = low >> 12
        fields[PARCEL_WIDTH] = middle & 0xFFF
        fields[ACCELERATION] = middle >> 12 & 0xFF
        fields[SPEED] = speed
        fields[PROGRAM_FLAGS] = high >> 4 & 63
    elif page != END:
        fields[PLACE_X] = ((low >> 10 | (middle & 0xF) << 14) ^ 0x20000) - 0x20000
        fields[PLACE_Y] = ((middle >> 4 & 0x3FFFF) ^ 0x20000) - 0x20000
        fields[PLACE_YAW] = ((middle >> 22 | (high & 0x3FF) << 2) ^ 0x800) - 0x800
        if page == GOAL:
            fields[LEG] = high >> 10 & 7
            fields[LEGS] = high >> 13
    return True


def _write(low: int, middle: int, high: int, frame: "MutableSequence[int]", at: int) -> None:
    frame[at] = low & 0xFF
    frame[at + 1] = low >> 8 & 0xFF
    frame[at + 2] = low >> 16
    frame[at + 3] = middle & 0xFF
    frame[at + 4] = middle >> 8 & 0xFF
    frame[at + 5] = middle >> 16
    frame[at + 6] = high & 0xFF
    frame[at + 7] = high >> 8
