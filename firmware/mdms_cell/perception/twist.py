"""How a parcel moves, from the speeds of the wheels under it; wheels that slip count little.

A weighted least-squares fit of three speeds to those of all wheels, by four sweeps of Gauss-Seidel
with a little damping. A wheel's weight falls with its error, as in Cauchy's estimator.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.perception.heard import speed_um_s
from mdms_cell.perception.place import AXES
from mdms_protocol.compat import WIDEN, const, micropython, ptr32

#: An error of this size halves a wheel's weight, at least [um/s].
_SLIPPING_UM_S = const(3_000)
#: Errors above this count no more than it [um/s].
_CLIP_UM_S = const(65_000)
#: No parcel is faster or turns faster, and no wheel counts as faster [um/s]: so all fits 32 bits,
#: for parcels up to 0.6 m.
_MOST_UM_S = const(1_300_000)
_MOST_TURN_UM_S = const(500_000)
#: A broken neighbour may send any speed. One above this counts as this.
_ANY_UM_S = const(100_000_000)
#: Keeps a direction that no wheel shows where it was.
_RIDGE = const(8)

# Motion of wheels: a wheel or the parcel above it moves; a wheel does not turn with the parcel
TURNS = const(1)
SLIPS = const(2)

# Indices of `shown`, the result of the last fit
WHEELS = const(0)  # how many wheels there were
OFF = const(1)  # how far these were off the twist before, on the average [um/s]


class Twist:
    """The three `speeds` of a parcel; the last is that of a point at the arm of `angle` [um/s].

    `before` are the speeds of the beat before, and `shown` the last speeds of the wheels.
    """

    def __init__(self):
        self.speeds = array("i", [0] * 3)
        self.before = array("i", [0] * 3)
        self.shown = array("i", [0] * 2)

    def reset(self):
        """The parcel does not move, for all that is known."""
        for axis in range(3):
            self.speeds[axis] = self.before[axis] = 0
        self.shown[WHEELS] = self.shown[OFF] = 0


@micropython.viper
def fit(  # noqa: PLR0915, PLR0917 - one thought, and viper takes words
    speeds: ptr32, before: ptr32, shown: ptr32, along: ptr32, levers: ptr32, frames, wheels: int
):
    """Move the twist towards the speeds of the wheels in a mask, by their frames in a `Heard`.

    The twist keeps its part in a direction that no wheel shows.
    """
    widen = int(WIDEN)
    vx = speeds[0] << widen >> widen
    vy = speeds[1] << widen >> widen
    turn = speeds[2] << widen >> widen
    before[0] = vx
    before[1] = vy
    before[2] = turn
    slip = shown[OFF] * 3 // 2
    slip = slip if slip > _SLIPPING_UM_S else _SLIPPING_UM_S
    # Sums of the normal equations: of products of directions, and of directions with errors.
    xx = xy = xt = yy = yt = tt = 0
    rx = ry = rt = 0
    errors = count = 0
    wheel = 0
    while wheels >> wheel:
        if wheels >> wheel & 1:
            axis = wheel & 1
            along_x = along[2 * axis] << widen >> widen
            along_y = along[2 * axis + 1] << widen >> widen
            lever = levers[wheel] << widen >> widen
            error = int(speed_um_s(frames, wheel, _MOST_UM_S))
            error -= along_x * vx + along_y * vy + lever * turn >> 9
            size = error if error > 0 else 0 - error
            errors += size
            count += 1
            weight = 64 * slip // (slip + size) * slip // (slip + size)
            if error > _CLIP_UM_S:
                error = _CLIP_UM_S
            elif error < -_CLIP_UM_S:
                error = -_CLIP_UM_S
            error = weight * error >> 6
            xx += weight * along_x * along_x >> 15
            xy += weight * along_x * along_y >> 15
            xt += weight * along_x * lever >> 15
            yy += weight * along_y * along_y >> 15
            yt += weight * along_y * lever >> 15
            tt += weight * lever * lever >> 15
            rx += along_x * error
            ry += along_y * error
            rt += lever * error
        wheel += 1
    shown[WHEELS] = count
    dx = dy = dt = 0
    if count:
        shown[OFF] = errors // count
        for _ in range(4):
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
    speeds[0] = vx
    speeds[1] = vy
    speeds[2] = turn


@micropython.native
def against(speeds, footprint, frames, direction, axes):
    """Return how the wheels of a cell in a mask move: TURNS, SLIPS, or both; see `fit`.

    A wheel slips that is off the parcel's motion by 12 mm/s and a quarter of its own.
    """
    shown = 0
    for axis in range(AXES):
        if axes >> axis & 1:
            expected = footprint.wheel_speed(direction, axis, speeds)
            speed = speed_um_s(frames, AXES * direction + axis, _ANY_UM_S)
            slip = 12_000 + abs(expected) // 4
            # At rest a wheel that cannot turn agrees with everything.
            if max(abs(expected), abs(speed)) > slip:
                shown |= TURNS
            if abs(speed - expected) > slip:
                shown |= SLIPS
    return shown
