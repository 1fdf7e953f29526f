"""From a parcel's pose and goal to the twist that takes it there, as gently as its program asks."""

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython

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

    @micropython.native
    def stands(self):
        """Whether nothing is commanded."""
        return not (self.vx or self.vy or self.turn)

    @micropython.native
    def step(self, program, reach_um, left_um, *, may_go, step_ms):
        """The next twist; `left_um` are x, y and turn that are left to go.

        Without `may_go` the parcel is brought to rest.
        """
        dx_um, dy_um, dturn_um = left_um
        if program.any_yaw:
            dturn_um = 0
        acceleration_mm_s2 = program.acceleration_mm_s2
        corner = reach_um * _SHARE // ARM_UM or 1
        vx = vy = vt = 0
        if not self._settle(dx_um, dy_um, dturn_um):
            way_um = length(dx_um, dy_um, dturn_um * corner // _SHARE)
            # As fast as it may go with this way left: never faster than it can brake.
            braking = root(min(acceleration_mm_s2 * way_um, ROOT_MAX)) * 316 // 10
            speed = min(program.speed_um_s, _STIFFNESS_PER_S * way_um, braking)
            way = way_um >> 4 or 1
            vx = speed * (dx_um >> 4) // way
            vy = speed * (dy_um >> 4) // way
            vt = speed * (dturn_um >> 4) // way
        self.wish = (vx, vy, vt)
        if not may_go:
            vx = vy = vt = 0
        self._approach(vx, vy, vt, corner, acceleration_mm_s2 * step_ms)

    @micropython.native
    def _approach(self, vx, vy, vt, corner, most):
        """Change the twist by at most so much [um/s]."""
        vx -= self.vx
        vy -= self.vy
        vt -= self.turn
        if not (vx or vy or vt):
            return
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

    @micropython.native
    def _settle(self, dx_um, dy_um, dturn_um):
        """Find out whether the parcel has arrived; returns it."""
        arrived = self.arrived
        near_um, near_turn_um = _TOLERANCE_UM, _TOLERANCE_TURN_UM
        if arrived:
            near_um, near_turn_um = 2 * near_um, 2 * near_turn_um
        if (
            -near_um <= dx_um <= near_um
            and -near_um <= dy_um <= near_um
            and -near_turn_um <= dturn_um <= near_turn_um
        ):
            self._settled = min(self._settled + 1, _SETTLED_BEATS)
            arrived = arrived or self._settled >= _SETTLED_BEATS
        else:
            self._settled = 0
            arrived = False
        self.arrived = arrived
        return arrived


@micropython.native
def length(x, y, z):
    """The length of a vector of numbers up to 3,000,000, within a part in a thousand or 16."""
    x >>= 5
    y >>= 5
    z >>= 5
    square = x * x + y * y + z * z
    return root(square) << 5 if square <= ROOT_MAX else root(square >> 4) << 7
