"""How a parcel moves, from the speeds of the wheels under it; wheels that slip count little."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from mdms_cell.perception.angle import ARM_UM
from mdms_cell.perception.footprint import ALONG_X, ALONG_Y, POINT_X, POINT_Y, SHIFT
from mdms_cell.perception.outline import (
    COSINE,
    DISC,
    HALF_LENGTH,
    HALF_WIDTH,
    SHAPE,
    SINE,
    STEP_UM,
    X,
    Y,
)
from mdms_protocol.compat import WIDEN, const, micropython, ptr8, ptr32

# What is used in every beat; constants of another module would be looked up.
_X = const(0)
_Y = const(1)
_COSINE = const(2)
_SINE = const(3)
_SHAPE = const(4)
_HALF_LENGTH = const(5)
_HALF_WIDTH = const(6)
_DISC = const(1)
assert (_X, _Y, _COSINE, _SINE, _SHAPE) == (X, Y, COSINE, SINE, SHAPE)
assert (_HALF_LENGTH, _HALF_WIDTH, _DISC) == (HALF_LENGTH, HALF_WIDTH, DISC)
_POINT_Y = const(7)
_ALONG_X = const(14)
_ALONG_Y = const(16)
_SHIFT = const(18)
assert (0, _POINT_Y, _SHIFT) == (POINT_X, POINT_Y, SHIFT)
assert (_ALONG_X, _ALONG_Y) == (ALONG_X, ALONG_Y)
#: Where frames of speeds begin, see `heard`.
_SPEEDS = const(64)
_ARM = const(8000)
assert _ARM * STEP_UM == ARM_UM
#: An error of this size halves a wheel's weight, at least [um/s].
_SLIPPING_UM_S = const(3_000)
#: Errors above this count no more than it [um/s].
_CLIP_UM_S = const(65_000)
#: No parcel is faster or turns faster, and no wheel counts as faster [um/s]: so all fits 32 bits,
#: for parcels up to 0.6 m.
_MOST_UM_S = const(1_300_000)
_MOST_TURN_UM_S = const(500_000)
#: Keeps a direction that no wheel shows where it was.
_RIDGE = const(8)
_SWEEPS = const(4)

#: A wheel may be off the parcel's motion by this, and by a quarter of its own [um/s].
_SLIP_UM_S = const(12_000)
#: So fast is no wheel, and differences with it fit 32 bits [um/s].
_WILD_UM_S = const(100_000_000)

# What wheels show: that one or the parcel above it moves, that one does not turn with the parcel
TURNS = const(1)
SLIPS = const(2)

# Registers of a twist, behind those of the parcel's outline and belief
VX = const(23)  # speeds [um/s], the last one that of a point at the arm of `angle`
VY = const(24)
TURN = const(25)
WHEELS = const(26)  # how many wheels showed it at last
OFF = const(27)  # how far these were off the twist before, on the average [um/s]
BEFORE = const(28)  # the three speeds before
TWIST_END = const(31)


@micropython.viper
def fit(  # noqa: PLR0912, PLR0915 - it is one thought
    twist: ptr32, footprint: ptr32, frames: ptr8, mask: int
):
    """Move the twist towards what those wheels show that lie under the parcel.

    That is of the directions of a mask; the frames are those of a `Heard`. A direction that no
    wheel shows stays as it was.
    """
    widen = int(WIDEN)
    vx = twist[VX] << widen >> widen
    vy = twist[VY] << widen >> widen
    turn = twist[TURN] << widen >> widen
    twist[BEFORE] = vx
    twist[BEFORE + 1] = vy
    twist[BEFORE + 2] = turn
    # As in `footprint.points_within`.
    centre_x = twist[_X] << widen >> widen
    centre_y = twist[_Y] << widen >> widen
    cosine = twist[_COSINE] << widen >> widen
    sine = twist[_SINE] << widen >> widen
    length = twist[_HALF_LENGTH]
    width = twist[_HALF_WIDTH]
    disc = twist[_SHAPE] == _DISC
    radius = length + 3 >> 2
    slip = twist[OFF] * 3 // 2
    slip = slip if slip > _SLIPPING_UM_S else _SLIPPING_UM_S
    # Sums of the normal equations: of products of directions, and of directions with errors.
    xx = xy = xt = yy = yt = tt = 0
    rx = ry = rt = 0
    errors = count = 0
    wheel = 0
    while mask >> (wheel >> 1):
        if mask >> (wheel >> 1) & 1:
            axis = wheel & 1
            at = _SHIFT + wheel - axis
            x = (footprint[axis] << widen >> widen) - centre_x
            y = (footprint[_POINT_Y + axis] << widen >> widen) - centre_y
            x += footprint[at] << widen >> widen
            y += footprint[at + 1] << widen >> widen
            if disc:
                under = (x >> 2) * (x >> 2) + (y >> 2) * (y >> 2) < radius * radius
            else:
                along = cosine * x + sine * y >> 13
                across = cosine * y - sine * x >> 13
                under = 0 - length < along < length and 0 - width < across < width
            if under:
                along_x = footprint[_ALONG_X + axis] << widen >> widen
                along_y = footprint[_ALONG_Y + axis] << widen >> widen
                lever = (along_y * x - along_x * y) // _ARM
                at = _SPEEDS + 4 * wheel
                speed = frames[at] | frames[at + 1] << 8 | frames[at + 2] << 16
                speed |= ((frames[at + 3] ^ 0x80) - 0x80) << 24
                if speed > _MOST_UM_S:
                    speed = _MOST_UM_S
                elif speed < -_MOST_UM_S:
                    speed = -_MOST_UM_S
                error = speed - (along_x * vx + along_y * vy + lever * turn >> 9)
                size = error if error > 0 else 0 - error
                errors += size
                count += 1
                weight = 64 * slip // (slip + size) * slip // (slip + size)
                if error > _CLIP_UM_S:
                    error = _CLIP_UM_S
                elif error < -_CLIP_UM_S:
                    error = -_CLIP_UM_S
                error = weight * error >> 6
                # Wheels that lie along an axis, as nearly all do, add nothing to the other's sums.
                if along_x:
                    xx += weight * along_x * along_x >> 15
                    xt += weight * along_x * lever >> 15
                    rx += along_x * error
                if along_y:
                    xy += weight * along_x * along_y >> 15
                    yy += weight * along_y * along_y >> 15
                    yt += weight * along_y * lever >> 15
                    ry += along_y * error
                tt += weight * lever * lever >> 15
                rt += lever * error
        wheel += 1
    twist[WHEELS] = count
    dx = dy = dt = 0
    if count:
        twist[OFF] = errors // count
        for _ in range(_SWEEPS):
            dx = (rx - xy * dy - xt * dt) // (xx + _RIDGE)
            dy = (ry - xy * dx - yt * dt) // (yy + _RIDGE)
            dt = (rt - xt * dx - yt * dy) // (tt + _RIDGE)
    else:
        vx = vy = turn = 0
    vx += dx
    vy += dy
    turn += dt
    if vx > _MOST_UM_S or vx < -_MOST_UM_S or vy > _MOST_UM_S or vy < -_MOST_UM_S:
        vx = vy = turn = 0
    if turn > _MOST_TURN_UM_S or turn < -_MOST_TURN_UM_S:
        turn = 0
    twist[VX] = vx
    twist[VY] = vy
    twist[TURN] = turn


@micropython.viper
def against(twist: ptr32, footprint: ptr32, frames: ptr8, direction: int, mask: int) -> int:
    """What those wheels of a cell show that are in a mask: TURNS, SLIPS, or both; see `fit`."""
    widen = int(WIDEN)
    vx = twist[VX] << widen >> widen
    vy = twist[VY] << widen >> widen
    turn = twist[TURN] << widen >> widen
    shift_x = footprint[_SHIFT + 2 * direction] << widen >> widen
    shift_y = footprint[_SHIFT + 2 * direction + 1] << widen >> widen
    shift_x -= twist[_X] << widen >> widen
    shift_y -= twist[_Y] << widen >> widen
    shown = 0
    axis = 0
    while mask >> axis:
        if mask >> axis & 1:
            along_x = footprint[_ALONG_X + axis] << widen >> widen
            along_y = footprint[_ALONG_Y + axis] << widen >> widen
            x = (footprint[axis] << widen >> widen) + shift_x
            y = (footprint[_POINT_Y + axis] << widen >> widen) + shift_y
            lever = (along_y * x - along_x * y) // _ARM
            expected = along_x * vx + along_y * vy + lever * turn >> 9
            at = _SPEEDS + 8 * direction + 4 * axis
            speed = frames[at] | frames[at + 1] << 8 | frames[at + 2] << 16
            speed |= ((frames[at + 3] ^ 0x80) - 0x80) << 24
            # What a broken neighbour sends may be anything.
            if speed > _WILD_UM_S:
                speed = _WILD_UM_S
            elif speed < -_WILD_UM_S:
                speed = -_WILD_UM_S
            off = speed - expected if speed > expected else expected - speed
            speed = speed if speed > 0 else 0 - speed
            expected = expected if expected > 0 else 0 - expected
            slip = _SLIP_UM_S + expected // 4
            # At rest a wheel that cannot turn agrees with everything.
            if expected > slip or speed > slip:
                shown |= TURNS
            if off > slip:
                shown |= SLIPS
        axis += 1
    return shown
