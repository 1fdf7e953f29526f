"""The believed place of a parcel: rolled on by wheels, corrected at edges, agreed.

It is an extended Kalman filter over the pose (x, y, turn) in whole numbers of 32 bits. The pose is
in um from the cell's own centre, the turn at the arm of `angle`. Variances are in squares of 1/16
mm.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.perception.angle import wrapped, yaw
from mdms_cell.perception.outline import Outline
from mdms_cell.perception.twist import Twist
from mdms_protocol.compat import WIDEN, const, micropython, ptr32
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
        twist = self.twist
        speeds, before = twist.speeds, twist.before
        self.way_um = roll(self.pose, self.covariance, speeds, before, 2000 // step_ms, self.way_um)

    @micropython.native
    def correct(self, x, y, error, exact=True):
        """The parcel's edge is over a point [steps]; returns False if that is not believed.

        `error` is the variance of that. Where the edge is not `exact` it makes nothing surer.
        """
        off = self.edge(x, y)
        if not correct(self.pose, self.covariance, self.normal, off, error, exact):
            return False
        self.move_outline()
        return True

    @micropython.native
    def agree(self, sums, own_weight):
        """Move towards the beliefs of neighbours, see `agree`; the outline is left to be placed."""
        agree(self.pose, self.covariance, sums, own_weight)

    @micropython.native
    def send(self, fields, ahead_ms):
        """Write into an estimate where the parcel will be so many milliseconds after the belief.

        Leaves it in `sent`, too; returns the certainty.
        """
        send(self.pose, self.twist.speeds, 1000 // ahead_ms, self.sent)
        fields[wire.X] = _steps(self.sent[0])
        fields[wire.Y] = _steps(self.sent[1])
        fields[wire.YAW] = yaw(self.sent[2])
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


@micropython.viper
def send(pose: ptr32, speeds: ptr32, per_s: int, sent: ptr32):
    """The pose to send: rolled on by the twist for a part of a second."""
    widen = int(WIDEN)
    for axis in range(3):
        moved = ((speeds[axis] << widen >> widen) + per_s // 2) // per_s
        sent[axis] = (pose[axis] << widen >> widen) + moved
    sent[2] = int(wrapped(sent[2] << widen >> widen))


@micropython.viper
def roll(  # noqa: PLR0917 - viper takes words
    pose: ptr32, covariance: ptr32, speeds: ptr32, before: ptr32, halves_per_s: int, way_um: int
) -> int:
    """Move a pose on, see `Belief.roll`; return the rest of the way.

    Halves of the time go so often into a second.
    """
    widen = int(WIDEN)
    way = way_um
    for axis in range(3):
        speed = (speeds[axis] << widen >> widen) + (before[axis] << widen >> widen)
        moved = (speed + halves_per_s // 2) // halves_per_s
        pose[axis] += moved
        way += moved if moved > 0 else 0 - moved
    pose[2] = int(wrapped(pose[2] << widen >> widen))
    for number in range(3):
        variance = covariance[number] + way // _WAY_UM
        covariance[number] = variance if variance < MOST else MOST
    return way % _WAY_UM


@micropython.viper
def correct(  # noqa: PLR0917 - viper takes words
    pose: ptr32, covariance: ptr32, normal: ptr32, off: int, error: int, exact: bool
) -> bool:
    """The Kalman filter's update by a distance `off`, with derivative `normal` by the pose.

    A distance of more than 40 mm is not believed. Nor is one of five standard deviations, which
    makes the pose less sure; see `Belief.correct`.
    """
    widen = int(WIDEN)
    if off > 2500 or off < -2500:
        return False
    hx = normal[0] << widen >> widen
    hy = normal[1] << widen >> widen
    ht = normal[2] << widen >> widen
    xy = covariance[XY] << widen >> widen
    xt = covariance[XT] << widen >> widen
    yt = covariance[YT] << widen >> widen
    sx = covariance[XX] * hx + xy * hy + xt * ht >> 10
    sy = xy * hx + covariance[YY] * hy + yt * ht >> 10
    st = xt * hx + yt * hy + covariance[TT] * ht >> 10
    # The sum hx * sx + hy * sy + ht * st >> 10, whose last product would not fit.
    variance = (hx * sx + hy * sy + ht * (st & 0x3FF) >> 10) + ht * (st >> 10) + error
    # From steps of 16 um to 1/16 mm.
    sixteenths = off * 16 // 62
    square = sixteenths * sixteenths
    if square > 25 * variance:
        for number in range(3):
            doubted = covariance[number] + (square >> 3)
            covariance[number] = doubted if doubted < MOST else MOST
        return False
    gx = (sx << 10) // variance
    gy = (sy << 10) // variance
    gt = (st << 10) // variance
    pose[0] += gx * off >> 6
    pose[1] += gy * off >> 6
    pose[2] = int(wrapped((pose[2] << widen >> widen) + (gt * off >> 6)))
    if exact:
        xx = covariance[XX] - (gx * sx >> 10)
        yy = covariance[YY] - (gy * sy >> 10)
        tt = covariance[TT] - (gt * st >> 10)
        covariance[XX] = xx if xx > _LEAST else _LEAST
        covariance[YY] = yy if yy > _LEAST else _LEAST
        covariance[TT] = tt if tt > _LEAST else _LEAST
        covariance[XY] = xy - (gx * sy >> 10)
        covariance[XT] = xt - (gx * st >> 10)
        covariance[YT] = yt - (gy * st >> 10)
    return True


@micropython.viper
def agree(pose: ptr32, covariance: ptr32, sums: ptr32, own: int):
    """Move towards the beliefs of neighbours, this one having a weight of its own.

    `sums` are those of their weights, of weighted differences from this belief [4 um], and of
    variances. The mean of two beliefs is at least as good as the mean of their variances, however
    much they have in common (covariance intersection).
    """
    widen = int(WIDEN)
    weight = sums[0]
    total = weight + own
    for axis in range(3):
        off = (sums[1 + axis] << widen >> widen) * 4 // weight
        pose[axis] += off * weight // total
    pose[2] = int(wrapped(pose[2] << widen >> widen))
    variance = sums[4] // weight
    for number in range(3):
        covariance[number] = (covariance[number] * own + variance * weight) // total
    for number in range(3, 6):
        covariance[number] = (covariance[number] << widen >> widen) * own // total
