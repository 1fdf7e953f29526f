"""From a parcel's pose and goal to the twist that takes it there, as gently as its program asks.

A trapezoidal profile along the straight way that is left: the speed is the one from which the
parcel can still brake, v = sqrt(2 a s), and changes no faster than the acceleration.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.perception.angle import ARM_UM, ROOT_MAX, root, turn_um, wrapped
from mdms_protocol.compat import WIDEN, const, micropython, ptr32
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.frames import read_way

#: The parcel has arrived within this, for so many beats; it is steered again outside twice as much.
_TOLERANCE_UM = const(2_000)
_TOLERANCE_TURN_UM = const(1_500)
_SETTLED_BEATS = const(30)
#: The same as a time [ms].
SETTLED_MS = const(300)
#: From the wish to brake until all cells under the parcel brake: HOPS times the beats that `hold`
#: may take and counts [ms].
REACTION_MS = const(200)
#: Parts of a corner's way, in which turning and going are one motion.
_SHARE = const(64)
#: The largest number of which `length` is exact.
_LONG = const(3_000_000)

# Numbers of a way behind the goal's place in table frame, as `read_way` reads them.
_ACCELERATION = const(3)
_SPEED = const(4)
_FLAGS = const(5)


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
        self._way = array("i", [0] * 6)
        self._change = array("i", [0] * 3)
        #: Until a cell has told its pitch.
        self.room_mm = 1_000
        self.reset()

    def reset(self):
        """The parcel stands, and has nowhere to go."""
        self.arrived = False
        self._settled_beats = 0
        for axis in range(3):
            self.commanded[axis] = self.wish[axis] = self.left[axis] = 0
        for number in range(6):
            self._way[number] = 0

    @micropython.native
    def read(self, program):
        """Take the goal and the limits of a program that is complete."""
        read_way(program.pages, self._way, 0)

    def acceleration_mm_s2(self):
        """The program's acceleration."""
        return self._way[_ACCELERATION] * wire.ACCELERATION_MM_S2

    def speed_mm_s(self):
        """The program's speed, or that from which the parcel can stand within the room."""
        braking = self.acceleration_mm_s2()
        slowed = braking * REACTION_MS // 1000
        most = root(slowed * slowed + 2 * braking * self.room_mm) - slowed
        return min(self._way[_SPEED] * wire.SPEED_MM_S, most)

    @micropython.native
    def find_wish(self, parcel, x_um, y_um):
        """Find the rest of the way, whether the parcel has arrived, and the twist to its goal.

        The parcel's pose is from the cell's own centre, which is at `x_um` and `y_um`.
        """
        way, left, pose, wish = self._way, self.left, parcel.pose, self.wish
        left[0] = way[0] * wire.STEP_UM - x_um - pose[0]
        left[1] = way[1] * wire.STEP_UM - y_um - pose[1]
        left[2] = wrapped(turn_um(way[2]) - pose[2])
        turn = 0 if way[_FLAGS] & wire.ANY_YAW else left[2]
        self._settle(turn)
        speed_um_s, length_um = 0, 1
        if not self.arrived:
            length_um = length(left[0], left[1], turn * _corner(parcel.reach_um) // _SHARE)
            most_um_s = self.speed_mm_s() * 1000
            speed_um_s = speed(length_um, self.acceleration_mm_s2(), most_um_s)
        wish[0], wish[1], wish[2] = left[0], left[1], turn
        scale(wish, speed_um_s, length_um)

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
        commanded, change = self.commanded, self._change
        for axis in range(3):
            change[axis] = (self.wish[axis] if may_go else 0) - commanded[axis]
        if any(change):
            size = length(change[0], change[1], change[2] * _corner(reach_um) // _SHARE)
            # At least 0.1 mm/s: every ramp ends.
            most = max(self.acceleration_mm_s2() * step_ms, 100)
            if size > most:
                shorten(change, most >> 4, max(size >> 4, 1))
            for axis in range(3):
                commanded[axis] += change[axis]
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


def _corner(reach_um):
    """The way of a corner for one of a point at the arm, in parts of _SHARE."""
    return reach_um * _SHARE // ARM_UM or 1


@micropython.viper
def speed(way_um: int, acceleration_mm_s2: int, most_um_s: int) -> int:
    """As fast as a parcel may go with this way left: never faster than it can brake [um/s].

    Near the goal the speed is three times the way left a second.
    """
    square = int(ROOT_MAX)
    if acceleration_mm_s2 == 0 or way_um <= square // acceleration_mm_s2:
        square = acceleration_mm_s2 * way_um
    fast = int(root(square)) * 316 // 10
    fast = fast if fast < most_um_s else most_um_s
    most = 3 * way_um
    return fast if fast < most else most


@micropython.viper
def scale(way: ptr32, speed: int, length: int):
    """Turn a way of this length into the twist of this speed along it."""
    widen = int(WIDEN)
    x = (way[0] << widen >> widen) >> 4
    y = (way[1] << widen >> widen) >> 4
    turn = (way[2] << widen >> widen) >> 4
    length = length >> 4 if length >> 4 else 1
    # Products with a speed are words then.
    while length > 1 << 19:
        length >>= 1
        x >>= 1
        y >>= 1
        turn >>= 1
    way[0] = x
    way[1] = y
    way[2] = turn
    for axis in range(3):
        # Speed * part // length, in two pieces that words have room for.
        part = way[axis] << widen >> widen
        upper = (speed >> 10) * part
        lower = (upper % length << 10) + (speed & 0x3FF) * part
        way[axis] = (upper // length << 10) + lower // length


@micropython.viper
def shorten(change: ptr32, most: int, size: int):
    """Bring a change of this size down to `most`: each number times most // size."""
    widen = int(WIDEN)
    for axis in range(3):
        part = change[axis] << widen >> widen
        # In pieces that words have room for.
        rest = part % size
        upper = (most >> 7) * rest
        lower = (upper % size << 7) + (most & 0x7F) * rest
        change[axis] = part // size * most + (upper // size << 7) + lower // size


@micropython.viper
def length(x: int, y: int, z: int) -> int:
    """The length of a vector of parts within 3 m [um], within 80 um or three parts in 10,000."""
    longer = 0
    while x > _LONG or x < -_LONG or y > _LONG or y < -_LONG or z > _LONG or z < -_LONG:
        x >>= 1
        y >>= 1
        z >>= 1
        longer += 1
    x >>= 5
    y >>= 5
    z >>= 5
    # Squares of (4 * a + r), whose sum may not fit a word: their 16ths, and the rest.
    sixteenths = (x >> 2) * (x >> 2) + (y >> 2) * (y >> 2) + (z >> 2) * (z >> 2)
    rest = (x & 3) * (2 * x - (x & 3)) + (y & 3) * (2 * y - (y & 3)) + (z & 3) * (2 * z - (z & 3))
    if sixteenths + (rest + 15 >> 4) > int(ROOT_MAX) >> 4:
        return int(root(sixteenths + (rest >> 4))) << 7 + longer
    return int(root((sixteenths << 4) + rest)) << 5 + longer
