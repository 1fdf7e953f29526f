"""From a parcel's pose and goal to the twist that takes it there, as gently as its program asks."""

try:
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const

from mdms_cell.neighbours.geometry.angle import ARM_UM, ROOT_MAX, root

#: The parcel has arrived within this, for so many beats; it is steered again outside twice as much.
_TOLERANCE_UM = const(2_000)
_TOLERANCE_TURN_UM = const(1_500)
_SETTLED_BEATS = const(30)
#: The same as a time [ms].
SETTLED_MS = const(300)
#: Near the goal the speed is so many times the way left a second.
_STIFFNESS_PER_S = const(3)
#: Parts of a corner's way, in which turning and going are one motion.
_SHARE = const(64)


class Steering:
    """The commanded twist `vx`, `vy`, `turn` [um/s], changed no faster than the program allows.

    `wish` is what it is to become; `arrived` holds until the parcel is found outside twice the
    tolerance.
    """

    def __init__(self):
        self.reset()

    def reset(self):
        """Begin anew, at rest."""
        self.join(0, 0, 0)
        self.wish = (0, 0, 0)
        self.arrived = False
        self._settled = 0

    def join(self, vx, vy, turn):
        """Begin with the twist that the parcel has, so that a wheel joins the others' motion."""
        self.vx, self.vy, self.turn = vx, vy, turn

    def stands(self):
        """Whether nothing is commanded."""
        return not (self.vx or self.vy or self.turn)

    def step(self, program, reach_um, left_um, *, may_go, step_ms):
        """The next twist; `left_um` are x, y and turn that are left to go.

        Without `may_go` the parcel is brought to rest.
        """
        dx_um, dy_um, dturn_um = left_um
        if program.any_yaw:
            dturn_um = 0
        self._settle(dx_um, dy_um, dturn_um)
        corner = max(reach_um * _SHARE // ARM_UM, 1)
        vx = vy = vt = 0
        if not self.arrived:
            way_um = length(dx_um, dy_um, dturn_um * corner // _SHARE)
            speed = self._speed_um_s(program, way_um)
            way = max(way_um >> 4, 1)
            vx = speed * (dx_um >> 4) // way
            vy = speed * (dy_um >> 4) // way
            vt = speed * (dturn_um >> 4) // way
        self.wish = (vx, vy, vt)
        if not may_go:
            vx = vy = vt = 0
        self._approach(vx, vy, vt, corner, program.acceleration_mm_s2 * step_ms)

    def _speed_um_s(self, program, way_um):
        """As fast as it may go with this way left: never faster than it can brake."""
        braking = root(min(program.acceleration_mm_s2 * way_um, ROOT_MAX)) * 316 // 10
        return min(program.speed_um_s, _STIFFNESS_PER_S * way_um, braking)

    def _approach(self, vx, vy, vt, corner, most):
        """Change the twist by at most so much [um/s]."""
        vx -= self.vx
        vy -= self.vy
        vt -= self.turn
        size = length(vx, vy, vt * corner // _SHARE)
        if size > most:
            size = max(size >> 4, 1)
            most >>= 4
            vx = vx * most // size
            vy = vy * most // size
            vt = vt * most // size
        self.vx += vx
        self.vy += vy
        self.turn += vt

    def _settle(self, dx_um, dy_um, dturn_um):
        slack = 2 if self.arrived else 1
        within = (
            abs(dx_um) <= slack * _TOLERANCE_UM
            and abs(dy_um) <= slack * _TOLERANCE_UM
            and abs(dturn_um) <= slack * _TOLERANCE_TURN_UM
        )
        self._settled = min(self._settled + 1, _SETTLED_BEATS) if within else 0
        self.arrived = within and (self.arrived or self._settled >= _SETTLED_BEATS)


def length(x, y, z):
    """The length of a vector of numbers up to 3,000,000, within a part in a thousand or 16."""
    square = (x >> 5) ** 2 + (y >> 5) ** 2 + (z >> 5) ** 2
    return root(square) << 5 if square <= ROOT_MAX else root(square >> 4) << 7
