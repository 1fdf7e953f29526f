"""How a parcel moves, from the speeds of the wheels under it; wheels that slip count little."""

from mdms_cell.neighbours.angle import ARM_UM
from mdms_cell.neighbours.outline import STEP_UM

_ARM = ARM_UM // STEP_UM
#: An error of this size halves a wheel's weight, at least [um/s].
_SLIPPING_UM_S = 3_000
#: Errors above this count no more than it [um/s].
_CLIP_UM_S = 65_000
#: Keeps a direction that no wheel shows where it was.
_RIDGE = 8
_SWEEPS = 4


class TwistFit:
    """The rigid twist that most wheels agree on, followed from beat to beat.

    `vx`, `vy` and `turn` are speeds [um/s], the last one that of a point at the arm of `angle`.
    Wheels are given by `begin`, `wheel` for each and `end`.
    """

    def __init__(self):
        self.vx = self.vy = self.turn = 0
        self._mean_um_s = 0
        self.begin(0, 0)

    def reset(self):
        """At rest."""
        self.vx = self.vy = self.turn = 0
        self._mean_um_s = 0

    def begin(self, x, y):
        """The parcel's centre is there [steps of 16 um]."""
        self._x, self._y = x, y
        self._xx = self._xt = self._yy = self._yt = self._xy = 0
        self._tt = self._rx = self._ry = self._rt = 0
        self._errors_um_s = 0
        self.wheels = 0
        self._slip_um_s = max(_SLIPPING_UM_S, self._mean_um_s * 3 // 2)

    def at(self, x, y, along_x, along_y):
        """The speed of the parcel above a wheel there, along its direction in 1/512 [um/s]."""
        lever = (along_y * (x - self._x) - along_x * (y - self._y)) // _ARM
        return along_x * self.vx + along_y * self.vy + lever * self.turn >> 9

    def wheel(self, x, y, along_x, along_y, speed_um_s):
        """A wheel there turns at that speed; its direction is in 1/512."""
        lever = (along_y * (x - self._x) - along_x * (y - self._y)) // _ARM
        error = speed_um_s - (along_x * self.vx + along_y * self.vy + lever * self.turn >> 9)
        size = abs(error)
        self._errors_um_s += size
        self.wheels += 1
        slip = self._slip_um_s
        weight = 64 * slip // (slip + size) * slip // (slip + size)
        error = weight * max(min(error, _CLIP_UM_S), -_CLIP_UM_S) >> 6
        self._xx += weight * along_x * along_x >> 15
        self._xy += weight * along_x * along_y >> 15
        self._xt += weight * along_x * lever >> 15
        self._yy += weight * along_y * along_y >> 15
        self._yt += weight * along_y * lever >> 15
        self._tt += weight * lever * lever >> 15
        self._rx += along_x * error
        self._ry += along_y * error
        self._rt += lever * error

    def end(self):
        """Move the twist towards what the wheels say; one that no wheel shows stays."""
        if not self.wheels:
            return
        self._mean_um_s = self._errors_um_s // self.wheels
        dx = dy = dt = 0
        for _ in range(_SWEEPS):
            dx = (self._rx - self._xy * dy - self._xt * dt) // (self._xx + _RIDGE)
            dy = (self._ry - self._xy * dx - self._yt * dt) // (self._yy + _RIDGE)
            dt = (self._rt - self._xt * dx - self._yt * dy) // (self._tt + _RIDGE)
        self.vx += dx
        self.vy += dy
        self.turn += dt
