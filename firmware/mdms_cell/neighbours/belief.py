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
from mdms_cell.neighbours.geometry.outline import LEVER, NORMAL_X, NORMAL_Y, STEP_UM, Outline
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

# Registers of a belief
_X = const(0)  # the pose [um]
_Y = const(1)
_TURN = const(2)
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

    `x`, `y` and `turn` are the pose, if it is `known`.
    """

    def __init__(self, outline=None):
        self.outline = outline or Outline()
        self._registers = array("i", [0] * _REGISTERS)
        self.drop()

    def drop(self):
        """There is no parcel."""
        self.known = False
        self._begin(0, 0, 0, _START)

    def start(self, x_um, y_um, turn_um, variance=_START):
        """Take a pose from somebody else."""
        self.known = True
        self._begin(x_um, y_um, turn_um, min(variance, _MOST))
        self._place()

    def _begin(self, x_um, y_um, turn_um, variance):
        registers = self._registers
        for place in range(_REGISTERS):
            registers[place] = 0
        registers[_X], registers[_Y], registers[_TURN] = x_um, y_um, turn_um
        registers[_XX] = registers[_YY] = registers[_TT] = variance
        self._read()

    def _read(self):
        registers = self._registers
        self.x, self.y, self.turn = registers[_X], registers[_Y], registers[_TURN]

    def _place(self):
        self._read()
        self.outline.place(self.x, self.y, self.turn)

    def variance(self):
        """The mean of the three variances."""
        registers = self._registers
        return (registers[_XX] + registers[_YY] + registers[_TT]) // 3

    def certainty(self):
        """As it is sent, 1 to 15: each step halves the variance."""
        return _certainty(self.variance())

    def roll(self, dx_um, dy_um, dturn_um):
        """The parcel has moved."""
        _roll(self._registers, dx_um, dy_um, dturn_um)
        self._place()

    def correct(self, x, y, error, exact=True):
        """The parcel's edge is over a point [steps]; returns False if that is not believed.

        `error` is the variance of that.
        """
        off = self.outline.edge(x, y)
        if not _correct(self._registers, self.outline.registers, off, error, exact):
            return False
        self._place()
        return True

    def agree(  # noqa: PLR0917 - as in `_agree`
        self, weight, total, x_um, y_um, turn_um, variance
    ):
        """Move by a share weight/total of what the neighbours' beliefs differ on the average.

        That is by `x_um`, `y_um` and `turn_um`; `variance` is their mean. The mean of two beliefs
        is at least as good as the mean of their variances, however much they have in common.
        """
        _agree(self._registers, x_um, y_um, turn_um, weight, total, variance)
        self._place()


@micropython.viper
def _certainty(variance: int) -> int:
    certainty = 17
    while variance and certainty > 1:
        variance >>= 1
        certainty -= 1
    return certainty if certainty < 15 else 15


@micropython.viper
def _roll(belief: ptr32, dx_um: int, dy_um: int, dturn_um: int):
    widen = int(WIDEN)
    full = int(TURN_UM)
    turn = (belief[_TURN] << widen >> widen) + dturn_um
    belief[_X] += dx_um
    belief[_Y] += dy_um
    belief[_TURN] = (turn + full // 2) % full - full // 2
    way = belief[_WAY] + (dx_um if dx_um > 0 else 0 - dx_um)
    way += dy_um if dy_um > 0 else 0 - dy_um
    way += dturn_um if dturn_um > 0 else 0 - dturn_um
    belief[_WAY] = way % _WAY_UM
    for place in range(_XX, _TT + 1):
        variance = belief[place] + way // _WAY_UM
        belief[place] = variance if variance < _MOST else _MOST


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
        for place in range(_XX, _TT + 1):
            doubted = belief[place] + (square >> 3)
            belief[place] = doubted if doubted < _MOST else _MOST
        return False
    gx = (sx << 10) // variance
    gy = (sy << 10) // variance
    gt = (st << 10) // variance
    full = int(TURN_UM)
    turn = (belief[_TURN] << widen >> widen) + (gt * off >> 6)
    belief[_X] += gx * off >> 6
    belief[_Y] += gy * off >> 6
    belief[_TURN] = (turn + full // 2) % full - full // 2
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
def _agree(  # noqa: PLR0917 - viper takes words
    belief: ptr32, x_um: int, y_um: int, turn_um: int, weight: int, total: int, variance: int
):
    widen = int(WIDEN)
    full = int(TURN_UM)
    own = total - weight
    turn = (belief[_TURN] << widen >> widen) + turn_um * weight // total
    belief[_X] += x_um * weight // total
    belief[_Y] += y_um * weight // total
    belief[_TURN] = (turn + full // 2) % full - full // 2
    for place in range(_XX, _TT + 1):
        belief[place] = (belief[place] * own + variance * weight) // total
    for place in range(_XY, _YT + 1):
        belief[place] = (belief[place] << widen >> widen) * own // total
