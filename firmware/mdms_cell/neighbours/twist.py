"""How a parcel moves, from the speeds of the wheels under it; wheels that slip count little."""

try:
    import micropython
except ImportError:
    from mdms_cell.cpython import micropython

from mdms_cell.neighbours.angle import ARM_UM
from mdms_cell.neighbours.outline import DISC, STEP_UM

_ARM = ARM_UM // STEP_UM
#: An error of this size halves a wheel's weight, at least [um/s].
_SLIPPING_UM_S = 3_000
#: Errors above this count no more than it [um/s].
_CLIP_UM_S = 65_000
#: Keeps a direction that no wheel shows where it was.
_RIDGE = 8
_SWEEPS = 4
#: What is known of a wheel: its place [steps of 16 um] and its direction [1/512].
WHEEL = 4


class TwistFit:
    """The rigid twist that most wheels agree on, followed from beat to beat.

    `vx`, `vy` and `turn` are speeds [um/s], the last one that of a point at the arm of `angle`;
    `wheels` is how many showed it at last.
    """

    def __init__(self):
        self.reset()

    def reset(self):
        """At rest."""
        self.vx = self.vy = self.turn = 0
        self.wheels = 0
        self._mean_um_s = 0

    def at(self, outline, x, y, along_x, along_y):
        """The speed of the parcel above a wheel there, along its direction in 1/512 [um/s]."""
        lever = (along_y * (x - outline.x) - along_x * (y - outline.y)) // _ARM
        return along_x * self.vx + along_y * self.vy + lever * self.turn >> 9

    @micropython.native
    def fit(self, outline, wheels, speeds, axes, use):
        """Move the twist towards what the wheels under the outline say.

        Wheel n has its place and direction at `wheels[WHEEL * n]` and its speed at `speeds[n]`
        [um/s]; it is of the cell n // axes, and counts while `use` has a 1 for that. A direction
        that no wheel shows stays as it was.
        """
        disc = outline.shape == DISC
        centre_x, centre_y, cosine, sine = outline.x, outline.y, outline.cosine, outline.sine
        half_length, half_width = outline.half_length, outline.half_width
        radius = (half_length >> 2) * (half_length >> 2)
        vx, vy, turn = self.vx, self.vy, self.turn
        slip = max(_SLIPPING_UM_S, self._mean_um_s * 3 // 2)
        xx = xy = xt = yy = yt = tt = rx = ry = rt = 0
        errors = count = 0
        for number in range(len(speeds)):
            if not use[number // axes]:
                continue
            at = WHEEL * number
            x, y = wheels[at] - centre_x, wheels[at + 1] - centre_y
            if disc:
                if (x >> 2) * (x >> 2) + (y >> 2) * (y >> 2) >= radius:
                    continue
            elif (
                abs(cosine * x + sine * y >> 13) >= half_length
                or abs(cosine * y - sine * x >> 13) >= half_width
            ):
                continue
            along_x, along_y = wheels[at + 2], wheels[at + 3]
            lever = (along_y * x - along_x * y) // _ARM
            error = speeds[number] - (along_x * vx + along_y * vy + lever * turn >> 9)
            size = abs(error)
            errors += size
            count += 1
            weight = 64 * slip // (slip + size) * slip // (slip + size)
            error = weight * max(min(error, _CLIP_UM_S), -_CLIP_UM_S) >> 6
            xx += weight * along_x * along_x >> 15
            xy += weight * along_x * along_y >> 15
            xt += weight * along_x * lever >> 15
            yy += weight * along_y * along_y >> 15
            yt += weight * along_y * lever >> 15
            tt += weight * lever * lever >> 15
            rx += along_x * error
            ry += along_y * error
            rt += lever * error
        self.wheels = count
        if not count:
            self.vx = self.vy = self.turn = 0
            return
        self._mean_um_s = errors // count
        dx = dy = dt = 0
        for _ in range(_SWEEPS):
            dx = (rx - xy * dy - xt * dt) // (xx + _RIDGE)
            dy = (ry - xy * dx - yt * dt) // (yy + _RIDGE)
            dt = (rt - xt * dx - yt * dy) // (tt + _RIDGE)
        self.vx = vx + dx
        self.vy = vy + dy
        self.turn = turn + dt
