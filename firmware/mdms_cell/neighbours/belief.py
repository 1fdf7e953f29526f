"""Where a cell believes its parcel to be: rolled on by the wheels, corrected at edges, agreed.

A Kalman filter over the pose (x, y, turn) [um; from the cell's own centre, turn at the arm of
`angle`] in whole numbers of 32 bits. Variances are in squares of 1/16 mm.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr32

from array import array

from mdms_cell.neighbours.geometry.angle import TURN_UM
from mdms_cell.neighbours.geometry.outline import (
    LEVER,
    NORMAL_X,
    NORMAL_Y,
    STEP_UM,
    Outline,
    place,
)
from mdms_cell.neighbours.twist import BEFORE
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.words import WIDEN

#: How well an edge is known at the instant a sensor changes, and while one contradicts.
EDGE = const(16 * 16)
CONTRADICTION = const(32 * 32)
#: Variance at the start, and the most and the least that there is.
_START = const(128 * 128)
_MOST = const(384 * 384)
_LEAST = const(6 * 6)
#: A way so long adds one to the variances: a tenth of it is slip, in steps of 25 mm.
_WAY_UM = const(15)
#: An edge so many standard deviations away is not believed, nor one so far [steps of 16 um].
_GATE = const(25)
_FAR = const(2500)

#: `STEP_UM` in 1/16 mm is so many parts of 62.
_STEP = const(16)
assert _STEP == STEP_UM

#: In the registers of a twist, where the one before begins; its speeds are in the order of a pose.
_BEFORE = const(5)
assert _BEFORE == BEFORE

# Registers of a belief
X = const(0)  # the pose [um]
Y = const(1)
TURN = const(2)
_XX = const(3)  # variances and covariances
_YY = const(4)
_TT = const(5)
_XY = const(6)
_XT = const(7)
_YT = const(8)
_WAY = const(9)  # that has made nothing less sure yet [um]
_REGISTERS = const(10)


class Belief:
    """Pose and variances of the parcel with this outline.

    X, Y and TURN of its `registers` are the pose, if it is `known`.
    """

    def __init__(self, outline=None):
        self.outline = outline or Outline()
        self.registers = array("i", [0] * _REGISTERS)
        self.drop()

    def drop(self):
        """There is no parcel."""
        self.known = False
        self._begin(0, 0, 0, _START)

    def start(self, x_um, y_um, turn_um, variance=_START):
        """Take a pose from somebody else."""
        self.known = True
        self._begin(x_um, y_um, turn_um, min(variance, _MOST))
        self.place()

    def _begin(self, x_um, y_um, turn_um, variance):
        registers = self.registers
        for number in range(_REGISTERS):
            registers[number] = 0
        registers[X], registers[Y], registers[TURN] = x_um, y_um, turn_um
        registers[_XX] = registers[_YY] = registers[_TT] = variance

    @micropython.native
    def place(self):
        """Place the outline where the parcel is."""
        registers = self.registers
        place(self.outline.registers, registers[X], registers[Y], registers[TURN])

    def variance(self):
        """The mean of the three variances."""
        registers = self.registers
        return (registers[_XX] + registers[_YY] + registers[_TT]) // 3

    def roll(self, twist, halves_per_s):
        """The parcel has moved by a twist, and by the one before, each for half of the time.

        `twist` is the registers of a `TwistFit`; halves of that time go so often into a second.
        `place` is left to the caller.
        """
        _roll(self.registers, twist, halves_per_s)

    def correct(self, x, y, error, exact=True):
        """The parcel's edge is over a point [steps]; returns False if that is not believed.

        `error` is the variance of that.
        """
        off = self.outline.edge(x, y)
        if not _correct(self.registers, self.outline.registers, off, error, exact):
            return False
        self.place()
        return True

    def agree(self, sums, own_weight):
        """Move towards the beliefs of neighbours, this one having a weight of its own.

        `sums` are those of their weights, of weighted differences from this belief [4 um], and of
        variances. The mean of two beliefs is at least as good as the mean of their variances,
        however much they have in common. `place` is left to the caller.
        """
        _agree(self.registers, sums, own_weight)

    def send(self, twist, per_s, fields, sent):
        """Write the pose into an estimate, rolled on by a twist for a part of a second.

        Leaves it in `sent`, too [um]; returns the certainty.
        """
        return _send(self.registers, twist, per_s, fields, sent)


@micropython.viper
def _send(belief: ptr32, twist: ptr32, per_s: int, fields: ptr32, sent: ptr32) -> int:
    """See `Belief.send`; of certainty, 1 to 15, each step halves the variance."""
    widen = int(WIDEN)
    full = int(TURN_UM)
    step_um = int(wire.STEP_UM)
    for axis in range(3):
        speed = twist[axis] << widen >> widen
        sent[axis] = (belief[axis] << widen >> widen) + (speed + per_s // 2) // per_s
    fields[int(wire.X)] = ((sent[X] << widen >> widen) + step_um // 2) // step_um
    fields[int(wire.Y)] = ((sent[Y] << widen >> widen) + step_um // 2) // step_um
    turn = sent[TURN] << widen >> widen
    # The nearest angle of the wire; as in `program.turn_um`.
    fields[int(wire.YAW)] = (turn * (int(wire.TURN) // 8) + full // 16) // (full // 8)
    sent[TURN] = (turn + full // 2) % full - full // 2
    variance = (belief[_XX] + belief[_YY] + belief[_TT]) // 3
    certainty = 17
    while variance and certainty > 1:
        variance >>= 1
        certainty -= 1
    return certainty if certainty < 15 else 15


@micropython.viper
def _roll(belief: ptr32, twist: ptr32, halves_per_s: int):
    widen = int(WIDEN)
    full = int(TURN_UM)
    way = belief[_WAY]
    for axis in range(3):
        speed = (twist[axis] << widen >> widen) + (twist[_BEFORE + axis] << widen >> widen)
        moved = (speed + halves_per_s // 2) // halves_per_s
        belief[axis] += moved
        way += moved if moved > 0 else 0 - moved
    turn = belief[TURN] << widen >> widen
    belief[TURN] = (turn + full // 2) % full - full // 2
    belief[_WAY] = way % _WAY_UM
    for number in range(_XX, _TT + 1):
        variance = belief[number] + way // _WAY_UM
        belief[number] = variance if variance < _MOST else _MOST


@micropython.viper
def _correct(belief: ptr32, outline: ptr32, off: int, error: int, exact: bool) -> bool:
    widen = int(WIDEN)
    if off > _FAR or off < -_FAR:
        return False
    hx = outline[int(NORMAL_X)] << widen >> widen
    hy = outline[int(NORMAL_Y)] << widen >> widen
    ht = outline[int(LEVER)] << widen >> widen
    xy = belief[_XY] << widen >> widen
    xt = belief[_XT] << widen >> widen
    yt = belief[_YT] << widen >> widen
    sx = belief[_XX] * hx + xy * hy + xt * ht >> 10
    sy = xy * hx + belief[_YY] * hy + yt * ht >> 10
    st = xt * hx + yt * hy + belief[_TT] * ht >> 10
    # The sum hx * sx + hy * sy + ht * st >> 10, whose last product would not fit.
    variance = (hx * sx + hy * sy + ht * (st & 0x3FF) >> 10) + ht * (st >> 10) + error
    sixteenths = off * _STEP // 62
    square = sixteenths * sixteenths
    if square > _GATE * variance:
        for number in range(_XX, _TT + 1):
            doubted = belief[number] + (square >> 3)
            belief[number] = doubted if doubted < _MOST else _MOST
        return False
    gx = (sx << 10) // variance
    gy = (sy << 10) // variance
    gt = (st << 10) // variance
    full = int(TURN_UM)
    turn = (belief[TURN] << widen >> widen) + (gt * off >> 6)
    belief[X] += gx * off >> 6
    belief[Y] += gy * off >> 6
    belief[TURN] = (turn + full // 2) % full - full // 2
    if exact:
        xx = belief[_XX] - (gx * sx >> 10)
        yy = belief[_YY] - (gy * sy >> 10)
        tt = belief[_TT] - (gt * st >> 10)
        belief[_XX] = xx if xx > _LEAST else _LEAST
        belief[_YY] = yy if yy > _LEAST else _LEAST
        belief[_TT] = tt if tt > _LEAST else _LEAST
        belief[_XY] = xy - (gx * sy >> 10)
        belief[_XT] = xt - (gx * st >> 10)
        belief[_YT] = yt - (gy * st >> 10)
    return True


@micropython.viper
def _agree(belief: ptr32, sums: ptr32, own: int):
    widen = int(WIDEN)
    full = int(TURN_UM)
    weight = sums[0]
    total = weight + own
    for axis in range(3):
        off = (sums[1 + axis] << widen >> widen) * 4 // weight
        belief[axis] += off * weight // total
    turn = belief[TURN] << widen >> widen
    belief[TURN] = (turn + full // 2) % full - full // 2
    variance = sums[4] // weight
    for number in range(_XX, _TT + 1):
        belief[number] = (belief[number] * own + variance * weight) // total
    for number in range(_XY, _YT + 1):
        belief[number] = (belief[number] << widen >> widen) * own // total
