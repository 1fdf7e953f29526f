"""Turns of a parcel, in whole numbers.

An angle is the way of a point at `ARM_UM` from the centre [um], so that a pose is three lengths and
a twist three speeds. Sine and cosine are in 1/8192.
"""

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr32

ARM_UM = const(128_000)
ONE = const(8192)
#: A right angle is 201,061.93 um; a full turn is rounded once, so that the error does not add up.
QUARTER_UM = const(201_062)
TURN_UM = const(804_248)
#: A 32-bit board takes a larger number for a negative one.
ROOT_MAX = const(2_000_000_000)


def wrapped(turn_um):
    """The same angle within half a turn of 0 [um]."""
    return (turn_um + TURN_UM // 2) % TURN_UM - TURN_UM // 2


@micropython.viper
def resolve(turn_um: int, into: ptr32, at: int):
    """Write cosine and sine of an angle [um at the arm], in 1/8192, within 2 of them."""
    quarter = (turn_um + QUARTER_UM // 2) // QUARTER_UM
    # Radians in 1/8192, at most an eighth of a turn from a multiple of the right angle.
    near = (turn_um - quarter * QUARTER_UM) * 8 // 125
    square = near * near >> 13
    most = (ONE // 12 - square // 360) * square >> 13
    cosine = ONE - (square * (ONE // 2 - most // 2) >> 13)
    sine = near * (ONE - (square * (ONE - square // 20) >> 13) // 6) >> 13
    if quarter & 1:
        cosine, sine = 0 - sine, cosine
    if quarter & 2:
        cosine, sine = 0 - cosine, 0 - sine
    into[at] = cosine
    into[at + 1] = sine


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
