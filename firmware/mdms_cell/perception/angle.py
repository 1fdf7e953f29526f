"""Turns of a parcel, in whole numbers.

An angle is the way of a point at `ARM_UM` from the centre [um], so that a pose is three lengths and
a twist three speeds.
"""

from mdms_protocol.compat import const, micropython
from mdms_protocol.neighbours import frames as wire

ARM_UM = const(128_000)
#: Sine and cosine are in parts of this.
ONE = const(8192)
#: A right angle is 201,061.93 um; a full turn is rounded once, so that the error does not add up.
QUARTER_UM = const(201_062)
TURN_UM = const(804_248)
#: A 32-bit board takes a larger number for a negative one.
ROOT_MAX = const(2_000_000_000)


@micropython.native
def wrapped(turn_um):
    """The same angle within half a turn of 0 [um]."""
    return (turn_um + TURN_UM // 2) % TURN_UM - TURN_UM // 2


@micropython.native
def turn_um(yaw):
    """An angle of the wire as the way of a point at the arm [um]."""
    return yaw * (TURN_UM // 8) // (wire.TURN // 8)


@micropython.native
def yaw(turn_um):
    """The nearest angle of the wire, for the way of a point at the arm [um]."""
    return (turn_um * (wire.TURN // 8) + TURN_UM // 16) // (TURN_UM // 8)


@micropython.viper
def root(number: int) -> int:
    """The square root of a number from 0 to ROOT_MAX, rounded down."""
    if number < 2:
        return number
    guess = 1
    rest = number
    while rest > 3:
        rest >>= 2
        guess <<= 1
    guess = (guess + number // guess) >> 1
    guess = (guess + number // guess) >> 1
    guess = (guess + number // guess) >> 1
    while guess * guess > number:
        guess -= 1
    return guess
