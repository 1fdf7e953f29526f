"""Where a cell believes its parcel to be: rolled on by the wheels, corrected at edges, agreed.

A Kalman filter over the pose (x, y, turn) [um; from the cell's own centre, turn at the arm of
`angle`] in whole numbers of 32 bits. Variances are in squares of 1/16 mm.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from mdms_cell.perception.angle import TURN_UM
from mdms_cell.perception.outline import (
    LEVER,
    NORMAL_X,
    NORMAL_Y,
    REGISTERS,
    STEP_UM,
    Outline,
    place,
)
from mdms_cell.perception.twist import BEFORE, TWIST_END, VX
from mdms_protocol.compat import WIDEN, const, micropython, ptr32
from mdms_protocol.neighbours import frames as wire

#: How well an edge is known at the instant a sensor changes, and while one contradicts.
EDGE = const(16 * 16)
CONTRADICTION = const(32 * 32)
#: Variance at the start, and the most and the least that there is.
_START = const(128 * 128)
_MOST = const(384 * 384)
_LEAST = const(6 * 6)
#: Of a parcel no edge has been seen while its variances along both axes are at least this.
UNSEEN = const(_START // 2)
#: A way so long adds one to the variances: a tenth of it is slip, in steps of 25 mm.
_WAY_UM = const(15)
#: An edge so many standard deviations away is not believed, nor one so far [steps of 16 um].
_GATE = const(25)
_FAR = const(2500)

# What is used in every beat; constants of another module would be looked up.
_FULL = const(804_248)  # a full turn
_X_AT = const(0)  # fields of an estimate
_Y_AT = const(1)
_YAW_AT = const(2)
_YAW_FULL = const(4096)
_STEP_UM = const(250)
assert (_FULL, _YAW_FULL, _STEP_UM) == (TURN_UM, wire.TURN, wire.STEP_UM)
assert (_X_AT, _Y_AT, _YAW_AT) == (wire.X, wire.Y, wire.YAW)

#: `STEP_UM` in 1/16 mm is so many parts of 62.
_STEP = const(16)
assert _STEP == STEP_UM

# Registers of a belief, behind those of its outline; speeds of a twist are in the order of a pose
X = const(10)  # the pose [um]
Y = const(11)
TURN = const(12)
_XX = const(13)  # variances and covariances
_YY = const(14)
_TT = const(15)
_XY = const(16)
_XT = const(17)
_YT = const(18)
_WAY = const(19)  # that has made nothing less sure yet [um]
SENT = const(20)  # three: the pose that was sent last
assert (X, SENT + 3) == (REGISTERS, VX)
_TWIST = const(23)
_BEFORE = const(28)
assert (_TWIST, _BEFORE) == (VX, BEFORE)


class Belief(Outline):
    """The outline of a parcel where it is believed to be, with pose, variances and twist.

    X, Y and TURN of its `registers` are the pose, if it is `known`; VX and the next two the twist.
    """

    def __init__(self):
        super().__init__()
        self.drop()

    def drop(self):
        """There is no parcel."""
        self.known = False
        self._begin(0, 0, 0, _START)

    def start(self, x_um, y_um, turn_um, variance=_START):
        """Take a pose from somebody else."""
        self.known = True
        self._begin(x_um, y_um, turn_um, min(variance, _MOST))
        self.move_outline()

    def _begin(self, x_um, y_um, turn_um, variance):
        registers = self.registers
        for number in range(_XY, _WAY + 1):
            registers[number] = 0
        registers[X], registers[Y], registers[TURN] = x_um, y_um, turn_um
        registers[_XX] = registers[_YY] = registers[_TT] = variance

    @micropython.native
    def move_outline(self):
        """Place the outline where the parcel is."""
        registers = self.registers
        place(registers, registers[X], registers[Y], registers[TURN])

    def variance(self):
        """The mean of the three variances."""
        registers = self.registers
        return (registers[_XX] + registers[_YY] + registers[_TT]) // 3

    def is_unseen(self):
        """Whether no edge of the parcel has been seen since it was put there."""
        registers = self.registers
        return registers[_XX] >= UNSEEN and registers[_YY] >= UNSEEN

    def correct(self, x, y, error, exact=True):
        """The parcel's edge is over a point [steps]; returns False if that is not believed.

        `error` is the variance of that.
        """
        off = self.edge(x, y)
        if not _correct(self.registers, off, error, exact):
            return False
        self.move_outline()
        return True

    def rest(self):
        """The parcel does not move, for all that is known."""
        for number in range(VX, TWIST_END):
            self.registers[number] = 0

    @micropython.native
    def speeds(self):
        """The twist."""
        registers = self.registers
        return registers[VX], registers[VX + 1], registers[VX + 2]

    def speed(self):
        """The sum of the sizes of its three speeds."""
        vx, vy, turn = self.speeds()
        return abs(vx) + abs(vy) + abs(turn)


@micropython.viper
def send(belief: ptr32, per_s: int, fields: ptr32) -> int:
    """Write the pose into an estimate, rolled on by the twist for a part of a second.

    Leaves it in `SENT`, too; returns the certainty, 1 to 15: each step halves the variance.
    """
    widen = int(WIDEN)
    for axis in range(3):
        speed = belief[_TWIST + axis] << widen >> widen
        pose = (belief[X + axis] << widen >> widen) + (speed + per_s // 2) // per_s
        belief[SENT + axis] = pose
    x = belief[SENT] << widen >> widen
    y = belief[SENT + 1] << widen >> widen
    turn = belief[SENT + 2] << widen >> widen
    belief[SENT + 2] = (turn + _FULL // 2) % _FULL - _FULL // 2
    fields[_X_AT] = (x + _STEP_UM // 2) // _STEP_UM
    fields[_Y_AT] = (y + _STEP_UM // 2) // _STEP_UM
    # The nearest angle of the wire; as in `angle.turn_um`.
    fields[_YAW_AT] = (turn * (_YAW_FULL // 8) + _FULL // 16) // (_FULL // 8)
    variance = (belief[_XX] + belief[_YY] + belief[_TT]) // 3
    certainty = 17
    while variance and certainty > 1:
        variance >>= 1
        certainty -= 1
    return certainty if certainty < 15 else 15


@micropython.viper
def roll(belief: ptr32, halves_per_s: int):
    """The parcel has moved by its twist, and by the one before, each for half of the time.

    Halves of that time go so often into a second. Its outline is left to be placed.
    """
    widen = int(WIDEN)
    way = belief[_WAY]
    for axis in range(3):
        speed = belief[_TWIST + axis] << widen >> widen
        speed += belief[_BEFORE + axis] << widen >> widen
        moved = (speed + halves_per_s // 2) // halves_per_s
        belief[X + axis] += moved
        way += moved if moved > 0 else 0 - moved
    turn = belief[TURN] << widen >> widen
    belief[TURN] = (turn + _FULL // 2) % _FULL - _FULL // 2
    belief[_WAY] = way % _WAY_UM
    for number in range(_XX, _TT + 1):
        variance = belief[number] + way // _WAY_UM
        belief[number] = variance if variance < _MOST else _MOST


@micropython.viper
def _correct(belief: ptr32, off: int, error: int, exact: bool) -> bool:
    widen = int(WIDEN)
    if off > _FAR or off < -_FAR:
        return False
    hx = belief[int(NORMAL_X)] << widen >> widen
    hy = belief[int(NORMAL_Y)] << widen >> widen
    ht = belief[int(LEVER)] << widen >> widen
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
    turn = (belief[TURN] << widen >> widen) + (gt * off >> 6)
    belief[X] += gx * off >> 6
    belief[Y] += gy * off >> 6
    belief[TURN] = (turn + _FULL // 2) % _FULL - _FULL // 2
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
def agree(belief: ptr32, sums: ptr32, own: int):
    """Move towards the beliefs of neighbours, this one having a weight of its own.

    `sums` are those of their weights, of weighted differences from this belief [4 um], and of
    variances. The mean of two beliefs is at least as good as the mean of their variances, however
    much they have in common. The outline is left to be placed.
    """
    widen = int(WIDEN)
    weight = sums[0]
    total = weight + own
    for axis in range(3):
        off = (sums[1 + axis] << widen >> widen) * 4 // weight
        belief[X + axis] += off * weight // total
    turn = belief[TURN] << widen >> widen
    belief[TURN] = (turn + _FULL // 2) % _FULL - _FULL // 2
    variance = sums[4] // weight
    for number in range(_XX, _TT + 1):
        belief[number] = (belief[number] * own + variance * weight) // total
    for number in range(_XY, _YT + 1):
        belief[number] = (belief[number] << widen >> widen) * own // total
