"""Where a cell believes its parcel to be: rolled on by the wheels, corrected at edges, agreed.

A Kalman filter over the pose (x, y, turn) [um; from the cell's own centre, turn at the arm of
`angle`] in whole numbers. Variances are in squares of 1/16 mm.
"""

try:
    import micropython
except ImportError:
    from mdms_cell.cpython import micropython

try:
    from micropython import const
except ImportError:
    from mdms_cell.cpython import const

from mdms_cell.neighbours.angle import wrapped
from mdms_cell.neighbours.outline import STEP_UM, Outline

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


class Belief:
    """Pose and variances of the parcel with this outline; `certainty` is 0 without a pose."""

    def __init__(self, outline=None):
        self.outline = outline or Outline()
        self.drop()

    def drop(self):
        """There is no parcel."""
        self.known = False
        self.x = self.y = self.turn = 0
        self._way = 0
        self._spread(_START)

    def start(self, x_um, y_um, turn_um, variance=_START):
        """Take a pose from somebody else."""
        self.known = True
        self.x, self.y, self.turn = x_um, y_um, turn_um
        self._way = 0
        self._spread(min(variance, _MOST))
        self._place()

    def _spread(self, variance):
        self.xx = self.yy = self.tt = variance
        self.xy = self.xt = self.yt = 0

    def _place(self):
        self.outline.place(self.x, self.y, self.turn)

    @property
    def variance(self):
        """The mean of the three variances."""
        return (self.xx + self.yy + self.tt) // 3

    def roll(self, dx_um, dy_um, dturn_um):
        """The parcel has moved."""
        self.x += dx_um
        self.y += dy_um
        self.turn = wrapped(self.turn + dturn_um)
        self._way += abs(dx_um) + abs(dy_um) + abs(dturn_um)
        more = self._way // _WAY_UM
        self._way -= more * _WAY_UM
        self._doubt(more)
        self._place()

    @micropython.native
    def correct(self, x, y, error, exact=True):
        """The parcel's edge is over a point [steps]; returns False if that is not believed.

        `error` is the variance of that.
        """
        off = self.outline.edge(x, y)
        if abs(off) > _FAR:
            return False
        hx, hy, ht = self.outline.normal_x, self.outline.normal_y, self.outline.lever
        sx = self.xx * hx + self.xy * hy + self.xt * ht >> 10
        sy = self.xy * hx + self.yy * hy + self.yt * ht >> 10
        st = self.xt * hx + self.yt * hy + self.tt * ht >> 10
        variance = (hx * sx + hy * sy + ht * st >> 10) + error
        sixteenths = off * STEP_UM // 62
        square = sixteenths * sixteenths
        if square > _GATE * variance:
            self._doubt(square >> 3)
            return False
        gx = (sx << 10) // variance
        gy = (sy << 10) // variance
        gt = (st << 10) // variance
        self.x += gx * off >> 6
        self.y += gy * off >> 6
        self.turn = wrapped(self.turn + (gt * off >> 6))
        self._place()
        if not exact:
            return True
        self.xx = max(self.xx - (gx * sx >> 10), _LEAST)
        self.yy = max(self.yy - (gy * sy >> 10), _LEAST)
        self.tt = max(self.tt - (gt * st >> 10), _LEAST)
        self.xy -= gx * sy >> 10
        self.xt -= gx * st >> 10
        self.yt -= gy * st >> 10
        return True

    def _doubt(self, more):
        self.xx = min(self.xx + more, _MOST)
        self.yy = min(self.yy + more, _MOST)
        self.tt = min(self.tt + more, _MOST)

    def agree(self, weight, total, difference_um, variance):
        """Move by a share weight/total of what the neighbours' beliefs differ on the average.

        `difference_um` is that of x, y and turn, `variance` their mean. The mean of two beliefs is
        at least as good as the mean of their variances, however much they have in common.
        """
        own = total - weight
        x_um, y_um, turn_um = difference_um
        self.x += x_um * weight // total
        self.y += y_um * weight // total
        self.turn = wrapped(self.turn + turn_um * weight // total)
        self.xx = (self.xx * own + variance * weight) // total
        self.yy = (self.yy * own + variance * weight) // total
        self.tt = (self.tt * own + variance * weight) // total
        self.xy = self.xy * own // total
        self.xt = self.xt * own // total
        self.yt = self.yt * own // total
        self._place()
