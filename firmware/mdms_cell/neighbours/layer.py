"""The neighbour layer: in each beat what came is taken in, decided upon, and the wheels are led.

At SYNC the cell sends its speeds and, if it is at a parcel, its estimate; `UPDATE_MS` later those
of its neighbours have come, and `update` runs in the background. What it decides holds for a beat.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython

from array import array

from mdms_cell.canopen.objects import find
from mdms_cell.neighbours.geometry import place
from mdms_cell.neighbours.geometry.footprint import Footprint
from mdms_cell.neighbours.geometry.place import DIRECTIONS, Place
from mdms_cell.neighbours.heard import OWN, Heard
from mdms_cell.neighbours.leading import Leading
from mdms_cell.neighbours.pages import Pages
from mdms_cell.neighbours.program import next_sequence
from mdms_cell.neighbours.right_of_way import NONE, UNDER, RightOfWay
from mdms_cell.neighbours.suspicion import CODE, SOURCE, Evidence, Suspicion
from mdms_cell.neighbours.tracking import LOST_BEATS, Tracking
from mdms_cell.ticks import IDLE_MS, after, diff
from mdms_protocol import indices
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.frames import (
    FLAGS,
    HOLD,
    IDENTITY,
    LACKING,
    SEQUENCE,
    STATE,
    WANTS,
    pack_estimate,
)

#: From SYNC until speeds and estimates of all cells of a bus have come.
UPDATE_MS = const(7)
#: A SYNC that has waited for longer is answered, but has no update: the one after it would be late.
LATE_MS = const(2)
#: A step between two SYNCs is counted as no more than this.
_STEP_MAX_MS = 50
_ESTIMATE_PDO = const(2)
# Constants of other modules that are used in every beat; they would be looked up.
_IDLE_MS = const(1000)
_OWN = const(8)
_IDENTITY = const(3)
# The clock wraps, see `ticks`; a difference of two instants is negative from here on.
_WRAP = const((1 << 30) - 1)
_BEFORE = const(1 << 29)
assert (_IDLE_MS, _OWN, _IDENTITY) == (IDLE_MS, OWN, IDENTITY)
#: Whom a parcel needs and asks that does not lie here.
_NOBODY = (0, 0)


class Layer:
    """The layer of one cell, off until it is `active`.

    `now()` returns the time [ms], `wake(wait_ms)` has a poll follow in so many milliseconds at the
    latest, and `changed()` is called when the identifiers have changed. `mailboxes` is where frames
    of neighbours wait for an update; `nonsense` counts those that were no estimates.
    """

    def __init__(self, objects, registers, *, axes, pdos, consumer, emcy, now, wake, changed):
        self._objects = objects
        self._registers = registers
        self._axes = axes
        self._pdos = pdos
        self._consumer = consumer
        self._emcy = emcy
        self._now = now
        self._wake = wake
        self._changed = changed
        self.active = False
        self._fields = array("i", [0] * wire.ESTIMATE_FIELDS)
        self._place = Place(objects, self._on_place)
        self._heard = Heard()
        self.mailboxes = self._heard.boxes
        self.nonsense = 0
        self._footprint = Footprint(self._place)
        self._suspicion = Suspicion()
        self._suspect = -1
        self._evidence = Evidence(self._footprint, self._heard, self._suspicion)
        self._tracking = Tracking(self._place, self._footprint, self._heard, self._suspicion)
        self._leading = Leading(self._place, self._footprint, axes)
        self._pages = Pages(
            objects,
            self._place,
            self._heard,
            tracking=self._tracking,
            leading=self._leading,
            consumer=consumer,
            pdos=pdos,
        )
        self._rights = RightOfWay()
        self._came_ms = 0  # the last SYNC, and the one of the last update
        self._updated_ms = 0
        self._step_ms = self._period_ms = 10
        self._situation = 0, 0, False
        self._skipped = 0
        self._due = False
        self._node_id = 0
        self._estimate_at = find(indices.ESTIMATE, 1).place
        objects.watch(indices.CONTROL, self._on_place)

    def start(self, node_id):
        """The cell is 'operational'; nothing of before counts."""
        self._node_id = node_id
        # A cell that finds itself among its neighbours has been given another's place.
        self.active = self.wanted and not self._place.names(node_id)
        self._acquit()
        self._rights = RightOfWay(lease_beats=self._objects.number(indices.LEASE, 1))
        self._period_ms = self._objects.number(indices.LEASE, 2)
        self._heard.reset()
        self._heard.repeat_ms = self._objects.number(indices.TPDO_PARAMETERS + 1, 5)
        # A millisecond passes until the frame with the edge has come.
        self._tracking.edge_late_ms = 1 + self._objects.number(indices.PRESENCE_DEBOUNCE)
        self._tracking.drop()
        self._pages.start(node_id)
        self._leading.stop()
        self._due = False
        self._situation = 0, 0, False
        self._skipped = 0
        for field in range(wire.ESTIMATE_FIELDS):
            self._fields[field] = 0

    def stop(self):
        """The cell is not 'operational' any more."""
        self.active = False
        self._acquit()
        self._tracking.drop()
        self._leading.stop()

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
        due = self._due
        came_ms = now_ms - waited_ms & _WRAP
        beat_ms = (came_ms - self._came_ms + _BEFORE & _WRAP) - _BEFORE
        # Or two beats meet, and what has come is of either.
        gap = beat_ms > 2 * self._period_ms or (due and beat_ms < UPDATE_MS)
        if gap:
            self._updated_ms = self._came_ms
        elif due:
            self._skip(came_ms)
        self._came_ms = came_ms
        if self._fields[_IDENTITY]:
            self._pdos.trigger(_ESTIMATE_PDO)
        if gap:
            self._rights.on_gap()
            self.nonsense += self._heard.read()
            # What has come may be of any age: it is not passed on.
            self._heard.passed_on()
        heard = self._heard
        heard.begin_beat()
        self._due = due = waited_ms <= LATE_MS
        if not due:
            self._skip(after(came_ms, self._period_ms))
            return
        heard.take_speeds(self._registers)
        self._wake(UPDATE_MS - waited_ms)

    def _skip(self, next_ms):
        """A beat passes without an update, and the next SYNC is at `next_ms`.

        What came since the last one still waits. So for right of way nothing has come, and a lease
        that ends with this beat ends the motion now; the estimate is of where the parcel will be.
        """
        self._skipped += 1
        self._rights.on_beat(*self._situation)
        if not self._rights.drive_beats:
            self._lead(self._pages.programs.find(self._tracking.identity))
        self._write_estimate(diff(next_ms, self._updated_ms))

    @micropython.native
    def poll(self, now_ms, presence):
        """Update when it is time; return in how many milliseconds the next update is due."""
        if not self.active:
            return _IDLE_MS
        heard = self._heard
        if presence != heard.presence[_OWN] or not heard.seen[_OWN]:
            heard.take_presence(_OWN, presence, now_ms)
        if not self._due:
            return _IDLE_MS
        wait_ms = UPDATE_MS - (now_ms - self._came_ms + _BEFORE & _WRAP) + _BEFORE
        if wait_ms > 0:
            return wait_ms
        self._due = False
        self._update(presence)
        return _IDLE_MS

    @micropython.native
    def _update(self, presence):
        sync_ms = self._came_ms
        step_ms = self._step_ms = max(min(diff(sync_ms, self._updated_ms), _STEP_MAX_MS), 1)
        self._updated_ms = sync_ms
        heard, rights, tracking = self._heard, self._rights, self._tracking
        self.nonsense += heard.read()
        rights.on_estimates(heard.estimates, heard.fresh)
        sent = heard.passed_on()
        self._choose_parcel()
        tracking.update(step_ms, sync_ms)
        if tracking.missing_beats >= LOST_BEATS:
            tracking.drop()
        program = self._pages.programs.find(tracking.identity)
        under = tracking.under
        over = tracking.identity if under or tracking.is_over() else 0
        if over and rights.state != UNDER and tracking.is_of_another():
            # A parcel that stands before what nobody knows would come over it mm by mm.
            over = 0
        needs, asks = self._leading.look_ahead(tracking, program) if under else _NOBODY
        self._situation = over, needs, presence != 0
        rights.on_beat(over, needs, presence != 0)
        self._evidence.judge(tracking, needs if rights.state == UNDER else 0)
        if self._suspicion.first() != self._suspect:
            self._report()
        self._lead(program)
        self._announce(program, asks)
        if under and program is not None and program.complete:
            self._pages.hand_on(program, sent, self._skipped)
        self._skipped = 0

    @micropython.native
    def _choose_parcel(self):
        """Be at the parcel that lies here, or else at the one that the right of way says."""
        tracking, rights = self._tracking, self._rights
        if not tracking.under:
            if rights.identity and rights.identity != tracking.identity:
                tracking.adopt(rights.identity)
            elif not rights.identity and rights.state == NONE and not tracking.belief.known:
                tracking.drop()
        if tracking.identity and not tracking.shaped:
            program = self._pages.programs.find(tracking.identity)
            if program is not None and program.has_parcel:
                tracking.take_shape(program)

    @micropython.native
    def _lead(self, program):
        """Lead the wheels towards the goal while all is clear; else bring them to rest."""
        tracking, rights, leading = self._tracking, self._rights, self._leading
        known = rights.state == UNDER and program is not None and program.complete
        if not known or not tracking.under or tracking.is_doubtful():
            leading.stop()
            return
        alone = bool(self._consumer.lost)
        allowed = leading.may_go_on(program, self._step_ms, alone=alone)
        if alone and allowed:
            self._go_on(program)
        # As many beats as were skipped before this update may be before the next.
        allowed = allowed and rights.drive_beats > self._skipped
        leading.step(tracking, program, allowed, self._step_ms)

    def _go_on(self, program):
        """Take the next leg, without the host, at the end of this one; so do all under the parcel.

        The host gives a leg when its way is free; from now on promises alone keep others apart.
        """
        if not program.legs:
            return
        follows = self._leading.arrived() or self._is_another_at(next_sequence(program.sequence))
        if follows and program.advance():
            self._leading.next_leg()

    def _is_another_at(self, sequence):
        """Whether a neighbour under the same parcel has the program of this sequence."""
        estimates, came = self._heard.estimates, self._heard.estimate_beat
        for direction in range(DIRECTIONS):
            at = direction * wire.ESTIMATE_FIELDS
            if (
                came[direction] == self._heard.beat
                and estimates[at + IDENTITY] == self._tracking.identity
                and estimates[at + STATE] == UNDER
                and estimates[at + SEQUENCE] == sequence
            ):
                return True
        return False

    # Who is suspected

    def _report(self):
        """Report another suspect than before, in an emergency and in its object."""
        direction = self._suspect = self._suspicion.first()
        self._emcy.clear(SOURCE)
        node_id = 0
        if direction >= 0:
            node_id = self._node_id if direction == OWN else self._place.nodes[direction]
            self._emcy.report(SOURCE, CODE, bytes((node_id, self._suspicion.out[direction], 0, 0)))
        self._objects.put(indices.SUSPECT, 0, node_id)

    def _acquit(self):
        """Suspect nobody."""
        self._suspicion.reset()
        if self._suspect >= 0:
            self._report()

    # What is sent

    @micropython.native
    def _announce(self, program, asks):
        fields = self._fields
        fields[WANTS] = asks
        if program is not None and program.complete:
            fields[SEQUENCE], flags = program.sequence, 0 if program.whole else LACKING
        else:
            fields[SEQUENCE], flags = 0, LACKING
        if self._leading.arrived():
            flags |= wire.ARRIVED
        if self._suspect >= 0:
            flags |= wire.CONTRADICTED
        fields[FLAGS] = flags
        self._write_estimate(self._step_ms)

    @micropython.native
    def _write_estimate(self, ahead_ms):
        """Write what the next SYNC is to send, so long after the one that the belief is of."""
        fields, rights = self._fields, self._rights
        self._tracking.announce(fields, ahead_ms)
        fields[IDENTITY] = rights.identity
        fields[STATE] = rights.state
        fields[HOLD] = rights.hold
        if rights.state != UNDER:
            fields[WANTS] = 0
        pack_estimate(fields, 0, self._objects.data, self._estimate_at)
