"""The neighbour layer: in each beat what came is taken in, decided upon, and the wheels are led.

At SYNC the cell sends its speeds and, if it is at a parcel, its estimate; `UPDATE_MS` later those
of its neighbours have come, and `update` runs in the background. What it decides holds for a beat.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.canopen.objects import find
from mdms_cell.motion.leading import Leading
from mdms_cell.motion.pages import AHEAD, OUTDATED, Pages
from mdms_cell.motion.program import next_sequence
from mdms_cell.motion.steering import ARRIVED, has_arrived
from mdms_cell.perception import place
from mdms_cell.perception.angle import turn_um
from mdms_cell.perception.footprint import UNSEEN_CERTAINTY, UNSEEN_ROOM, Footprint
from mdms_cell.perception.heard import NEVER, OWN, SEEN, Heard
from mdms_cell.perception.outline import Outline
from mdms_cell.perception.place import DIRECTIONS, Place
from mdms_cell.perception.suspicion import CODE, SOURCE, Suspicion, judging
from mdms_cell.perception.tracking import LOST_BEATS, Tracking, updater
from mdms_cell.rights import precedence, right_of_way
from mdms_cell.rights.right_of_way import NONE, UNDER, UNKNOWN, RightOfWay
from mdms_cell.ticks import IDLE_MS, after, diff
from mdms_protocol import indices
from mdms_protocol.compat import const, micropython, ptr16, ptr32
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.frames import pack_estimate

#: From SYNC until speeds and estimates of all cells of a bus have come.
UPDATE_MS = const(7)
#: A SYNC that has waited for longer is answered, but has no update: the one after it would be late.
LATE_MS = const(2)
#: A neighbour under a parcel that is heard, and has sent no estimate for so long, has left it.
_LEFT_BEATS = const(30)
#: A step between two SYNCs is counted as no more than this.
_STEP_MAX_MS = const(50)
_ESTIMATE_PDO = const(2)
# Constants of other modules that are used in every beat; they would be looked up.
_IDLE_MS = const(1000)
_OWN = const(8)
_SEEN = const(0x80)
_LOST_BEATS = const(100)
_UNDER = const(3)
assert (_IDLE_MS, _OWN, _SEEN) == (IDLE_MS, OWN, SEEN)
assert (_LOST_BEATS, _UNDER) == (LOST_BEATS, UNDER)
# Fields of an estimate, ...
_IDENTITY = const(3)
_STATE = const(4)
_WANTS = const(5)
_HOLD = const(7)
_SEQUENCE = const(8)
_FLAGS = const(9)
assert (_IDENTITY, _STATE, _WANTS) == (wire.IDENTITY, wire.STATE, wire.WANTS)
assert (_HOLD, _SEQUENCE, _FLAGS) == (wire.HOLD, wire.SEQUENCE, wire.FLAGS)
_ARRIVED = const(1)
_LACKING = const(2)
_CONTRADICTED = const(4)
assert (_ARRIVED, _LACKING, _CONTRADICTED) == (wire.ARRIVED, wire.LACKING, wire.CONTRADICTED)
# ... and registers of a right of way and of a steering.
_RIGHT_IDENTITY = const(0)
_RIGHT_STATE = const(1)
_RIGHT_HOLD = const(2)
_DRIVE_BEATS = const(3)
_LACKING_CELLS = const(4)
_STEERING_ARRIVED = const(12)
assert _STEERING_ARRIVED == ARRIVED
assert (_RIGHT_IDENTITY, _RIGHT_STATE) == (right_of_way.IDENTITY, right_of_way.STATE)
assert (_RIGHT_HOLD, _DRIVE_BEATS) == (right_of_way.HOLD, right_of_way.DRIVE_BEATS)
assert _LACKING_CELLS == right_of_way.LACKING
_OUTDATED = const(2)
assert _OUTDATED == OUTDATED
_FIRST_OF_ORDER = const(6)
assert precedence.FIRST == _FIRST_OF_ORDER
# The clock wraps, see `ticks`; a difference of two instants is negative from here on.
_WRAP = const((1 << 30) - 1)
_BEFORE = const(1 << 29)

# What a layer keeps from beat to beat, behind the fields of the estimate that is to be sent
_DUE = const(10)  # 1 while an update is to follow
_SKIPPED = const(11)  # beats since the last one
_OVER = const(12)  # what it passed to the right of way, three numbers
_NEEDS = const(13)
_OCCUPIED = const(14)
_STEP_MS = const(15)  # the time that the last update was of
_CAME_MS = const(16)  # the last SYNC, and the one of the last update
_UPDATED_MS = const(17)
_PERIOD_MS = const(18)
_SUSPECT = const(19)  # the direction that is reported, -1 for none
_NONSENSE = const(20)
_REGISTERS = const(21)
assert _DUE == wire.ESTIMATE_FIELDS


class Layer:
    """The layer of one cell, off until it is `active`.

    `now()` returns the time [ms], `wake(wait_ms)` has a poll follow in so many milliseconds at the
    latest, and `changed()` is called when the identifiers have changed.
    """

    def __init__(self, objects, registers, *, axes, pdos, consumer, emcy, now, wake, changed):
        self._objects = objects
        self._registers = registers
        self._axes = axes
        self._pdos = pdos
        self._emcy = emcy
        self._now = now
        self._wake = wake
        self._changed = changed
        self.active = False
        self._place = Place(objects, self._on_place)
        self._heard = Heard()
        self._footprint = Footprint(self._place)
        self._suspicion = Suspicion()
        self._tracking = Tracking(self._place, self._footprint, self._heard, self._suspicion)
        self._leading = Leading(self._place, self._footprint, self._tracking, axes)
        self._rights = RightOfWay()
        self._pages = Pages(
            objects,
            self._place,
            self._heard,
            tracking=self._tracking,
            rights=self._rights,
            leading=self._leading,
            consumer=consumer,
            pdos=pdos,
        )
        #: Scratch: a parcel as a neighbour reports it.
        self._outline = Outline()
        self._beat = array("i", [0] * _REGISTERS)
        self._beat[_STEP_MS] = self._beat[_PERIOD_MS] = 10
        self._beat[_SUSPECT] = -1
        self._lead = _leading_on(self, consumer)
        self._write_estimate = _announcing(self)
        parts = self._footprint, self._heard, self._suspicion
        track = updater(self._tracking, self._place, *parts)
        self._update = _updating(self, consumer, track, judging(self._tracking, *parts))
        objects.watch(indices.CONTROL, self._on_place)

    def start(self, node_id):
        """The cell is 'operational'; nothing of before counts."""
        # A cell that finds itself among its neighbours has been given another's place.
        self.active = self.wanted and not self._place.names(node_id)
        self._rights.set_lease(self._objects.number(indices.LEASE, 1))
        self._beat[_PERIOD_MS] = self._objects.number(indices.LEASE, 2)
        self._heard.repeat_ms = self._objects.number(indices.TPDO_PARAMETERS + 1, 5)
        # A millisecond passes until the frame with the edge has come.
        self._tracking.sensors.edge_late_ms = 1 + self._objects.number(indices.PRESENCE_DEBOUNCE)
        self._pages.node_id = node_id
        self._reset()

    def stop(self):
        """The cell is not 'operational' any more."""
        self.active = False
        self._reset()

    def _reset(self):
        """Forget all that must outlive no stop: parcel, programs, promises, and whose time it is.

        Settings stay, and so does the clock.
        """
        self._acquit()
        self._rights.restart(self._place.present())
        self._heard.reset()
        self._tracking.drop()
        self._pages.reset()
        self._leading.reset()
        for number in range(_STEP_MS):
            self._beat[number] = 0

    def load(self):
        """Take over everything from the dictionary."""
        self._place.load()
        self._on_place()

    def goes_on(self):
        """Whether the silence of the host ends no motion here.

        Where no parcel lies, one that goes on may come by; one that does not go on is stopped.
        """
        tracking = self._tracking
        program = self._pages.programs.find(tracking.identity if tracking.is_over() else 0)
        if program is not None and program.complete and not program.goes_on:
            return False
        return self.active and self._pages.programs.go_on()

    def _on_place(self, _index=0, _sub=0):
        self._footprint.load()
        self.stop()
        self._axes.led = self.wanted
        self._changed()

    # What comes

    @property
    def mailboxes(self):
        """Where frames of neighbours wait for an update."""
        return self._heard.boxes

    @property
    def nonsense(self):
        """How many of those were no estimates."""
        return self._beat[_NONSENSE]

    @property
    def wanted(self):
        """Whether the cell is to be led by the layer, and has been given its place."""
        return self._objects.number(indices.CONTROL) == 1 and self._place.known

    def receivers(self):
        """Pairs of an identifier and what takes its frames: a function, or a mailbox's number."""
        if self.wanted:
            for can_id, kind, direction in self._place.receivers():
                yield can_id, self._receiver(kind, direction)

    def _receiver(self, kind, direction):
        heard = self._heard
        if kind == place.SPEEDS:
            return DIRECTIONS + direction
        if kind == place.STATE:
            return lambda data: heard.on_state(direction, data, self._now())
        if kind == place.ESTIMATE:
            return direction
        return lambda data: not self.active or self._pages.on_page(direction, data)

    # The beat

    @micropython.native
    def on_sync(self, now_ms, waited_ms):
        """SYNC: send the estimate of the last update, and have the next update follow.

        That was `waited_ms` ago. Where updates take so long that it has waited for the end of one,
        it has none itself, so that every second or third is on time, and none is late by chance.
        """
        if not self.active:
            return
        beat = self._beat
        due = beat[_DUE]
        came_ms = now_ms - waited_ms & _WRAP
        beat_ms = (came_ms - beat[_CAME_MS] + _BEFORE & _WRAP) - _BEFORE
        # Or two beats meet, and what has come is of either.
        gap = beat_ms > 2 * beat[_PERIOD_MS] or (due and beat_ms < UPDATE_MS)
        if gap:
            beat[_UPDATED_MS] = beat[_CAME_MS]
        elif due:
            self._skip(came_ms)
        beat[_CAME_MS] = came_ms
        if beat[_IDENTITY]:
            self._pdos.trigger(_ESTIMATE_PDO)
        if gap:
            self._rights.on_gap()
            self._pages.on_gap(beat_ms // beat[_PERIOD_MS])
            beat[_NONSENSE] += self._heard.read()
            # What has come may be of any age: it is not passed on.
            self._heard.passed_on()
        self._heard.begin_beat(self._registers)
        beat[_DUE] = waited_ms <= LATE_MS
        if not beat[_DUE]:
            self._skip(after(came_ms, beat[_PERIOD_MS]))
            return
        self._wake(UPDATE_MS - waited_ms)

    def _skip(self, next_ms):
        """A beat passes without an update, and the next SYNC is at `next_ms`.

        What came since the last one still waits. So for right of way nothing has come, and a lease
        that ends with this beat ends the motion now; the estimate is of where the parcel will be.
        """
        beat = self._beat
        beat[_SKIPPED] += 1
        self._rights.on_beat(beat[_OVER], beat[_NEEDS], beat[_OCCUPIED])
        if not self._rights.registers[_DRIVE_BEATS]:
            program = self._pages.programs.complete(self._tracking.identity)
            self._lead(program, beat[_STEP_MS], beat[_SKIPPED])
        self._write_estimate(diff(next_ms, beat[_UPDATED_MS]))

    @micropython.native
    def poll(self, now_ms, presence):
        """Update when it is time; return in how many milliseconds the next update is due."""
        if not self.active:
            return _IDLE_MS
        heard = self._heard
        if presence | _SEEN != heard.presence[_OWN]:
            heard.take_presence(_OWN, presence, now_ms)
        beat = self._beat
        if not beat[_DUE]:
            return _IDLE_MS
        wait_ms = UPDATE_MS - (now_ms - beat[_CAME_MS] + _BEFORE & _WRAP) + _BEFORE
        if wait_ms > 0:
            return wait_ms
        beat[_DUE] = 0
        self._update(presence)
        return _IDLE_MS

    def _keep_order(self, order, alone):
        """Parcels come over the cell in an order, which counts for the time without the host."""
        estimates, fresh = self._heard.estimates, self._heard.boxes.fresh
        right = self._rights.registers
        here, state = right[_RIGHT_IDENTITY], right[_RIGHT_STATE]
        turn = precedence.turn(order, here, state, estimates, fresh)
        if alone:
            precedence.keep(order, turn, estimates, fresh)

    def _look_around(self, sent):
        """After a restart: what lies over the square, by the neighbours that are heard.

        `sent` is the mask of those whose estimates have come. The page of a parcel whose size is
        not known is asked for.
        """
        heard, rights = self._heard, self._rights
        stamps = heard.boxes.stamps
        self._pages.asked = 0
        for direction in range(DIRECTIONS):
            if sent >> direction & 1:
                rights.hear(direction, self._reported_over(direction))
            elif _age(heard.beat, stamps[DIRECTIONS + direction]) <= 1 and (
                heard.estimates[direction * wire.ESTIMATE_FIELDS + _STATE] != _UNDER
                or _age(heard.beat, heard.estimate_beat[direction]) > _LEFT_BEATS
            ):
                rights.hear(direction, 0)
        if self._pages.asked:
            rights.approach(self._pages.asked)

    def _reported_over(self, direction):
        """The parcel that a neighbour reports over this cell's square, as in `hear`."""
        estimates, at = self._heard.estimates, direction * wire.ESTIMATE_FIELDS
        identity = estimates[at + _IDENTITY]
        if not identity or estimates[at + _STATE] != _UNDER:
            return 0
        program = self._pages.programs.find(identity)
        if program is None or not program.has_parcel:
            self._pages.asked = identity
            return UNKNOWN
        certainty = estimates[at + wire.CERTAINTY]
        if not certainty:
            return 0 if self._has_pose(identity) else UNKNOWN
        x_um, y_um = self._place.shift_um(direction)
        x_um += estimates[at + wire.X] * wire.STEP_UM
        y_um += estimates[at + wire.Y] * wire.STEP_UM
        self._outline.set(*program.size())
        self._outline.place(x_um, y_um, turn_um(estimates[at + wire.YAW]))
        unseen = program.unplanned and certainty <= UNSEEN_CERTAINTY
        room = UNSEEN_ROOM if unseen else 0
        return identity if self._footprint.reaches(self._outline, room) else 0

    def _has_pose(self, identity):
        """Whether any neighbour has said lately where this parcel is."""
        heard = self._heard
        for direction in range(DIRECTIONS):
            at = direction * wire.ESTIMATE_FIELDS
            if (
                _age(heard.beat, heard.estimate_beat[direction]) <= 1
                and heard.estimates[at + _IDENTITY] == identity
                and heard.estimates[at + _STATE] == _UNDER
                and heard.estimates[at + wire.CERTAINTY]
            ):
                return True
        return False

    def _choose_parcel(self):
        """Be at the parcel that lies here, or else at the one that the right of way says."""
        tracking, right = self._tracking, self._rights.registers
        identity = right[_RIGHT_IDENTITY]
        if identity and identity != tracking.identity:
            tracking.adopt(identity)
        elif not identity and right[_RIGHT_STATE] == NONE and not tracking.belief.known:
            tracking.drop()
        if tracking.identity and not tracking.shaped:
            program = self._pages.programs.find(tracking.identity)
            if program is not None and program.has_parcel:
                tracking.take_shape(program)

    def _go_on(self, program):
        """Take the next leg, without the host, at the end of this one; so do all under the parcel.

        The host gives a leg when its way is free; from now on promises alone keep others apart, in
        the order of `precedence`.
        """
        if not program.legs:
            return
        follows = self._leading.arrived() or self._is_another_at(next_sequence(program.sequence))
        if follows and program.advance():
            self._leading.next_leg()

    def _is_another_at(self, sequence):
        """Whether a neighbour that had the cell's program has gone on to this sequence."""
        estimates, ahead = self._heard.estimates, self._pages.registers[AHEAD]
        for direction in range(DIRECTIONS):
            its = estimates[direction * wire.ESTIMATE_FIELDS + _SEQUENCE]
            if ahead >> direction & 1 and its == sequence:
                return True
        return False

    # Who is suspected

    def _report(self):
        """Report another suspect than before, in an emergency and in its object."""
        direction = self._beat[_SUSPECT] = self._suspicion.first()
        self._emcy.clear(SOURCE)
        node_id = 0
        if direction >= 0:
            node_id = self._pages.node_id if direction == OWN else self._place.nodes[direction]
            self._emcy.report(SOURCE, CODE, bytes((node_id, self._suspicion.out[direction], 0, 0)))
        self._objects.put(indices.SUSPECT, 0, node_id)

    def _acquit(self):
        """Suspect nobody."""
        self._suspicion.reset()
        if self._beat[_SUSPECT] >= 0:
            self._report()


def _updating(layer, consumer, track, judge):  # noqa: PLR0915 - one algorithm, in its order
    """What updates a layer after SYNC, with little to be looked up."""
    heard, rights, tracking = layer._heard, layer._rights, layer._tracking

    @micropython.native
    def update(  # noqa: PLR0917 - all is at hand
        presence,
        layer=layer,
        beat=layer._beat,
        tracking=tracking,
        right=rights.registers,
        estimates=heard.estimates,
        fresh=heard.boxes.fresh,
        read=heard.read,
        rights=rights,
        take_estimates=rights.on_estimates,
        track=track,
        consumer=consumer,
        pages=layer._pages,
        programs=layer._pages.programs,
        look_ahead=layer._leading.look_ahead,
        decide=rights.on_beat,
        judge=judge,
        first_suspect=layer._suspicion.first,
        lead=layer._lead,
        steered=layer._leading.registers,
        write_estimate=layer._write_estimate,
        compare=layer._pages.compare,
        hand_on=layer._pages.hand_on,
        order=layer._pages.order,
    ):
        sync_ms = beat[_CAME_MS]
        step_ms = diff(sync_ms, beat[_UPDATED_MS])
        step_ms = 1 if step_ms < 1 else _STEP_MAX_MS if step_ms > _STEP_MAX_MS else step_ms
        beat[_STEP_MS] = step_ms
        beat[_UPDATED_MS] = sync_ms
        beat[_NONSENSE] += read()
        if order[_FIRST_OF_ORDER]:
            layer._keep_order(order, consumer.lost)
        sent = take_estimates(estimates, fresh)
        if rights.unsure:
            layer._look_around(sent)
        if not tracking.under:
            layer._choose_parcel()
        track(step_ms, sync_ms)
        if tracking.missing_beats >= _LOST_BEATS:
            tracking.drop()
        identity, under = tracking.identity, tracking.under
        if consumer.lost:
            programs.outdate(identity)
        program = programs.complete(identity)
        verdict = compare(identity, program, sent)
        ahead = look_ahead(program, right[_LACKING_CELLS]) if under else 0
        needs = beat[_NEEDS] = ahead & 0xFF
        over = identity if under or tracking.is_over() else 0
        if over and right[_RIGHT_STATE] != _UNDER and tracking.is_of_another():
            # A parcel that stands before what nobody knows would come over it mm by mm.
            over = 0
        occupied = presence != 0
        beat[_OVER] = over
        beat[_OCCUPIED] = occupied
        decide(over, needs, occupied)
        judge(needs if right[_RIGHT_STATE] == _UNDER else 0)
        if first_suspect() != beat[_SUSPECT]:
            layer._report()
        skipped = beat[_SKIPPED]
        outdated = verdict == _OUTDATED
        lead(None if outdated and not consumer.lost else program, step_ms, skipped)
        flags = _CONTRADICTED if beat[_SUSPECT] >= 0 else 0
        if steered[_STEERING_ARRIVED] and has_arrived(steered):
            flags |= _ARRIVED
        shown = None if pages.asked or outdated else program
        if shown is None or not shown.whole:
            flags |= _LACKING
        beat[_WANTS] = ahead >> 8
        beat[_SEQUENCE] = 0 if shown is None else shown.sequence
        beat[_FLAGS] = flags
        write_estimate(step_ms)
        if sent and under and program is not None and not verdict:
            hand_on(program, sent, skipped)
        beat[_SKIPPED] = 0

    return update


def _leading_on(layer, consumer):
    """What leads the wheels towards the goal of a program while all is clear; else they rest."""
    tracking, leading = layer._tracking, layer._leading

    @micropython.native
    def lead(  # noqa: PLR0917 - all is at hand
        program,
        step_ms,
        skipped,
        layer=layer,
        right=layer._rights.registers,
        tracking=tracking,
        is_doubtful=tracking.is_doubtful,
        stop=leading.stop,
        may_go_on=leading.may_go_on,
        step=leading.step,
        consumer=consumer,
    ):
        under = right[_RIGHT_STATE] == _UNDER and tracking.under
        if program is None or not under or is_doubtful():
            stop()
            return
        alone = consumer.lost
        # As many beats as were skipped before this update may be before the next.
        held = right[_DRIVE_BEATS] <= skipped
        allowed = may_go_on(program, step_ms, alone, held)
        if alone and allowed:
            layer._go_on(program)
        step(program, allowed and not held, step_ms)

    return lead


def _announcing(layer):
    """What writes the estimate that the next SYNC is to send."""
    at = find(indices.ESTIMATE, 1).place

    @micropython.native
    def write(  # noqa: PLR0917 - all is at hand
        ahead_ms,
        fields=layer._beat,
        right=layer._rights.registers,
        announce=layer._tracking.announce,
        put_right=_write_right,
        pack=pack_estimate,
        frames=layer._objects.data,
        at=at,
    ):
        """So long after the SYNC that the belief is of."""
        announce(fields, ahead_ms)
        put_right(fields, right)
        pack(fields, 0, frames, at)

    return write


@micropython.viper
def _write_right(fields: ptr32, right: ptr16):
    """Write into an estimate what a right of way has to say."""
    fields[_IDENTITY] = right[_RIGHT_IDENTITY]
    fields[_STATE] = right[_RIGHT_STATE]
    fields[_HOLD] = right[_RIGHT_HOLD]
    if right[_RIGHT_STATE] != _UNDER:
        fields[_WANTS] = 0


def _age(beat, came):
    """How many beats ago something came; many if it never has."""
    return NEVER if came == NEVER else beat - came & 0xFFFFFF
