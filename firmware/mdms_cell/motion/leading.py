"""Leads the cell's two wheels: finds the cells that the parcel needs next, steers, and rests."""

from array import array

from mdms_cell.perception.angle import ARM_UM, ROOT_MAX, root, wrapped
from mdms_cell.perception.outline import STEP_UM, Outline, gap
from mdms_cell.perception.place import AXES, DIRECTIONS, OWN
from mdms_cell.perception.twist import OFF, WHEELS
from mdms_protocol.compat import const, micropython

#: The parcel has arrived within this, for so many beats; it is steered again outside twice as much.
_TOLERANCE_UM = const(2_000)
_TOLERANCE_TURN_UM = const(1_500)
_SETTLED_BEATS = const(30)
#: The same as a time [ms].
_SETTLED_MS = const(300)
#: From the wish to brake until all cells under the parcel brake: HOPS times the beats that `hold`
#: may take and counts [ms].
_REACTION_MS = const(200)
#: At the goal, or where it is held, the wheels hold for so long before they are switched off.
_HOLD_BEATS = const(50)
#: A parcel that stands for want of a cell goes no nearer to it if it would come over it within this
#: way. It would gain only a fraction of the way, again and again.
_NEARER_UM = const(10_000)
#: So many wheels show how a parcel moves.
_SHOWING_WHEELS = const(4)
#: Times without a host are counted up to this.
_LONG_MS = const(1 << 20)


class Steering:
    """The way of one parcel to the goal of its program, as one cell steers it.

    It has a trapezoidal profile along the straight way that is left. The speed is the one from
    which the parcel can still brake, v = sqrt(2 a s), and changes no faster than the acceleration.

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
        slowed = braking * _REACTION_MS // 1000
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


class Leading:
    """The wheels of one cell under one parcel, by its program.

    `needs` is the mask of the neighbours that the parcel covers, or will cover before it can stand.
    `wants` adds those that it will cover soon. `reported(direction)` returns the outline of the
    parcel over a neighbour, None where its place or its size is not known.
    """

    def __init__(self, place, footprint, tracking, axes, reported):
        self._place = place
        self._reported = reported
        self._footprint = footprint
        self._tracking = tracking
        self._parcel = tracking.belief
        self._axes = axes
        self.steering = Steering()
        self._targets = array("i", [0] * AXES)
        #: Scratch: the parcel where it will be.
        self._there = Outline()
        self._driving = False
        self.reset()

    def reset(self):
        """Switch the wheels off in good order, and forget everything."""
        self.stop()
        # A cell asks its neighbours alone, so a parcel has to stand within a pitch.
        self.steering.room_mm = self._place.pitch_um // 1000
        self.needs = self.wants = 0
        #: The parcel that the times without a host are about.
        self._identity = 0
        self._begin_times()

    def _begin_times(self):
        # The time of a program without a host, the time in which the parcel stood meanwhile for
        # want of a promise, and the time that its way takes (0: not found yet). Then whether the
        # first was too long.
        self.alone_ms = self._waited_ms = self._planned_ms = 0
        self._ended = False

    def begin(self, identity):
        """A new program of this parcel has come, which may be on its way here only."""
        if identity == self._identity:
            self._begin_times()
            self.next_leg()

    def had_its_time(self, identity):
        """Whether the time of this parcel without a host is over: it needs a new program."""
        return self._ended and identity == self._identity

    def next_leg(self):
        """The next leg of the same way begins: time for it was planned, and goes on."""
        self._held_beats = 0
        self.steering.arrived = False

    def plan_again(self):
        """More of the way has come: the time that is planned for it counts anew."""
        self._planned_ms = 0

    def stop(self):
        """Switch the wheels off in good order, if they are on."""
        if self._driving:
            self._axes.rest()
        #: Whether the wheels are on, for how long they have held, up to _HOLD_BEATS, and whether
        #: the parcel still rolled then.
        self._driving = self._rolled = False
        self._held_beats = 0
        self.steering.reset()

    # Looking ahead

    @micropython.native
    def look_ahead(self, program, lacking=0):
        """Find the cells that the parcel `needs` and `wants`.

        The parcel stands for want of the cells in the mask `lacking`, and already needs the nearest
        of them. It wants the cells of the next 500 ms.

        Without its host it asks for cells that it comes within 3 mm of. So it waits for a cell at
        that distance, and does not come over it by a hair before its turn.
        """
        footprint, parcel = self._footprint, self._parcel
        present = footprint.present
        if program is None:
            needs = wants = footprint.squares(parcel, present)
        else:
            room = 3_000 // STEP_UM if self.alone_ms else 0
            # By the way that was left when the wish was found.
            nearest = self._look_nearer(lacking & present, room) if lacking else 0
            steering = self.steering
            steering.read(program)
            needs = footprint.squares(parcel, present, room) | nearest
            needs |= self._comes_over(parcel.twist.speeds, _REACTION_MS, present ^ needs, room)
            wants = needs
            if steering.wishes():
                wants |= self._comes_over(steering.wish, 500, present ^ needs, room)
        self.needs, self.wants = needs, wants

    @micropython.native
    def _comes_over(self, twist, time_ms, asked, room):
        """The mask of those of the cells asked for that the parcel comes over before it stands.

        It moves on for this time until it brakes, and then by half as much as it would meanwhile.
        """
        if not asked:
            return 0
        twice_mm_s2 = 2 * self.steering.acceleration_mm_s2 or 2
        time_ms += length(twist[0], twist[1], twist[2]) // twice_mm_s2
        return self._covers_at([speed * time_ms // 1000 for speed in twist], asked, room)

    @micropython.native
    def _covers_at(self, way_um, asked, room):
        """The mask of those of the cells asked for that it lies over where it has gone so far.

        Or whose parcel it has come near to by then.
        """
        there, parcel = self._there, self._parcel
        pose = parcel.pose
        there.take_shape_of(parcel)
        there.place(*[pose[axis] + way_um[axis] for axis in range(3)])
        covered = self._footprint.squares(there, asked, room)
        others = self._tracking.others & asked & ~covered
        return covered | self._meets(others) if others else covered

    def _meets(self, asked):
        """The mask of those of the cells asked for whose parcel is too near to where this will be.

        Within 6 mm of each other they come no nearer by 0.5 mm: two parcels that share a square, as
        they were set down, may part. Others are farther apart.
        """
        here, there, mask = self._parcel.registers, self._there.registers, 0
        for direction in range(DIRECTIONS):
            if asked >> direction & 1:
                other = self._reported(direction)
                if other is not None:
                    left = gap(there, other.registers)
                    nearer = left < gap(here, other.registers) - 500 // STEP_UM
                    mask |= (nearer and left < 6_000 // STEP_UM) << direction
        return mask

    def _look_nearer(self, asked, room):
        """The mask of those of the cells asked for that the parcel comes over within `_NEARER_UM`.

        Or on the way that is left, where that is less.
        """
        steering = self.steering
        wish, left = steering.wish, steering.left
        if not steering.wishes():
            return 0
        speed_um_s = length(wish[0], wish[1], wish[2])
        # Slower than this are those alone that have less to go.
        time_ms = _NEARER_UM * 1000 // speed_um_s if speed_um_s > _NEARER_UM else 1000
        way_um = [_nearer(left[axis], wish[axis] * time_ms // 1000) for axis in range(3)]
        return self._covers_at(way_um, asked, room)

    # The beat

    @micropython.native
    def may_go_on(self, program, step_ms, alone, held):
        """Return whether a parcel may go on; without its host for twice its planned time at most.

        Time in which it is `held` for want of a promise does not count, up to 30 s. A parcel
        needs a new program once its time is over. The same holds if its host was gone and it is not
        to go on: a host that is back moves nothing.
        """
        if program.identity != self._identity:
            # Time that another parcel took from it still belongs to it.
            self._identity = program.identity
            self.begin(program.identity)
        if alone:
            if held and self.alone_ms and self._waited_ms < 30_000:
                self._waited_ms += step_ms
            else:
                self.alone_ms = min(self.alone_ms + step_ms, _LONG_MS)
            in_time = not self._planned_ms or self.alone_ms < 2 * self._planned_ms
            if not (program.goes_on and in_time):
                self._ended = True
        elif self.alone_ms:
            self.alone_ms = self._waited_ms = self._planned_ms = 0
        return not self._ended

    @micropython.native
    def step(self, program, may_go, step_ms):
        """Lead the wheels for a beat; without `may_go` bring the parcel to rest, and switch off."""
        parcel, here, steering = self._parcel, self._place, self.steering
        if self._driving and not self._axes.driving():
            # A fault or another node has switched them off.
            self._driving = False
        if not self._driving or not self._axes.follow():
            self._join(may_go)
        steering.read(program)
        steering.find_wish(parcel, here.x_um, here.y_um)
        stands = steering.approach(parcel.reach_um, may_go, step_ms)
        # A cell that the parcel comes to when the host is gone counts from there.
        if self.alone_ms and not self._planned_ms:
            self._plan(program)
        if stands and (steering.arrived or not may_go):
            if self._has_held():
                return
        else:
            self._held_beats = 0
        if not self._driving:
            shown = parcel.twist.shown
            if shown[WHEELS] < _SHOWING_WHEELS or shown[OFF] >= 25_000:
                # While the motion is not known, a wheel that is off rolls along. With a speed of
                # its own it would turn the parcel.
                return
            self._driving = True
        self._turn_wheels()

    @micropython.native
    def _turn_wheels(self):
        """Have the wheels move with the parcel as commanded."""
        footprint, targets = self._footprint, self._targets
        footprint.find_levers(self._parcel, 1 << OWN)
        for axis in range(AXES):
            targets[axis] = footprint.wheel_speed(OWN, axis, self.steering.commanded)
        self._axes.lead(targets)

    def _join(self, may_go):
        """Begin with the twist that the parcel has; a wheel without anywhere to go stays off.

        Wheels that come back begin so too. Else they would start with the full speed of the
        program under a parcel that stands, and it could not stand again where it has to.
        """
        steering = self.steering
        going = may_go and not steering.arrived
        for axis in range(3):
            steering.commanded[axis] = self._parcel.twist.speeds[axis] if going else 0

    def _has_held(self):
        """Hold the parcel; return whether it was held long and stands, with the wheels off.

        Wheels that are off hardly brake a heavy parcel: it would roll on.
        """
        self._held_beats = min(self._held_beats + 1, _HOLD_BEATS)
        if self._driving:
            if self._held_beats < _HOLD_BEATS or self._rolls():
                return False
            self._driving = False
            self._axes.rest()
        return True

    def _rolls(self):
        """Whether the parcel has not come to rest, as enough wheels show.

        With three speeds of 4 mm/s together it rolls, until they are no more than 0.3 mm/s.
        """
        parcel = self._parcel
        most_um_s = 300 if self._rolled else 4_000
        shown = parcel.twist.shown[WHEELS] >= _SHOWING_WHEELS
        self._rolled = shown and parcel.speed() > most_um_s
        return self._rolled

    def _plan(self, program):
        """Find how long the way takes, to the goal and along the legs that follow."""
        reach_um, steering = self._parcel.reach_um, self.steering
        speed_mm_s = max(steering.speed_mm_s(), 1)
        ramps_ms = 2 * speed_mm_s * 1000 // max(steering.acceleration_mm_s2, 1)
        x_um, y_um, turn = steering.left
        planned_ms = size(x_um, y_um, turn, reach_um) // speed_mm_s + ramps_ms
        for leg in range(program.known_legs()):
            x_um, y_um, turn = program.place(leg)
            to_x_um, to_y_um, to_turn = program.place(leg + 1)
            turned = wrapped(to_turn - turn)
            way_um = size(to_x_um - x_um, to_y_um - y_um, turned, reach_um)
            planned_ms += way_um // speed_mm_s + ramps_ms + _SETTLED_MS
        # Twice that time can be counted.
        self._planned_ms = min(planned_ms, _LONG_MS // 2)


def _nearer(left_um, way_um):
    """The shorter of two ways, of equal ones the second."""
    return left_um if abs(left_um) < abs(way_um) else way_um


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
