"""Leads the cell's two wheels: finds the cells that the parcel needs next, steers, and rests."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.motion import steering
from mdms_cell.motion.steering import approach, find_wish, has_arrived, length
from mdms_cell.perception import belief, outline, twist
from mdms_cell.perception.angle import ARM_UM, wrapped
from mdms_cell.perception.footprint import (
    ALONG_X,
    ALONG_Y,
    HALF,
    POINT_X,
    POINT_Y,
    PRESENT,
    UNSEEN_ROOM,
    squares_overlapped,
)
from mdms_cell.perception.outline import STEP_UM, place
from mdms_cell.perception.twist import OFF, WHEELS
from mdms_protocol.compat import WIDEN, const, micropython, ptr32
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.frames import read_way

#: From the wish to brake until all cells under the parcel do: HOPS times the beats that `hold` may
#: take and counts. And how far ahead a cell asks [ms].
_REACTION_MS = const(200)
_ASK_MS = const(500)
#: At the goal, or where it is held, the wheels hold for so long before they are switched off.
_HOLD_BEATS = const(50)
#: Without its host a parcel stands for so long in all, while others have the right of way [ms].
_WAIT_MS = const(30_000)
#: Without its host a parcel asks for cells that it comes so much nearer to [steps]: it stands that
#: far from one that it has to wait for, and does not come over it by a hair before its turn.
_ROOM = const(187)
assert _ROOM == 3_000 // STEP_UM
#: A parcel that stands for want of a cell goes no nearer to it where it would come over it within
#: this way; what it gained would be a fraction of that, again and again.
_NEARER_UM = const(10_000)
#: To a wheel that is to join in the parcel's motion, fewer wheels do not show it, nor wheels that
#: are off what is known of it by more than this [um/s].
_JOIN_WHEELS = const(4)
_JOIN_OFF_UM_S = const(25_000)
_ARM = const(8000)
assert _ARM * STEP_UM == ARM_UM

# Shared constants, which would be looked up: of a program, ...
_ACCELERATION_MM_S2 = const(10)
assert _ACCELERATION_MM_S2 == wire.ACCELERATION_MM_S2
# ... where three numbers begin in the registers of a parcel ...
_CENTRE = const(0)
_BELIEF = const(10)
_TWIST = const(23)
_UNSEEN_ROOM = const(1750)
assert _UNSEEN_ROOM == UNSEEN_ROOM
assert (_CENTRE, _BELIEF, _TWIST) == (outline.X, belief.X, twist.VX)
# ... in those of a steering ...
_COMMANDED = const(0)
_WISH = const(3)
_WAY = const(6)
_ACCELERATION = const(9)
_ARRIVED = const(12)
assert (_COMMANDED, _WISH, _ARRIVED) == (steering.VX, steering.WISH, steering.ARRIVED)
assert (_WAY, _ACCELERATION) == (steering.LEFT, steering.ACCELERATION)

# ... and in those of a footprint.
_POINT_Y = const(7)
_ALONG_X = const(14)
_ALONG_Y = const(16)
_PRESENT = const(36)
_HALF = const(37)
assert (0, _POINT_Y, _PRESENT, _HALF) == (POINT_X, POINT_Y, PRESENT, HALF)
assert (_ALONG_X, _ALONG_Y) == (ALONG_X, ALONG_Y)

# Registers of a cell's wheels, after those of its steering
_DRIVING = const(17)  # 1 while the wheels are on
_HELD_BEATS = const(18)  # for so long they have held, up to _HOLD_BEATS
_TARGETS = const(19)  # of the two wheels [um/s]
_ALONE_MS = const(21)  # what of a program's time has passed without a host
_WAITED_MS = const(22)  # for how long the parcel stood meanwhile for want of a promise
_PLANNED_MS = const(23)  # all the time that its way takes; 0: not found yet
_ENDED = const(24)  # 1 once that was too long
_IDENTITY = const(25)  # of the parcel that the four before are about
_REGISTERS = const(26)
#: Times without a host are counted up to this.
_LONG_MS = const(1 << 20)
assert _DRIVING == steering.REGISTERS


class Leading:
    """The wheels of one cell under one parcel, by its program.

    Its `registers` begin with those of a steering, and are all that it remembers.
    """

    def __init__(self, place, footprint, tracking, axes):
        self._place = place
        self._footprint = footprint.registers
        self._parcel = tracking.belief.registers
        self._tracking = tracking
        self._axes = axes
        self.registers = array("i", [0] * _REGISTERS)

    def reset(self):
        """Switch the wheels off in good order, and forget everything."""
        self.stop()
        for number in range(_REGISTERS):
            self.registers[number] = 0

    def begin(self, identity):
        """A new program of this parcel has come, which may be on its way here only."""
        if identity == self.registers[_IDENTITY]:
            for number in range(_ALONE_MS, _IDENTITY):
                self.registers[number] = 0
            self.next_leg()

    def next_leg(self):
        """The next leg of the same way begins: time for it was planned, and goes on."""
        self.registers[_HELD_BEATS] = 0
        self.registers[_ARRIVED] = 0

    def plan_again(self):
        """More of the way has come: the time that is planned for it counts anew."""
        self.registers[_PLANNED_MS] = 0

    @micropython.native
    def stop(self):
        """Switch the wheels off in good order, if they are on."""
        registers = self.registers
        if registers[_DRIVING]:
            self._axes.rest()
        for number in range(_ALONE_MS):
            registers[number] = 0

    def arrived(self):
        """Whether the parcel stands at its goal."""
        return has_arrived(self.registers)

    @micropython.native
    def look_ahead(self, program, lacking=0):
        """Masks of the neighbours that the parcel covers or will before it can stand and, from bit
        8 on, of those that it will cover soon.

        Of those in the mask `lacking`, for want of which it stands, it needs the nearest already.
        It asks for those that it may lie over as long as no edge of it has been seen, too, and
        needs them where another parcel has them.
        """
        footprint, parcel = self._footprint, self._parcel
        present = footprint[_PRESENT]
        if program is None:
            ahead = squares_overlapped(parcel, footprint, present)
            ahead |= ahead << 8
        else:
            registers = self.registers
            room = _ROOM if registers[_ALONE_MS] else 0
            footprint[_HALF] += room
            # By the way that was left when the wish was found, before it is read anew.
            nearest = (
                _look_nearer(parcel, parcel, registers, footprint, lacking & present)
                if lacking
                else 0
            )
            read_way(program.pages, registers, _WAY)
            ahead = _look_ahead(parcel, parcel, registers, footprint, present)
            footprint[_HALF] -= room
            ahead |= nearest | nearest << 8
        if self._tracking.may_be_elsewhere():
            footprint[_HALF] += _UNSEEN_ROOM
            near = squares_overlapped(parcel, footprint, present)
            footprint[_HALF] -= _UNSEEN_ROOM
            ahead |= near & self._tracking.others | near << 8
        return ahead

    @micropython.native
    def may_go_on(self, program, step_ms, alone, held):
        """Whether a parcel may go on; without its host for twice its planned time, if it is to.

        That it is `held`, for want of a promise, does not count, up to `_WAIT_MS`. Once the time is
        over, or the host of one that is not to go on was gone, a new program has to come: that the
        host is back moves nothing.
        """
        registers = self.registers
        if program.identity != registers[_IDENTITY]:
            # What another parcel took of its time is its own.
            registers[_IDENTITY] = program.identity
            self.begin(program.identity)
        if alone:
            if held and registers[_ALONE_MS] and registers[_WAITED_MS] < _WAIT_MS:
                registers[_WAITED_MS] += step_ms
            else:
                registers[_ALONE_MS] = min(registers[_ALONE_MS] + step_ms, _LONG_MS)
            planned_ms = registers[_PLANNED_MS]
            in_time = not planned_ms or registers[_ALONE_MS] < 2 * planned_ms
            if not (program.goes_on and in_time):
                registers[_ENDED] = 1
        elif registers[_ALONE_MS]:
            registers[_ALONE_MS] = registers[_WAITED_MS] = registers[_PLANNED_MS] = 0
        return not registers[_ENDED]

    @micropython.native
    def step(self, program, may_go, step_ms):
        """Lead the wheels for a beat; without `may_go` bring the parcel to rest, and switch off."""
        registers, parcel, here = self.registers, self._parcel, self._place
        if not registers[_DRIVING]:
            self._join(may_go)
        read_way(program.pages, registers, _WAY)
        find_wish(registers, parcel, here.x_um, here.y_um)
        stands = approach(registers, parcel, may_go, step_ms)
        # A cell that the parcel comes to when the host is gone counts from there.
        if registers[_ALONE_MS] and not registers[_PLANNED_MS]:
            self._plan(program)
        if stands and (registers[_ARRIVED] or not may_go):
            if self._has_held():
                return
        else:
            registers[_HELD_BEATS] = 0
        if not registers[_DRIVING]:
            if parcel[WHEELS] < _JOIN_WHEELS or parcel[OFF] >= _JOIN_OFF_UM_S:
                # Off it rolls along; with a speed of its own it would turn the parcel.
                return
            registers[_DRIVING] = 1
        _aim(registers, parcel, self._footprint)
        self._axes.lead(registers, _TARGETS)

    def _join(self, may_go):
        """Begin with the twist that the parcel has; a wheel without anywhere to go stays off."""
        registers = self.registers
        going = may_go and not registers[_ARRIVED]
        for axis in range(3):
            registers[_COMMANDED + axis] = self._parcel[_TWIST + axis] if going else 0

    def _has_held(self):
        """The wheels hold the parcel, which stands; returns whether for long, and they are off."""
        registers = self.registers
        registers[_HELD_BEATS] = min(registers[_HELD_BEATS] + 1, _HOLD_BEATS)
        if registers[_DRIVING] and registers[_HELD_BEATS] < _HOLD_BEATS:
            return False
        if registers[_DRIVING]:
            registers[_DRIVING] = 0
            self._axes.rest()
        return True

    def _plan(self, program):
        """Find how long the way takes, to the goal and along the legs that follow."""
        registers, reach_um = self.registers, self._parcel[outline.REACH]
        speed_mm_s = max(registers[steering.SPEED] * wire.SPEED_MM_S, 1)
        acceleration_mm_s2 = registers[_ACCELERATION] * _ACCELERATION_MM_S2
        ramps_ms = 2 * speed_mm_s * 1000 // max(acceleration_mm_s2, 1)
        x_um, y_um, turn = registers[_WAY : _WAY + 3]
        way_um = length(x_um, y_um, turn * reach_um // ARM_UM)
        planned_ms = way_um // speed_mm_s + ramps_ms
        for leg in range(program.known_legs()):
            x_um, y_um, turn = program.place(leg)
            to_x_um, to_y_um, to_turn = program.place(leg + 1)
            turning_um = wrapped(to_turn - turn) * reach_um // ARM_UM
            way_um = length(to_x_um - x_um, to_y_um - y_um, turning_um)
            planned_ms += way_um // speed_mm_s + ramps_ms + steering.SETTLED_MS
        registers[_PLANNED_MS] = min(planned_ms, _LONG_MS)


@micropython.viper
def _look_ahead(bottom, parcel: ptr32, registers: ptr32, footprint, asked: int) -> int:
    """See `Leading.look_ahead`; of the cells in the mask `asked`.

    `bottom` is the parcel's registers too, to be passed on.
    """
    widen = int(WIDEN)
    x = parcel[_BELIEF] << widen >> widen
    y = parcel[_BELIEF + 1] << widen >> widen
    around = parcel[_BELIEF + 2] << widen >> widen
    twice_mm_s2 = 2 * _ACCELERATION_MM_S2 * registers[_ACCELERATION]
    twice_mm_s2 = twice_mm_s2 if twice_mm_s2 else 2
    covered = int(squares_overlapped(bottom, footprint, asked))
    needs = covered
    for ahead in range(2):
        vx = parcel[_TWIST] << widen >> widen
        vy = parcel[_TWIST + 1] << widen >> widen
        turn = parcel[_TWIST + 2] << widen >> widen
        time_ms = _REACTION_MS
        if ahead:
            needs = covered
            vx = registers[_WISH] << widen >> widen
            vy = registers[_WISH + 1] << widen >> widen
            turn = registers[_WISH + 2] << widen >> widen
            time_ms = _ASK_MS
        rest = asked ^ covered
        if rest and (ahead == 0 or vx or vy or turn):
            # It moves on until it brakes, and then by half as much as it would in that time.
            time_ms += int(length(vx, vy, turn)) // twice_mm_s2
            # Ways in pieces, for speeds times that time may be more than a word has room for.
            ahead_x = x + vx // 1000 * time_ms + vx % 1000 * time_ms // 1000
            ahead_y = y + vy // 1000 * time_ms + vy % 1000 * time_ms // 1000
            ahead_turn = around + turn // 1000 * time_ms + turn % 1000 * time_ms // 1000
            place(bottom, ahead_x, ahead_y, ahead_turn)
            covered |= int(squares_overlapped(bottom, footprint, rest))
    place(bottom, x, y, around)
    return needs | covered << 8


@micropython.viper
def _look_nearer(bottom, parcel: ptr32, registers: ptr32, footprint, asked: int) -> int:
    """The mask of those of the cells in a mask that the parcel comes over within `_NEARER_UM`.

    Or on the way that is left, where that is less.
    """
    widen = int(WIDEN)
    speed = 0
    for axis in range(3):
        speed |= registers[_WISH + axis]
    if speed == 0:
        return 0
    vx = registers[_WISH] << widen >> widen
    vy = registers[_WISH + 1] << widen >> widen
    turn = registers[_WISH + 2] << widen >> widen
    speed = int(length(vx, vy, turn))
    # Slower than this are those alone that have less to go.
    time_ms = _NEARER_UM * 1000 // speed if speed > _NEARER_UM else 1000
    for axis in range(3):
        wish = registers[_WISH + axis] << widen >> widen
        left = registers[_WAY + axis] << widen >> widen
        way = wish // 1000 * time_ms + wish % 1000 * time_ms // 1000
        if (left if left > 0 else 0 - left) < (way if way > 0 else 0 - way):
            way = left
        if axis == 0:
            vx = way
        elif axis == 1:
            vy = way
        else:
            turn = way
    x = parcel[_BELIEF] << widen >> widen
    y = parcel[_BELIEF + 1] << widen >> widen
    around = parcel[_BELIEF + 2] << widen >> widen
    place(bottom, x + vx, y + vy, around + turn)
    mask = int(squares_overlapped(bottom, footprint, asked))
    place(bottom, x, y, around)
    return mask


@micropython.viper
def _aim(registers: ptr32, parcel: ptr32, footprint: ptr32):
    """Find the speeds of wheels that move with the parcel as commanded [um/s]."""
    widen = int(WIDEN)
    vx = registers[_COMMANDED] << widen >> widen
    vy = registers[_COMMANDED + 1] << widen >> widen
    turn = registers[_COMMANDED + 2] << widen >> widen
    centre_x = parcel[_CENTRE] << widen >> widen
    centre_y = parcel[_CENTRE + 1] << widen >> widen
    for axis in range(2):
        along_x = footprint[_ALONG_X + axis] << widen >> widen
        along_y = footprint[_ALONG_Y + axis] << widen >> widen
        x = (footprint[axis] << widen >> widen) - centre_x
        y = (footprint[_POINT_Y + axis] << widen >> widen) - centre_y
        lever = (along_y * x - along_x * y) // _ARM
        # The product of lever and turn alone may be more than a word.
        speed = along_x * vx + along_y * vy + lever * (turn & 0x1FF) >> 9
        registers[_TARGETS + axis] = speed + lever * (turn >> 9)
