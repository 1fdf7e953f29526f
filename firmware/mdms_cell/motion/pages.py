"""Takes in the pages of programs, and hands them on to neighbours at the parcel that lack them."""

# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.canopen.objects import find
from mdms_cell.motion.program import Programs, next_sequence
from mdms_cell.perception.angle import turn_um
from mdms_cell.perception.place import DIRECTIONS, HOST
from mdms_cell.rights import precedence
from mdms_cell.rights.right_of_way import IDENTITY, PROMISED_TO
from mdms_protocol import indices
from mdms_protocol.compat import const, micropython, ptr16, ptr32
from mdms_protocol.neighbours import frames as wire

_PROGRAM_PDO = 3
#: Of the cells that could hand a program on, each does so in one of so many beats.
_HAND_ON_BEATS = const(4)
#: No parcel lies on a cell whose centre is farther from it along x or y.
_NEAR_PITCHES = const(4)

# What neighbours' estimates say of the cell's own program, in `registers`. Sequence numbers come
# round again after three, so that two of them alone do not tell which program is newer. But a
# program is followed by newer ones only: who had the same one, and has another by now, is ahead.
_OF = const(0)  # what the rest is about: 4 times the identity, and the sequence
_SHARED = const(1)  # mask of the neighbours that had this program when they were heard last
AHEAD = const(2)  # mask of those that had it, and have had another since
#: 1 once the program is known to be the one of the parcel's cells: the host has sent it, or one of
#: them had the same, since this cell is at the parcel and hears others there.
_SETTLED = const(3)
_AGAINST_BEATS = const(4)  # for so many beats something has been against the program
#: What that comes to: nothing, too little to drop the program though it is not handed on, or enough
#: not to be led by it either.
VERDICT = const(5)
DOUBTED = const(1)
OUTDATED = const(2)
_DEAF_BEATS = const(6)  # for so many beats nobody at the parcel was heard, up to _LONG_BEATS
_REGISTERS = const(7)
# What a beat shows: nobody at the parcel is heard, one there has another program for sure, or
# something of before is not over.
_NOBODY = const(1)
_OTHER = const(2)
_PENDING = const(4)
#: It is enough after this, in which the host repeats a page and neighbours hand one on.
_OUTDATED_BEATS = const(6)
#: A neighbour is not heard any more after this; it cannot forget its program and get another so
#: soon.
_SILENT_BEATS = const(5)
#: A cell that has heard nobody for so long may have missed three programs, so that the same number
#: tells nothing either.
_LONG_BEATS = const(10)


class Pages:
    """The programs of one cell, by the pages that come and go; `programs` are those it keeps.

    `order` is that of the parcels that come over the cell, see `precedence`. `registers` have what
    neighbours show of the program of the cell's parcel. `asked` is another parcel than the one here
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
        self._turn = 0
        self.node_id = 0
        self.asked = 0
        self.programs = Programs(self._own)
        self.order = bytearray(precedence.BYTES)
        self.registers = array("H", [0] * _REGISTERS)
        #: Compares the program of the cell's parcel with those of neighbours; returns the verdict.
        self.compare = _comparing(self.registers, heard)

    def reset(self):
        """Keep no program and no order; the cell may stand elsewhere from now on."""
        self.asked = 0
        programs, place = self.programs, self._place
        programs.clear()
        programs.x, programs.y = place.x_um // wire.STEP_UM, place.y_um // wire.STEP_UM
        precedence.clear(self.order)
        for number in range(_REGISTERS):
            self.registers[number] = 0

    def _own(self):
        """The identities of the parcels that the cell is at, belongs to, or is bound to."""
        right = self._rights.registers
        return self._tracking.identity, right[IDENTITY], right[PROMISED_TO]

    # What comes

    def on_page(self, direction, data):
        """Take a page, from the host or handed on by a neighbour; returns False if it is none."""
        page = [0] * wire.PROGRAM_FIELDS
        if not wire.unpack_program(data, page, 0):
            place = self._place
            return direction == HOST and precedence.take(self.order, data, place.column, place.row)
        identity = page[wire.PARCEL_IDENTITY]
        if direction == HOST:
            self._on_host_page(identity, page)
        elif identity == self._tracking.identity:
            self._on_page_handed_on(self.programs.place_for(identity), page, direction)
        elif identity == self.asked and page[wire.PAGE] == wire.PARCEL:
            self.programs.place_for(identity).take(page)
        return True

    def _on_page_handed_on(self, program, page, direction):
        """A page of a neighbour counts where the cell has none, or one that is outdated."""
        if page[wire.PAGE] == wire.PARCEL:
            if not program.has_parcel:
                program.take(page)
        elif page[wire.PAGE] != wire.GOAL:
            return
        elif 0 < page[wire.LEG] < wire.JOINS:
            self._on_leg(program, page)
        elif not program.has_goal or self._has_newer(direction):
            alone_on_the_way = program.has_goal and self._consumer.lost
            program.take(page)
            self._begin_to_compare(program)
            self.registers[_SHARED] = 1 << direction
            if alone_on_the_way:
                # Others have gone on by themselves: that gives no more time.
                self._leading.next_leg()
            else:
                self._leading.begin(program.identity)

    def _has_newer(self, direction):
        """Whether a neighbour has a newer program than this cell, which has one."""
        registers = self.registers
        if registers[AHEAD]:
            return registers[AHEAD] >> direction & 1
        return registers[VERDICT] == OUTDATED

    def _begin_to_compare(self, program):
        """Nothing is known yet of others' programs beside the one that has come."""
        registers = self.registers
        registers[_OF] = program.identity << 2 | program.sequence
        for number in (_SHARED, AHEAD, _AGAINST_BEATS, VERDICT, _DEAF_BEATS):
            registers[number] = 0

    def _on_leg(self, program, page):
        """A leg that follows a goal; one of a goal that the cell does not have is dropped."""
        if program is None or not program.take(page):
            return
        if program.identity == self._tracking.identity:
            self._leading.plan_again()

    def _on_host_page(self, identity, page):
        tracking = self._tracking
        if page[wire.PAGE] == wire.END:
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

    def _on_host_goal(self, program, again):
        """The host has sent a goal, perhaps the one that the cell has: it is the newest."""
        if program.identity == self._tracking.identity:
            self._begin_to_compare(program)
            self.registers[_SETTLED] = 1
        if not again:
            self._leading.begin(program.identity)

    def _put(self, identity, page):
        """A parcel lies where the host says, perhaps on this cell; one that it has stays."""
        tracking, place = self._tracking, self._place
        program = self.programs.find(identity)
        if program is None:
            return
        program.begin_at(page)
        if not program.has_parcel or tracking.under:
            return
        x_um = page[wire.PLACE_X] * wire.STEP_UM - place.x_um
        y_um = page[wire.PLACE_Y] * wire.STEP_UM - place.y_um
        if max(abs(x_um), abs(y_um)) < _NEAR_PITCHES * place.pitch_um:
            tracking.adopt(identity)
            tracking.take_shape(program)
            tracking.place(x_um, y_um, turn_um(page[wire.PLACE_YAW]))
        if tracking.identity == identity and not tracking.under:
            tracking.drop()

    # What others show

    def on_gap(self, beats):
        """So many beats were missed, and with them which programs others had."""
        self.registers[_SHARED] = self.registers[_SETTLED] = 0
        if beats >= _LONG_BEATS:
            self.registers[_DEAF_BEATS] = _LONG_BEATS

    # What is sent

    @micropython.native
    def hand_on(self, program, sent, skipped):
        """Send a page, if one of those in the mask `sent`, who have sent an estimate, lacks it.

        That is in this cell's turn, or where that came in one of the beats `skipped` before.
        """
        if (self._heard.beat + self.node_id) % _HAND_ON_BEATS > skipped:
            return
        lacking = _lacking(self._heard.estimates, sent, program.identity, program.sequence)
        for direction in range(DIRECTIONS if lacking else 0):
            if lacking >> direction & 1:
                page = self._page_for(direction, program)
                if program.pack(page, self._objects.data, self._frame_at):
                    self._pdos.trigger(_PROGRAM_PDO)
                    return

    def _page_for(self, direction, program):
        """The number of the page to hand on to a neighbour that lacks one."""
        sequence = self._heard.estimates[direction * wire.ESTIMATE_FIELDS + wire.SEQUENCE]
        if next_sequence(sequence) == program.sequence and sequence:
            return 1
        self._turn = self._turn + 1 & 0xFFFF
        if sequence == program.sequence:
            return 2 + self._turn % max(program.legs, 1)
        return self._turn & 1


def _comparing(registers, heard):
    """What compares programs in each beat, with little to be looked up."""

    @micropython.native
    def compare(  # noqa: PLR0917 - all is at hand
        parcel,
        program,
        sent,
        registers=registers,
        heard=heard,
        estimates=heard.estimates,
        came=heard.estimate_beat,
        compare_all=_compare,
        judge=_judge,
    ):
        """The verdict on a program of this parcel, None without one; neighbours have `sent`."""
        of = parcel << 2
        if program is not None:
            of |= program.sequence
        shown = compare_all(registers, estimates, came, heard.beat, sent, of)
        return judge(registers, shown) if shown else 0

    return compare


@micropython.viper
def _compare(  # noqa: PLR0917 - viper takes no keywords
    registers: ptr16, estimates: ptr16, came: ptr32, beat: int, sent: int, of: int
) -> int:
    """Note who of those that have `sent` has the same program, or had it; 0 if all is well."""
    fields = int(wire.ESTIMATE_FIELDS)
    identity_at = int(wire.IDENTITY)
    state_at = int(wire.STATE)
    sequence_at = int(wire.SEQUENCE)
    flags_at = int(wire.FLAGS)
    lacking = int(wire.LACKING)
    under = int(wire.UNDER)
    parcel = of >> 2
    sequence = of & 3
    if registers[_OF] != of:
        if registers[_OF] >> 2 != parcel:
            registers[_SETTLED] = 0
            registers[_DEAF_BEATS] = 0
        registers[_OF] = of
        registers[_SHARED] = 0
        registers[AHEAD] = 0
        registers[_AGAINST_BEATS] = 0
        registers[VERDICT] = 0
    same_counts = registers[_DEAF_BEATS] < _LONG_BEATS
    shared = registers[_SHARED]
    nobody = int(_NOBODY)
    found = 0
    at = 0
    for direction in range(int(DIRECTIONS)):
        bit = 1 << direction
        fresh = sent & bit
        had = shared & bit
        shared ^= had
        if fresh and estimates[at + identity_at] == parcel:
            nobody = 0
            its = estimates[at + sequence_at] if estimates[at + state_at] == under else 0
            sure = estimates[at + flags_at] & lacking == 0
            if its and its == sequence and same_counts:
                shared |= bit
                if sure:
                    registers[_SETTLED] = 1
            elif its:
                if had:
                    registers[AHEAD] |= bit
                if sure:
                    found |= _OTHER
        elif fresh == 0 and (beat - came[direction]) & 0xFFFFFF <= _SILENT_BEATS:
            nobody = 0
            shared |= had
        at += fields
    registers[_SHARED] = shared
    if registers[AHEAD] | registers[_AGAINST_BEATS] | registers[_DEAF_BEATS]:
        found |= _PENDING
    return found | nobody


def _judge(registers, shown):
    """What comes of what this beat has shown, and of what those before have."""
    has_program = registers[_OF] & 3
    deaf_beats = registers[_DEAF_BEATS]
    if shown & _NOBODY:
        registers[_SETTLED] = 0
        registers[_DEAF_BEATS] = min(deaf_beats + 1, _LONG_BEATS) if has_program else 0
    elif deaf_beats < _LONG_BEATS:
        registers[_DEAF_BEATS] = 0
    against = registers[AHEAD] or (shown & _OTHER and not registers[_SETTLED])
    beats = min(registers[_AGAINST_BEATS] + 1, _OUTDATED_BEATS) if has_program and against else 0
    registers[_AGAINST_BEATS] = beats
    verdict = OUTDATED if beats == _OUTDATED_BEATS else DOUBTED if beats else 0
    registers[VERDICT] = verdict
    return verdict


@micropython.viper
def _lacking(estimates: ptr16, sent: int, parcel: int, sequence: int) -> int:
    """The mask of those that have `sent` that they are at this parcel, and lack of its program.

    That is all or a part of it, or they have the one before.
    """
    fields = int(wire.ESTIMATE_FIELDS)
    identity_at = int(wire.IDENTITY)
    sequence_at = int(wire.SEQUENCE)
    flags_at = int(wire.FLAGS)
    lacking = int(wire.LACKING)
    most = int(wire.SEQUENCE_MAX)
    mask = 0
    direction = 0
    while sent >> direction:
        at = fields * direction
        if sent >> direction & 1 and estimates[at + identity_at] == parcel:
            its = estimates[at + sequence_at]
            if estimates[at + flags_at] & lacking or (its and its % most + 1 == sequence):
                mask |= 1 << direction
        direction += 1
    return mask
