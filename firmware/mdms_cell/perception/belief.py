"""The believed place of a parcel: rolled on by wheels, corrected at edges, agreed.

It is an extended Kalman filter over the pose (x, y, turn) in whole numbers of 32 bits. The pose is
in um from the cell's own centre, the turn at the arm of `angle`. Variances are in squares of 1/16
mm.
"""

from array import array

from mdms_cell.perception.angle import wrapped, yaw
from mdms_cell.perception.outline import Outline
from mdms_cell.perception.twist import Twist
from mdms_protocol.compat import const, micropython
from mdms_protocol.neighbours import frames as wire

#: How well an edge is known at the instant a sensor changes, and while one contradicts.
EDGE = const(16 * 16)
CONTRADICTION = const(32 * 32)
#: Variance at the start, and the most and the least that there is.
START = const(128 * 128)
MOST = const(384 * 384)
_LEAST = const(6 * 6)
#: A way so long adds one to the variances: a tenth of it is slip, in steps of 25 mm.
_WAY_UM = const(15)

# Numbers of a covariance: the three variances come first
XX = const(0)
YY = const(1)
TT = const(2)
XY = const(3)
XT = const(4)
YT = const(5)


class Belief(Outline):
    """The outline of a parcel at its believed place, with pose, covariance and twist.

    `pose` counts if it is `known`. `sent` is the last pose that was sent. `way_um` is the way that
    is still to be added to the uncertainty.
    """

    def __init__(self):
        super().__init__()
        self.pose = array("i", [0] * 3)
        self.covariance = array("i", [0] * 6)
        self.sent = array("i", [0] * 3)
        self.twist = Twist()
        self.reset()

    def reset(self):
        """There is no parcel."""
        self.drop()
        self.twist.reset()
        for axis in range(3):
            self.sent[axis] = 0

    def drop(self):
        """The pose is not known any more."""
        self.known = False
        self._begin(0, 0, 0, START)

    def start(self, x_um, y_um, turn_um, variance=START):
        """Take a pose from somebody else."""
        self.known = True
        self._begin(x_um, y_um, turn_um, min(variance, MOST))
        self.move_outline()

    def _begin(self, x_um, y_um, turn_um, variance):
        self.pose[0], self.pose[1], self.pose[2] = x_um, y_um, turn_um
        self.way_um = 0
        for number in range(6):
            self.covariance[number] = variance if number <= TT else 0

    @micropython.native
    def move_outline(self):
        """Place the outline where the parcel is."""
        self.place(self.pose[0], self.pose[1], self.pose[2])

    def variance(self):
        """The mean of the three variances."""
        covariance = self.covariance
        return (covariance[XX] + covariance[YY] + covariance[TT]) // 3

    @micropython.native
    def roll(self, step_ms):
        """The parcel has moved by its twist, and by the one before, each for half of the time.

        The outline is left to be placed.
        """
        pose, covariance = self.pose, self.covariance
        speeds, before, halves_per_s = self.twist.speeds, self.twist.before, 2000 // step_ms
        way_um = self.way_um
        for axis in range(3):
            moved_um = (speeds[axis] + before[axis] + halves_per_s // 2) // halves_per_s
            pose[axis] += moved_um
            way_um += abs(moved_um)
        pose[2] = wrapped(pose[2])
        for number in range(3):
            covariance[number] = min(covariance[number] + way_um // _WAY_UM, MOST)
        self.way_um = way_um % _WAY_UM

    @micropython.native
    def correct(self, x, y, error, exact=True):
        """The parcel's edge is over a point [steps]; returns False if that is not believed.

        The Kalman filter's update by a distance, with its derivative by the pose. `error` is the
        variance of the distance. Where the edge is not `exact` it makes nothing surer. A distance
        of more than 40 mm is not believed. Nor is one of five standard deviations, which makes the
        pose less sure.
        """
        pose, covariance, off = self.pose, self.covariance, self.edge(x, y)
        if abs(off) > 2500:
            return False
        hx, hy, ht = self.normal
        xx, yy, tt, xy, xt, yt = covariance
        sx = xx * hx + xy * hy + xt * ht >> 10
        sy = xy * hx + yy * hy + yt * ht >> 10
        st = xt * hx + yt * hy + tt * ht >> 10
        variance = (hx * sx + hy * sy + ht * st >> 10) + error
        # From steps of 16 um to 1/16 mm.
        square = (off * 16 // 62) ** 2
        if square > 25 * variance:
            for number in range(3):
                covariance[number] = min(covariance[number] + (square >> 3), MOST)
            return False
        gx, gy, gt = (sx << 10) // variance, (sy << 10) // variance, (st << 10) // variance
        pose[0] += gx * off >> 6
        pose[1] += gy * off >> 6
        pose[2] = wrapped(pose[2] + (gt * off >> 6))
        if exact:
            covariance[XX] = max(xx - (gx * sx >> 10), _LEAST)
            covariance[YY] = max(yy - (gy * sy >> 10), _LEAST)
            covariance[TT] = max(tt - (gt * st >> 10), _LEAST)
            covariance[XY] = xy - (gx * sy >> 10)
            covariance[XT] = xt - (gx * st >> 10)
            covariance[YT] = yt - (gy * st >> 10)
        self.move_outline()
        return True

    @micropython.native
    def agree(self, off, variance, weight, own_weight):
        """Move towards the beliefs of neighbours; the outline is left to be placed.

        `off` are the sums of their weighted differences from this belief [4 um], `variance` is that
        of their weighted variances, and `weight` that of their weights. The mean of two beliefs is
        at least as good as the mean of their variances, however much they have in common
        (covariance intersection).
        """
        pose, covariance, total = self.pose, self.covariance, weight + own_weight
        for axis in range(3):
            pose[axis] += off[axis] * 4 // weight * weight // total
        pose[2] = wrapped(pose[2])
        variance //= weight
        for number in range(3):
            covariance[number] = (covariance[number] * own_weight + variance * weight) // total
        for number in range(3, 6):
            covariance[number] = covariance[number] * own_weight // total

    @micropython.native
    def send(self, fields, ahead_ms):
        """Write into an estimate where the parcel will be so many milliseconds after the belief.

        Leaves it in `sent`, too; returns the certainty.
        """
        pose, sent, speeds, per_s = self.pose, self.sent, self.twist.speeds, 1000 // ahead_ms
        for axis in range(3):
            sent[axis] = pose[axis] + (speeds[axis] + per_s // 2) // per_s
        sent[2] = wrapped(sent[2])
        fields[wire.X] = _steps(sent[0])
        fields[wire.Y] = _steps(sent[1])
        fields[wire.YAW] = yaw(sent[2])
        return certainty(self.variance())

    @micropython.native
    def speed(self):
        """The sum of the sizes of its three speeds."""
        speeds = self.twist.speeds
        return abs(speeds[0]) + abs(speeds[1]) + abs(speeds[2])


def _steps(way_um):
    return (way_um + wire.STEP_UM // 2) // wire.STEP_UM


def certainty(variance):
    """The certainty of an estimate, 1 to 15: each step halves the variance."""
    steps = 17
    while variance and steps > 1:
        variance >>= 1
        steps -= 1
    return min(steps, 15)
