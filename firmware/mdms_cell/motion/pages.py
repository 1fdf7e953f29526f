"""Takes in the pages of programs, and hands them on to neighbours at the parcel that lack them."""

from mdms_cell.canopen.objects import find
from mdms_cell.motion.program import Programs, next_sequence
from mdms_cell.perception.angle import turn_um
from mdms_cell.perception.place import DIRECTIONS, HOST, PROGRAM
from mdms_cell.rights.declarations import Precedence
from mdms_cell.rights.right_of_way import IDENTITY, PROMISED_TO
from mdms_protocol import indices
from mdms_protocol.compat import const, micropython
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import lost

#: Verdicts on the program of the cell's parcel; 0 is for no objection. A doubted program is not
#: handed on. An outdated one does not lead the wheels either.
DOUBTED = const(1)
OUTDATED = const(2)
#: It is enough after this, in which the host repeats a page and neighbours hand one on.
_OUTDATED_BEATS = const(6)
#: A cell that has heard no other for so long may have missed three programs. Then the same number
#: tells nothing either.
_LONG_BEATS = const(10)


class ProgramComparison:
    """The neighbours' programs for the cell's parcel, by their estimates.

    Sequence numbers come round again after three. So two of them alone do not tell which program is
    newer. But only newer programs follow a program. So a neighbour is ahead if it had the same
    program before and has another now.

    `shared` is the mask of the neighbours whose last report had this program. `ahead` is the mask
    of those that had it, and have had another since. The program is `settled` once it is known to
    be that of the parcel's cells. Either the host has sent it, or one of them had the same, since
    this cell is at the parcel and hears others there. `verdict` is the conclusion.
    """

    def __init__(self, heard):
        self._heard = heard
        self.reset()

    def reset(self):
        """The cell is at no parcel."""
        self.settled = False
        self._identity = self._sequence = 0
        self._forget()

    def _forget(self):
        self.shared = self.ahead = self.verdict = 0
        #: Beats with an objection against the program, and beats without a report of another cell
        #: at the parcel; the latter up to _LONG_BEATS.
        self._against_beats = self._deaf_beats = 0

    def begin(self, program, shared=0):
        """Forget the neighbours' programs; nothing is known of them beside the new program."""
        self._identity, self._sequence = program.identity, program.sequence
        self._forget()
        self.shared = shared

    def on_gap(self, beats):
        """So many beats were missed, and with them which programs others had."""
        self.shared = 0
        self.settled = False
        if beats >= _LONG_BEATS:
            self._deaf_beats = _LONG_BEATS

    def is_ahead(self, direction):
        """Whether a neighbour has a newer program than this cell, which has one."""
        return bool(self.ahead >> direction & 1) if self.ahead else self.verdict == OUTDATED

    @micropython.native
    def update(self, identity, program, sent):
        """A beat has passed in which those in a mask have sent an estimate; returns the verdict.

        The cell is at this parcel, whose program it has, or None.
        """
        sequence = 0 if program is None else program.sequence
        if self._identity != identity or self._sequence != sequence:
            same_parcel = self._identity == identity
            deaf_beats = self._deaf_beats if same_parcel else 0
            self.settled = self.settled and same_parcel
            self._identity, self._sequence = identity, sequence
            self._forget()
            self._deaf_beats = deaf_beats
        heard, shared = self._heard, 0
        estimates, at = heard.estimates, 0
        nobody, other = True, False
        for direction in range(DIRECTIONS):
            bit = 1 << direction
            had = self.shared & bit
            if sent & bit:
                if estimates[at + wire.IDENTITY] == identity:
                    nobody = False
                    under = estimates[at + wire.STATE] == wire.UNDER
                    its = estimates[at + wire.SEQUENCE] if under else 0
                    sure = not estimates[at + wire.FLAGS] & wire.LACKING
                    if its and its == sequence and self._deaf_beats < _LONG_BEATS:
                        shared |= bit
                        self.settled = self.settled or sure
                    elif its:
                        self.ahead |= had
                        other = other or sure
            elif heard.age(direction) <= 5:
                # It cannot forget its program and get another so soon.
                nobody = False
                shared |= had
            at += wire.ESTIMATE_FIELDS
        self.shared = shared
        if nobody or other or self.ahead or self._against_beats or self._deaf_beats:
            self._judge(nobody, other)
            return self.verdict
        return 0

    def _judge(self, nobody, other):
        """Return the verdict of this beat together with those before.

        It asks whether any cell at the parcel is heard, and whether one surely has another program.
        """
        has_program = self._sequence != 0
        if nobody:
            self.settled = False
            self._deaf_beats = min(self._deaf_beats + 1, _LONG_BEATS) if has_program else 0
        elif self._deaf_beats < _LONG_BEATS:
            self._deaf_beats = 0
        if has_program and (self.ahead or (other and not self.settled)):
            self._against_beats = min(self._against_beats + 1, _OUTDATED_BEATS)
        else:
            self._against_beats = 0
        outdated = self._against_beats == _OUTDATED_BEATS
        self.verdict = OUTDATED if outdated else DOUBTED if self._against_beats else 0


class Pages:
    """The programs of one cell, by the pages that come and go; `programs` are those it keeps.

    `precedence` is the order in which parcels come over the cell. `comparison` compares
    the program of the cell's parcel with neighbours'. `asked` is another parcel than the one here
    whose pages neighbours are to hand on, 0 for none.
    """

    def __init__(self, objects, place, heard, *, tracking, rights, leading, consumer, pdos):
        self._objects = objects
        self._place = place
        self._heard = heard
        self._tracking = tracking
        self._rights = rights
        self._leading = leading
        self._consumer = consumer
        self._pdos = pdos
        self._frame_at = find(indices.PROGRAM, 1).place
        self.node_id = 0
        self.programs = Programs(self._own)
        #: By identity, whether the host alone may give the parcel another goal: it has ended the
        #: program, or is back.
        self._ended = bytearray(wire.IDENTITY_MAX + 1)
        self.precedence = Precedence()
        self.comparison = ProgramComparison(heard)
        self.reset()

    def reset(self):
        """Keep no program and no order; the cell may stand elsewhere from now on."""
        self.asked = self._turn = 0
        programs, place = self.programs, self._place
        programs.clear()
        self._ended[:] = bytes(len(self._ended))
        programs.x, programs.y = place.x_um // wire.STEP_UM, place.y_um // wire.STEP_UM
        self.precedence.reset()
        self.comparison.reset()

    def _own(self):
        """The identities of the parcels that the cell is at, belongs to, or is bound to."""
        right = self._rights.registers
        return self._tracking.identity, right[IDENTITY], right[PROMISED_TO]

    # Received pages

    def on_page(self, direction, data):
        """Take a page, from the host or handed on by a neighbour; returns False if it is none."""
        page = [0] * wire.PROGRAM_FIELDS
        if not wire.unpack_program(data, page):
            if lost.is_lost(data):
                return direction != HOST or self._on_lost(data)
            place = self._place
            return direction == HOST and self.precedence.take(data, place.column, place.row)
        identity = page[wire.PARCEL_IDENTITY]
        if direction == HOST:
            self._on_host_page(identity, page)
        elif identity == self._tracking.identity:
            self._on_page_handed_on(self.programs.place_for(identity), page, direction)
        elif identity == self.asked and page[wire.PAGE] == wire.PARCEL:
            self.programs.place_for(identity).take(page)
        return True

    def _on_lost(self, data):
        """A page of the host about a lost cell: answer it, if it is about a neighbour.

        If it is about this cell itself, the cell is back, and does not know the parcels that have
        come over its square: it is as after a restart.
        """
        place, rights = self._place, self._rights
        kind, number, identity = lost.kind_of(data), lost.number_of(data), data[lost.IDENTITY]
        column, row = data[lost.COLUMN], data[lost.ROW]
        direction = place.direction_of(column, row)
        answer = kind
        if (column, row) == (place.column, place.row):
            rights.restart(place.present())
            answer = lost.REFUSED
        elif direction is None or kind not in (lost.DECLARED, lost.REVOKED):
            return True
        elif kind == lost.REVOKED:
            rights.readmit(direction)
        else:
            silent_beats = self._heard.silent_beats(direction)
            agrees = rights.do_without(direction, identity, number, silent_beats)
            answer = lost.AGREED if agrees else lost.REFUSED
        at, frame = self._frame_at, lost.pack_lost(answer, column, row, identity, number)
        self._objects.data[at : at + len(frame)] = frame
        self._pdos.trigger(PROGRAM)
        return True

    def _on_page_handed_on(self, program, page, direction):
        """Take a page of a neighbour if the cell has none, or an outdated one."""
        if page[wire.PAGE] == wire.PARCEL:
            if not program.has_parcel:
                program.take(page)
        elif page[wire.PAGE] != wire.GOAL or self._ended[page[wire.PARCEL_IDENTITY]]:
            # A neighbour may have missed the end.
            return
        elif 0 < page[wire.LEG] < wire.JOINS:
            self._on_leg(program, page)
        elif not program.has_goal or self.comparison.is_ahead(direction):
            alone_on_the_way = program.has_goal and self._consumer.host_lost
            program.take(page)
            self.comparison.begin(program, shared=1 << direction)
            if alone_on_the_way:
                # Others have gone on by themselves: that gives no more time.
                self._leading.next_leg()
            else:
                self._leading.begin(program.identity)

    def _on_leg(self, program, page):
        """A leg that follows a goal; one of a goal that the cell does not have is dropped."""
        if program is None or not program.take(page):
            return
        if program.identity == self._tracking.identity:
            self._leading.plan_again()

    def _on_host_page(self, identity, page):
        tracking = self._tracking
        if page[wire.PAGE] == wire.END:
            self._ended[identity] = 1
            self.programs.drop(identity)
            if tracking.identity == identity:
                tracking.drop()
                self._leading.stop()
        elif page[wire.PAGE] == wire.PLACE:
            self._put(identity, page)
        elif page[wire.PAGE] == wire.GOAL and 0 < page[wire.LEG] < wire.JOINS:
            self._on_leg(self.programs.find(identity), page)
        else:
            program = self.programs.place_for(identity)
            is_goal = page[wire.PAGE] == wire.GOAL
            again = is_goal and program.has_goal_of(page)
            program.take(page)
            if is_goal:
                self._on_host_goal(program, again)
            elif page[wire.PAGE] == wire.PARCEL and tracking.identity == identity:
                # Another parcel of this number may be larger.
                tracking.take_shape(program)

    def _on_host_goal(self, program, again):
        """Take a goal of the host, perhaps the same one again: it is the newest."""
        self._ended[program.identity] = 0
        if program.identity == self._tracking.identity:
            self.comparison.begin(program)
            self.comparison.settled = True
        if not again:
            self._leading.begin(program.identity)

    def _put(self, identity, page):
        """Take the host's report of a parcel, perhaps on this cell; a parcel it has stays."""
        tracking, place = self._tracking, self._place
        program = self.programs.find(identity)
        if program is None:
            return
        program.begin_at(page)
        if not program.has_parcel or tracking.under:
            return
        x_um = page[wire.PLACE_X] * wire.STEP_UM - place.x_um
        y_um = page[wire.PLACE_Y] * wire.STEP_UM - place.y_um
        # No parcel is larger.
        if max(abs(x_um), abs(y_um)) < 4 * place.pitch_um:
            tracking.adopt(identity)
            tracking.take_shape(program)
            tracking.place(x_um, y_um, turn_um(page[wire.PLACE_YAW]))
        if tracking.identity == identity and not tracking.under:
            tracking.drop()

    def on_host_back(self, led):
        """The host was gone: no goal of before counts, but that of the parcel `led` here.

        The time to go on may be over, and only cells that have led the parcel know.
        """
        self.programs.outdate(led)
        for identity in range(len(self._ended)):
            if identity != led:
                self._ended[identity] = 1

    # The beat

    @micropython.native
    def hand_on(self, program, sent, skipped):
        """Send a page if a neighbour in the mask `sent` has sent an estimate and lacks it.

        The cell sends in its turn, one beat in four, or if that was one of the `skipped` beats.
        """
        if (self._heard.beat + self.node_id) % 4 > skipped:
            return
        for direction in range(DIRECTIONS):
            page = self._lacked_page(direction, program) if sent >> direction & 1 else None
            if page is not None and program.pack(page, self._objects.data, self._frame_at):
                self._pdos.trigger(PROGRAM)
                return

    @micropython.native
    def _lacked_page(self, direction, program):
        """The number of a page that a neighbour at the parcel lacks; None if it lacks none."""
        estimates, at = self._heard.estimates, wire.ESTIMATE_FIELDS * direction
        if estimates[at + wire.IDENTITY] != program.identity:
            return None
        sequence = estimates[at + wire.SEQUENCE]
        if sequence and next_sequence(sequence) == program.sequence:
            # It has the program before.
            return 1
        if not estimates[at + wire.FLAGS] & wire.LACKING:
            return None
        self._turn = self._turn + 1 & 0xFFFF
        if sequence == program.sequence:
            return 2 + self._turn % max(program.legs, 1)
        return self._turn & 1
