"""The neighbour layer: in each beat it takes frames in, decides, and leads the wheels.

At SYNC the cell sends its speeds and, if it is at a parcel, its estimate. Those of its neighbours
have come `UPDATE_MS` later. Then `update` runs in the background. Its decision holds for a beat.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

# Modules that others import come first: an import within an import takes stack.
from mdms_cell.perception import place
from mdms_cell.perception.footprint import Footprint
from mdms_cell.perception.heard import SEEN, SPEEDS_AT, Heard
from mdms_cell.perception.outline import Outline
from mdms_cell.perception.place import DIRECTIONS, OWN, Place
from mdms_cell.perception.suspicion import CODE, SOURCE, Suspicion
from mdms_cell.perception.tracking import LOST_BEATS, Tracking
from mdms_cell.rights.right_of_way import BY_ANOTHER, NONE, UNDER, UNPLACED, RightOfWay

# isort: split
from mdms_cell.canopen.objects import find
from mdms_cell.motion.leading import Leading
from mdms_cell.motion.pages import OUTDATED, Pages
from mdms_cell.motion.program import next_sequence
from mdms_cell.ticks import IDLE_MS, LAST, after, diff
from mdms_protocol import indices
from mdms_protocol.compat import const, micropython
from mdms_protocol.neighbours import frames as wire

#: From SYNC until speeds and estimates of all cells of a bus have come.
UPDATE_MS = const(7)
#: A SYNC that has waited for longer is answered, but has no update: the one after it would be late.
LATE_MS = const(2)
#: The host is gone once it has been missed for so long. Until then no cell begins another leg, for
#: it may be the only one that has missed some heartbeats [ms].
_GONE_MS = const(500)
#: For so long most neighbours have no supply until the cell takes its own for gone [beats].
_UNSUPPLIED_BEATS = const(5)


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
        self.active = self._operational = False
        self._place = Place(objects, self._on_setting)
        self._heard = Heard()
        self._footprint = Footprint(self._place)
        self._suspicion = Suspicion()
        self._tracking = Tracking(self._place, self._footprint, self._heard, self._suspicion)
        self._leading = Leading(
            self._place, self._footprint, self._tracking, axes, self._reported_outline
        )
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
        self._consumer = consumer
        #: The estimate that is to be sent, by the fields of the wire, and where its frame is.
        self._estimate = array("i", [0] * wire.ESTIMATE_FIELDS)
        self._frame_at = find(indices.ESTIMATE, 1).place
        #: How many frames of neighbours were no estimates.
        self.nonsense = 0
        #: The direction that is reported as a suspect, -1 for none.
        self._suspect = -1
        # The period of SYNC, the last SYNC, and the one of the last update with the time before it,
        # up to 50 ms.
        self._period_ms = self._step_ms = 10
        self._came_ms = self._updated_ms = 0
        #: For how long the host has been missed, up to _GONE_MS.
        self._silent_ms = 0
        self._forget_beat()
        objects.watch(lambda _index, _sub: self._on_setting(True), indices.CONTROL)

    def start(self, node_id):
        """The cell is 'operational'; nothing of before counts."""
        # A cell that finds itself among its neighbours has been given another's place.
        self._operational = True
        self.active = self.wanted and not self._place.names(node_id)
        self._rights.set_lease(self._objects.number(indices.LEASE, 1))
        self._period_ms = self._objects.number(indices.LEASE, 2)
        self._heard.repeat_ms = self._objects.number(indices.TPDO_PARAMETERS + 1, 5)
        # A millisecond passes until the frame with the edge has come.
        self._tracking.sensors.edge_late_ms = 1 + self._objects.number(indices.PRESENCE_DEBOUNCE)
        self._pages.node_id = node_id
        self._reset()

    def stop(self):
        """The cell is not 'operational' any more."""
        self.active = self._operational = False
        self._reset()

    def _reset(self):
        """Forget all that must outlive no stop: parcel, programs, promises, and turns.

        Settings stay, and so does the clock.
        """
        self._suspicion.reset()
        if self._suspect >= 0:
            self._report()
        self._rights.restart(self._place.present())
        self._heard.reset()
        self._tracking.drop()
        self._pages.reset()
        self._leading.reset()
        self._silent_ms = 0
        self._forget_beat()

    def _forget_beat(self):
        """No update is due, and there is no estimate to send."""
        for field in range(wire.ESTIMATE_FIELDS):
            self._estimate[field] = 0
        self._due = False
        self._skipped_beats = self._unsupplied_beats = 0
        # Reports of the last update to the right of way: the parcel over the cell, the neighbours
        # that it needs, and whether a sensor is covered.
        self._over = self._needs = 0
        self._occupied = False

    def load(self):
        """Take over everything from the dictionary."""
        self._place.load()
        self._on_setting(True)

    def goes_on(self):
        """Return whether the silence of the host ends no motion here.

        Where no parcel lies, a parcel that goes on may come by. A parcel that does not go on is
        stopped.
        """
        tracking = self._tracking
        program = self._pages.programs.find(tracking.identity if tracking.is_over() else 0)
        if program is not None and program.complete and not program.goes_on:
            return False
        return self.active and self._pages.programs.go_on()

    def _on_setting(self, others):
        """A setting is written; a cell that is 'operational' begins anew with it.

        `others` is whether the cell hears other nodes than before.
        """
        self._footprint.load()
        operational = self._operational
        if operational or others:
            self.stop()
        self._axes.be_led(self.wanted)
        if operational:
            self.start(self._pages.node_id)
        if others:
            self._changed()

    # Received frames

    @property
    def mailboxes(self):
        """Where frames of neighbours wait for an update."""
        return self._heard.boxes

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
            return SPEEDS_AT + direction
        if kind == place.STATE:
            return lambda data: heard.on_state(direction, data, self._now())
        if kind == place.ESTIMATE:
            return direction
        return lambda data: not self.active or self._pages.on_page(direction, data)

    # The beat

    @micropython.native
    def on_sync(self, now_ms, waited_ms):
        """Send the estimate of the last update at SYNC, and have the next update follow.

        SYNC was `waited_ms` ago. A slow update may have held it up. Then this beat has no update,
        so that every second or third update is on time, and none is late by chance.
        """
        if not self.active:
            return
        came_ms = after(now_ms, -waited_ms)
        beat_ms = came_ms - self._came_ms & LAST
        # Or two beats meet, and the frames may be of either.
        gap = beat_ms > 2 * self._period_ms or (self._due and beat_ms < UPDATE_MS)
        if gap:
            self._updated_ms = self._came_ms
        elif self._due:
            self._skip(came_ms)
        self._came_ms = came_ms
        if self._estimate[wire.IDENTITY]:
            self._pdos.trigger(place.ESTIMATE)
        if gap:
            self._rights.on_gap()
            self._pages.comparison.on_gap(beat_ms // self._period_ms)
            self.nonsense += self._heard.read()
            # The frames may be of any age, so they are not passed on.
            self._heard.pass_over()
        elif not self._heard.hears():
            self._rights.on_deaf_beat()
        self._heard.begin_beat(self._registers)
        self._due = waited_ms <= LATE_MS
        if not self._due:
            self._skip(after(came_ms, self._period_ms))
            return
        self._wake(UPDATE_MS - waited_ms)

    def _skip(self, next_ms):
        """Pass a beat without an update, with the next SYNC at `next_ms`.

        The frames since the last update still wait. So for right of way no frame has come. If a
        lease ends with this beat, the motion ends now. The estimate is of the parcel's later place.
        """
        self._skipped_beats += 1
        self._rights.on_beat(self._over, self._needs, self._occupied)
        if not self._rights.drive_beats:
            program = self._pages.programs.complete(self._tracking.identity)
            self._lead(program, self._step_ms)
        self._write_estimate(diff(next_ms, self._updated_ms))

    @micropython.native
    def poll(self, now_ms, presence):
        """Update when it is time; return in how many milliseconds the next update is due."""
        if not self.active:
            return IDLE_MS
        if self._consumer.host_lost and self._axes.failed():
            # A fault that somebody resets without the host ends the way of before.
            self._pages.programs.outdate(0)
        heard = self._heard
        if presence | SEEN != heard.presence[OWN]:
            heard.take_presence(OWN, presence, now_ms)
        if not self._due:
            return IDLE_MS
        wait_ms = UPDATE_MS - diff(now_ms, self._came_ms)
        if wait_ms > 0:
            return wait_ms
        self._due = False
        self._update(presence)
        return IDLE_MS

    @micropython.native
    def _update(self, presence):
        """The algorithm of a beat, in its order; docs/cells.md, 'A beat'."""
        step_ms = self._step_ms = max(1, min(self._came_ms - self._updated_ms & LAST, 50))
        self._updated_ms = self._came_ms
        # Take in the frames of neighbours, and choose the parcel to be at.
        sent = self._take_in()
        self._heed_supplies()
        if not self._tracking.under:
            self._choose_parcel()
        # Believe: where the parcel is and how it moves.
        self._tracking.update(step_ms, self._came_ms)
        if self._tracking.missing_beats >= LOST_BEATS:
            self._tracking.drop()
        program, verdict = self._find_program(sent)
        # Decide: which cells the parcel needs, and whether all are promised to it.
        self._look_ahead(program)
        self._claim(presence)
        # Judge the neighbours.
        at_parcel = self._rights.state == UNDER
        self._tracking.find_witness(at_parcel)
        self._tracking.judge(self._needs if at_parcel else 0)
        if self._suspicion.first() != self._suspect:
            self._report()
        # Lead the wheels, and say so at the next SYNC.
        outdated = verdict == OUTDATED
        self._lead(None if outdated and not self._consumer.host_lost else program, step_ms)
        ahead_ms = max(step_ms // (self._skipped_beats + 1), 1)
        self._announce(None if self._pages.asked or outdated else program, ahead_ms)
        # A goal whose time is over would be driven to by a cell alone that lost it by a fault.
        counts = not (program is None or verdict or self._leading.had_its_time(program.identity))
        if sent and self._tracking.under and counts:
            self._pages.hand_on(program, sent, self._skipped_beats)
        self._skipped_beats = 0

    @micropython.native
    def _take_in(self):
        """Take in the estimates that have come; returns the mask of their directions."""
        heard, rights = self._heard, self._rights
        self.nonsense += heard.read()
        estimates, fresh = heard.estimates, heard.boxes.fresh
        precedence = self._pages.precedence
        if precedence.exists():
            # The order counts for the time without the host.
            turn = precedence.turn(rights.identity, rights.state, estimates, fresh)
            if self._consumer.host_lost:
                precedence.keep(turn, estimates, fresh)
        sent = rights.on_estimates(estimates, fresh)
        self._pages.asked = 0
        if rights.unsure:
            self._look_around(sent)
        return sent

    def _heed_supplies(self):
        """Take the supply for gone if most neighbours have none: the emergency stop cuts them all.

        A cell whose measurement is stuck would go on when the button is released.
        """
        heard = self._heard
        gone = heard.unsupplied and heard.supply_is_gone(self._came_ms)
        self._unsupplied_beats = self._unsupplied_beats + 1 if gone else 0
        if self._unsupplied_beats >= _UNSUPPLIED_BEATS:
            self._axes.lose_supply()

    @micropython.native
    def _find_program(self, sent):
        """Return the program of the parcel, None without one, and the verdict against it."""
        identity, pages = self._tracking.identity, self._pages
        if self._consumer.host_lost:
            self._silent_ms = min(self._silent_ms + self._step_ms, _GONE_MS)
            pages.programs.outdate(identity)
        elif self._silent_ms:
            if self._silent_ms == _GONE_MS:
                pages.on_host_back(identity if self._rights.state == UNDER else 0)
            self._silent_ms = 0
        program = pages.programs.complete(identity)
        return program, pages.comparison.update(identity, program, sent)

    @micropython.native
    def _look_ahead(self, program):
        """Find which neighbours the parcel needs, and which it wants soon."""
        leading = self._leading
        self._needs = self._estimate[wire.WANTS] = 0
        if self._tracking.under:
            leading.look_ahead(program, self._rights.lacking)
            self._needs, self._estimate[wire.WANTS] = leading.needs, leading.wants

    @micropython.native
    def _claim(self, presence):
        """Have the right of way decide for the next beat; DESIGN.md, 'Right of way'."""
        tracking, rights = self._tracking, self._rights
        over = tracking.identity if tracking.is_over() else 0
        occupied = presence != 0
        if occupied and rights.state != UNDER and tracking.sensors.show_another():
            # A parcel that stands before an unknown thing would come over it mm by mm. One that has
            # been let come stops for what is set down on its way.
            over, occupied = 0, BY_ANOTHER
        self._over, self._occupied = over, occupied
        rights.on_beat(over, self._needs, self._occupied)

    @micropython.native
    def _lead(self, program, step_ms):
        """Lead the wheels towards the goal of a program while all is clear; else they rest."""
        rights, tracking, leading = self._rights, self._tracking, self._leading
        under = rights.state == UNDER and tracking.under
        if program is None or not under or tracking.is_doubtful() or tracking.is_alone():
            leading.stop()
            return
        alone = self._consumer.host_lost
        # As many beats as were skipped before this update may be before the next.
        held = rights.drive_beats <= self._skipped_beats
        allowed = leading.may_go_on(program, step_ms, alone, held)
        if self._silent_ms == _GONE_MS and allowed:
            self._go_on(program)
        leading.step(program, allowed and not held, step_ms)

    @micropython.native
    def _announce(self, program, ahead_ms):
        """Write the estimate that the next SYNC is to send; the program may be lacked or None."""
        flags = wire.CONTRADICTED if self._suspect >= 0 else 0
        if self._leading.steering.has_arrived():
            flags |= wire.ARRIVED
        if program is None or not program.whole:
            flags |= wire.LACKING
        self._estimate[wire.SEQUENCE] = 0 if program is None else program.sequence
        self._estimate[wire.FLAGS] = flags
        self._write_estimate(ahead_ms)

    @micropython.native
    def _write_estimate(self, ahead_ms):
        """Write the frame, so long after the SYNC that the belief is of."""
        estimate, rights = self._estimate, self._rights
        self._tracking.announce(estimate, ahead_ms)
        estimate[wire.IDENTITY] = rights.identity
        estimate[wire.STATE] = rights.state
        estimate[wire.HOLD] = rights.hold
        if rights.state != UNDER:
            estimate[wire.WANTS] = 0
        wire.pack_estimate(estimate, self._objects.data, self._frame_at)

    def _look_around(self, sent):
        """Find the parcel over the square after a restart, by the neighbours that are heard.

        `sent` is the mask of those whose estimates have come. A neighbour under a parcel that is
        heard, and has sent no estimate for 30 beats, has left it. If the size of a parcel is not
        known, its page is asked for.
        """
        heard, rights = self._heard, self._rights
        # One that has restarted too has a pose before it is under the parcel.
        reported = heard.having(wire.STATE, wire.UNDER) | heard.having(wire.CERTAINTY, 1, 15)
        for direction in range(DIRECTIONS):
            tells = reported >> direction & 1
            if sent >> direction & 1:
                rights.hear(direction, self._reported_over(direction) if tells else 0)
            elif heard.speeds_age(direction) <= 1 and not (tells and heard.age(direction) <= 30):
                rights.hear(direction, 0)
        if self._pages.asked:
            rights.approach(self._pages.asked)

    def _reported_over(self, direction):
        """The parcel that a neighbour reports over this cell's square, as in `hear`."""
        estimates, at = self._heard.estimates, direction * wire.ESTIMATE_FIELDS
        identity = estimates[at + wire.IDENTITY]
        if not identity:
            return 0
        program = self._pages.programs.find(identity)
        if program is None or not program.has_parcel:
            self._pages.asked = identity
            return identity | UNPLACED
        if not estimates[at + wire.CERTAINTY]:
            return 0 if self._has_pose(identity) else identity | UNPLACED
        self._place_reported(direction, program)
        return identity if self._footprint.reaches(self._outline) else 0

    def _reported_outline(self, direction):
        """Return the outline of the parcel over a neighbour, None where it is not known."""
        estimates, at = self._heard.estimates, direction * wire.ESTIMATE_FIELDS
        if not estimates[at + wire.CERTAINTY]:
            return None
        program = self._pages.programs.find(estimates[at + wire.IDENTITY])
        if program is None or not program.has_parcel:
            return None
        self._place_reported(direction, program)
        return self._outline

    def _place_reported(self, direction, program):
        """Have the scratch outline be the parcel of a program as a neighbour reports its place."""
        self._outline.set(*program.size())
        self._outline.place(*self._tracking.agreement.pose_of(direction))

    def _has_pose(self, identity):
        """Whether any neighbour has said lately where this parcel is."""
        heard = self._heard
        posed = heard.posed(identity)
        return any(posed >> each & 1 and heard.age(each) <= 1 for each in range(DIRECTIONS))

    def _choose_parcel(self):
        """Be at the parcel that lies here, or else at the choice of the right of way."""
        tracking, rights = self._tracking, self._rights
        identity = rights.identity
        if identity and identity != tracking.identity:
            tracking.adopt(identity)
        elif not identity and rights.state == NONE and not tracking.belief.known:
            tracking.drop()
        if tracking.identity and not tracking.shaped:
            program = self._pages.programs.find(tracking.identity)
            if program is not None and program.has_parcel:
                tracking.take_shape(program)

    def _go_on(self, program):
        """Take the next leg without the host at the end of this one, as all under the parcel do.

        The host gives a leg when its way is free. From now on promises alone keep others apart, in
        the order of `precedence`.
        """
        if not program.legs:
            return
        following = next_sequence(program.sequence)
        others = self._pages.comparison.ahead & self._heard.having(wire.SEQUENCE, following)
        if (others or self._leading.steering.has_arrived()) and program.advance():
            self._leading.next_leg()

    # Suspects

    def _report(self):
        """Report another suspect than before, in an emergency and in its object."""
        direction = self._suspect = self._suspicion.first()
        self._emcy.clear(SOURCE)
        node_id = 0
        if direction >= 0:
            node_id = self._pages.node_id if direction == OWN else self._place.nodes[direction]
            self._emcy.report(SOURCE, CODE, bytes((node_id, self._suspicion.out[direction], 0, 0)))
        self._objects.put(indices.SUSPECT, 0, node_id)
