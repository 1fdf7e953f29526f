"""Leads the cell's two wheels: finds the cells that the parcel needs next, steers, and rests."""

from array import array

from mdms_cell.motion.steering import REACTION_MS, SETTLED_MS, Steering, length, size
from mdms_cell.perception.angle import wrapped
from mdms_cell.perception.outline import STEP_UM, Outline, gap
from mdms_cell.perception.place import AXES, DIRECTIONS, OWN
from mdms_cell.perception.twist import OFF, WHEELS
from mdms_protocol.compat import const, micropython

#: At the goal, or where it is held, the wheels hold for so long before they are switched off.
_HOLD_BEATS = const(50)
#: A parcel that stands for want of a cell goes no nearer to it if it would come over it within this
#: way. It would gain only a fraction of the way, again and again.
_NEARER_UM = const(10_000)
#: So many wheels show how a parcel moves.
_SHOWING_WHEELS = const(4)
#: Times without a host are counted up to this.
_LONG_MS = const(1 << 20)


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
            needs |= self._comes_over(parcel.twist.speeds, REACTION_MS, present ^ needs, room)
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
            planned_ms += way_um // speed_mm_s + ramps_ms + SETTLED_MS
        # Twice that time can be counted.
        self._planned_ms = min(planned_ms, _LONG_MS // 2)


def _nearer(left_um, way_um):
    """The shorter of two ways, of equal ones the second."""
    return left_um if abs(left_um) < abs(way_um) else way_um
