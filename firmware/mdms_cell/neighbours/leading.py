"""Leads the cell's two wheels: finds the cells that the parcel needs next, steers, and rests."""

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython

from mdms_cell.neighbours.belief import TURN, X, Y
from mdms_cell.neighbours.geometry.angle import ARM_UM, wrapped
from mdms_cell.neighbours.geometry.outline import STEP_UM, place
from mdms_cell.neighbours.geometry.outline import X as CENTRE_X
from mdms_cell.neighbours.geometry.outline import Y as CENTRE_Y
from mdms_cell.neighbours.geometry.place import AXES
from mdms_cell.neighbours.steering import SETTLED_MS, Steering, length
from mdms_cell.neighbours.twist import OFF, WHEELS

#: From the wish to brake until all cells under the parcel do: HOPS times the beats that `hold` may
#: take and counts. And how far ahead a cell asks [ms].
_REACTION_MS = const(200)
_ASK_MS = const(500)
#: At the goal, or where it is held, the wheels hold for so long before they are switched off.
_HOLD_BEATS = const(50)
#: To a wheel that is to join in the parcel's motion, fewer wheels do not show it, nor wheels that
#: are off what is known of it by more than this [um/s].
_JOIN_WHEELS = const(4)
_JOIN_OFF_UM_S = const(25_000)
#: No speed at all.
_NOWHERE = (0, 0, 0)
_ARM = const(8000)
assert _ARM * STEP_UM == ARM_UM


class Leading:
    """The wheels of one cell under one parcel, by its program."""

    def __init__(self, place, footprint, axes):
        self._place = place
        self._footprint = footprint
        self._axes = axes
        self._steering = Steering()
        self._driving = False
        self._identity = 0
        self.begin()

    def begin(self):
        """A new program has come."""
        self._alone_ms = 0
        self._planned_ms = 0
        self._ended = False
        self._held_beats = 0
        self._steering.arrived = False

    def next_leg(self):
        """The next leg of the same way begins: time for it was planned, and goes on."""
        self._held_beats = 0
        self._steering.arrived = False

    def plan_again(self):
        """More of the way has come: the time that is planned for it counts anew."""
        self._planned_ms = 0

    def stop(self):
        """Switch the wheels off in good order, if they are on."""
        if self._driving:
            self._driving = False
            self._axes.rest()
        self._held_beats = 0
        self._steering.reset()

    @micropython.native
    def arrived(self):
        """Whether the parcel stands at its goal."""
        return self._steering.arrived and self._steering.stands()

    @micropython.native
    def look_ahead(self, tracking, program):
        """Masks of the neighbours that the parcel covers or will before it can stand, and of those
        that it will cover soon.
        """
        footprint, outline, wish = self._footprint, tracking.outline, self._steering.wish
        here = footprint.mask(outline)
        if program is None or not program.complete:
            return here, here
        belief, acceleration_mm_s2 = tracking.belief, program.acceleration_mm_s2
        _move_on(
            outline, belief.registers, tracking.twist.speeds(), _REACTION_MS, acceleration_mm_s2
        )
        asks = needs = footprint.mask(outline, here)
        if wish != _NOWHERE:
            _move_on(outline, belief.registers, wish, _ASK_MS, acceleration_mm_s2)
            asks = footprint.mask(outline, needs)
        belief.place()
        return needs, asks

    @micropython.native
    def may_go_on(self, program, step_ms, *, alone):
        """Whether a parcel may go on; without its host for twice its planned time, if it is to.

        Once that is over, or the host of one that is not to go on was gone, a new program has to
        come: that the host is back moves nothing.
        """
        if program.identity != self._identity:
            # What another parcel took of its time is its own.
            self._identity = program.identity
            self.begin()
        if not alone:
            self._alone_ms = self._planned_ms = 0
        else:
            self._alone_ms = min(self._alone_ms + step_ms, 1 << 20)
            in_time = not self._planned_ms or self._alone_ms < 2 * self._planned_ms
            self._ended = self._ended or not (program.goes_on and in_time)
        return not self._ended

    @micropython.native
    def step(self, tracking, program, may_go, step_ms):
        """Lead the wheels for a beat; without `may_go` bring the parcel to rest, and switch off."""
        steering, twist = self._steering, tracking.twist
        if not self._driving:
            # A wheel that is off stays so while there is nowhere to go.
            going = may_go and not steering.arrived
            steering.join(*(twist.speeds() if going else _NOWHERE))
        here, pose = self._place, tracking.belief.registers
        dx_um = program.goal_x_um - here.x_um - pose[X]
        dy_um = program.goal_y_um - here.y_um - pose[Y]
        dturn_um = wrapped(program.goal_turn_um - pose[TURN])
        reach_um = tracking.outline.reach_um
        steering.step(program, reach_um, (dx_um, dy_um, dturn_um), may_go=may_go, step_ms=step_ms)
        # A cell that the parcel comes to when the host is gone counts from there.
        if self._alone_ms and not self._planned_ms:
            self._plan(program, reach_um, length(dx_um, dy_um, dturn_um * reach_um // ARM_UM))
        if steering.stands() and (steering.arrived or not may_go):
            self._held_beats = min(self._held_beats + 1, _HOLD_BEATS)
            if self._held_beats >= _HOLD_BEATS or not self._driving:
                if self._driving:
                    self._driving = False
                    self._axes.rest()
                return
        else:
            self._held_beats = 0
        if not self._driving:
            shown = twist.registers
            if shown[WHEELS] < _JOIN_WHEELS or shown[OFF] >= _JOIN_OFF_UM_S:
                # Off it rolls along; with a speed of its own it would turn the parcel.
                return
            self._driving = True
        self._axes.lead(self._targets_um_s(tracking.outline.registers))

    def _plan(self, program, reach_um, way_um):
        """Find how long the way takes, to the goal and along the legs that follow."""
        speed_mm_s = max(program.speed_um_s // 1000, 1)
        ramps_ms = 2 * speed_mm_s * 1000 // max(program.acceleration_mm_s2, 1)
        self._planned_ms = way_um // speed_mm_s + ramps_ms
        for leg in range(program.known_legs()):
            x_um, y_um, turn = program.place(leg)
            to_x_um, to_y_um, to_turn = program.place(leg + 1)
            turning_um = wrapped(to_turn - turn) * reach_um // ARM_UM
            way_um = length(to_x_um - x_um, to_y_um - y_um, turning_um)
            self._planned_ms += way_um // speed_mm_s + ramps_ms + SETTLED_MS

    @micropython.native
    def _targets_um_s(self, centre):
        """The speeds of wheels that move with the parcel as commanded."""
        footprint, steering = self._footprint, self._steering
        along_xs, along_ys, xs, ys = footprint.along_x, footprint.along_y, footprint.x, footprint.y
        centre_x, centre_y = centre[CENTRE_X], centre[CENTRE_Y]
        vx, vy, turn = steering.vx, steering.vy, steering.turn
        targets = [0, 0]
        for axis in range(AXES):
            along_x, along_y = along_xs[axis], along_ys[axis]
            lever = (along_y * (xs[axis] - centre_x) - along_x * (ys[axis] - centre_y)) // _ARM
            targets[axis] = along_x * vx + along_y * vy + lever * turn >> 9
        return targets


@micropython.native
def _move_on(outline, pose, twist_um_s, ahead_ms, acceleration_mm_s2):
    """Place an outline where the parcel will be, having braked after a time ahead."""
    vx, vy, turn = twist_um_s
    ahead_ms += length(vx, vy, turn) // (2 * (acceleration_mm_s2 or 1))
    place(
        outline.registers,
        pose[X] + vx * ahead_ms // 1000,
        pose[Y] + vy * ahead_ms // 1000,
        pose[TURN] + turn * ahead_ms // 1000,
    )
