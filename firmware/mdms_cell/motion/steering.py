"""From a parcel's pose and goal to the twist that takes it there, as gently as its program asks.

A trapezoidal profile along the straight way that is left: the speed is the one from which the
parcel can still brake, v = sqrt(2 a s), and changes no faster than the acceleration.
"""

from array import array

from mdms_cell.perception.angle import ARM_UM, ROOT_MAX, root, wrapped
from mdms_protocol.compat import const, micropython

#: The parcel has arrived within this, for so many beats; it is steered again outside twice as much.
_TOLERANCE_UM = const(2_000)
_TOLERANCE_TURN_UM = const(1_500)
_SETTLED_BEATS = const(30)
#: The same as a time [ms].
SETTLED_MS = const(300)
#: From the wish to brake until all cells under the parcel brake: HOPS times the beats that `hold`
#: may take and counts [ms].
REACTION_MS = const(200)


class Steering:
    """The way of one parcel to the goal of its program, as one cell steers it.

    `commanded` is the twist [um/s]; it changes no faster than the program allows. `wish` is the
    twist that it approaches. `left` is the rest of the way: x, y and turn [um]. `arrived` lasts
    until the parcel is found outside twice the tolerance. `room_mm` is the way within which a
    parcel under way can always stand.
    """

    def __init__(self):
        self.commanded = array("i", [0] * 3)
        self.wish = array("i", [0] * 3)
        self.left = array("i", [0] * 3)
        #: Until a cell has told its pitch.
        self.room_mm = 1_000
        self.reset()

    def reset(self):
        """The parcel stands, and has nowhere to go."""
        self.arrived = False
        self._settled_beats = 0
        self._goal, self._any_yaw = (0, 0, 0), False
        self.acceleration_mm_s2 = self._speed_mm_s = 0
        for axis in range(3):
            self.commanded[axis] = self.wish[axis] = self.left[axis] = 0

    @micropython.native
    def read(self, program):
        """Take the goal and the limits of a program that is complete."""
        self._goal = program.place(0)
        self._any_yaw = program.any_yaw
        self.acceleration_mm_s2, self._speed_mm_s = program.limits()

    def speed_mm_s(self):
        """The program's speed, or that from which the parcel can stand within the room."""
        braking = self.acceleration_mm_s2
        slowed = braking * REACTION_MS // 1000
        most = root(slowed * slowed + 2 * braking * self.room_mm) - slowed
        return min(self._speed_mm_s, most)

    @micropython.native
    def find_wish(self, parcel, x_um, y_um):
        """Find the rest of the way, whether the parcel has arrived, and the twist to its goal.

        The parcel's pose is from the cell's own centre, which is at `x_um` and `y_um`.
        """
        goal, left, pose, wish = self._goal, self.left, parcel.pose, self.wish
        left[0] = goal[0] - x_um - pose[0]
        left[1] = goal[1] - y_um - pose[1]
        left[2] = wrapped(goal[2] - pose[2])
        turn = 0 if self._any_yaw else left[2]
        self._settle(turn)
        length_um, speed_um_s = size(left[0], left[1], turn, parcel.reach_um), 0
        if not self.arrived:
            most_um_s = self.speed_mm_s() * 1000
            speed_um_s = speed(length_um, self.acceleration_mm_s2, most_um_s)
        for axis, way in enumerate((left[0], left[1], turn)):
            wish[axis] = way * speed_um_s // max(length_um, 1)

    @micropython.native
    def _settle(self, turn):
        """Find whether the parcel has arrived, with this turn left to go."""
        wide = 2 if self.arrived else 1
        away_um = max(abs(self.left[0]), abs(self.left[1]))
        within = away_um <= wide * _TOLERANCE_UM and abs(turn) <= wide * _TOLERANCE_TURN_UM
        self._settled_beats = min(self._settled_beats + 1, _SETTLED_BEATS) if within else 0
        self.arrived = within and (self.arrived or self._settled_beats >= _SETTLED_BEATS)

    @micropython.native
    def approach(self, reach_um, may_go, step_ms):
        """Bring the twist nearer to the wish, or to 0 if it may not go; returns whether it is 0."""
        commanded = self.commanded
        x, y, turn = [(self.wish[axis] if may_go else 0) - commanded[axis] for axis in range(3)]
        change_um_s = size(x, y, turn, reach_um)
        # At least 0.1 mm/s: every ramp ends.
        most = max(self.acceleration_mm_s2 * step_ms, 100)
        part, whole = (most, change_um_s) if change_um_s > most else (1, 1)
        for axis, change in enumerate((x, y, turn)):
            commanded[axis] += change * part // whole
        return self.stands()

    @micropython.native
    def stands(self):
        """Whether the commanded twist is none."""
        return not any(self.commanded)

    @micropython.native
    def wishes(self):
        """Whether the twist that is wished for is any."""
        return any(self.wish)

    def has_arrived(self):
        """Whether the parcel stands at its goal."""
        return self.arrived and self.stands()


def size(x, y, turn, reach_um):
    """The length of a way: going, and turning by the way of a corner, are one motion."""
    return length(x, y, turn * reach_um // ARM_UM)


@micropython.native
def speed(way_um, acceleration_mm_s2, most_um_s):
    """As fast as a parcel may go with this way left: never faster than it can brake [um/s].

    Near the goal the speed is three times the way left a second.
    """
    fast_um_s = root(min(acceleration_mm_s2 * way_um, ROOT_MAX)) * 316 // 10
    return min(fast_um_s, most_um_s, 3 * way_um)


@micropython.native
def length(x, y, z):
    """The length of a vector, within one part in 20,000 or less than 1."""
    square, halvings = x * x + y * y + z * z, 0
    while square > ROOT_MAX:
        square >>= 2
        halvings += 1
    return root(square) << halvings
