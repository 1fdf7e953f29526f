"""The data and the goal of a parcel: the pages that a host sends and cells hand on."""

from array import array

from mdms_cell.perception.angle import turn_um
from mdms_protocol.compat import micropython
from mdms_protocol.neighbours import frames as wire

#: Programs that a cell keeps of all that the host sends. They are those that come nearest to it,
#: and the last one, whose way is still to be seen.
SLOTS = 13
# Numbers of pages; those of legs follow.
_PARCEL = 0
_GOAL = 1


class Program:
    """One parcel's data and the way to its goal, in `pages` of the fields that frames have.

    The parcel's page comes first, then those of the goal and of the legs. A missing page is empty.
    `complete` is whether parcel and goal are there. `whole` is whether the `legs` that follow the
    goal are there, too. Legs count for the time without a host alone: a host sets the next goal
    itself when it is due. A `sequence` without a goal belongs to an earlier goal: others may be on
    any leg after it by now.
    """

    def __init__(self):
        self._box = array("i", [0] * 4)  # around the way: lowest x, highest x, and so for y
        self.clear(0)

    def clear(self, identity):
        """Begin anew, for this identity."""
        self.identity = identity
        self.pages = [[]] * (2 + wire.LEGS_MAX)
        self._boxed = False
        self.sequence = self.legs = 0
        self.complete = self.whole = False

    @property
    def has_parcel(self):
        """Whether the parcel's data are there."""
        return bool(self.pages[_PARCEL])

    @property
    def has_goal(self):
        """Whether the goal is there."""
        return bool(self.pages[_GOAL])

    def has_goal_of(self, fields):
        """Whether the goal of this page is there, and no other that has its number."""
        return self.sequence == fields[wire.PROGRAM_SEQUENCE] and self._is_at(fields, _GOAL)

    @property
    def goes_on(self):
        """Whether the host's silence does not end the motion."""
        return self.has_parcel and self.pages[_PARCEL][wire.PROGRAM_FLAGS] & wire.GO_ON != 0

    @property
    def any_yaw(self):
        """Whether the yaw at the goal does not matter."""
        return self.pages[_PARCEL][wire.PROGRAM_FLAGS] & wire.ANY_YAW != 0

    def limits(self):
        """The acceleration [mm/s2] and the speed [mm/s]."""
        fields = self.pages[_PARCEL]
        acceleration_mm_s2 = fields[wire.ACCELERATION] * wire.ACCELERATION_MM_S2
        return acceleration_mm_s2, fields[wire.SPEED] * wire.SPEED_MM_S

    def size(self):
        """RECTANGLE or DISC, length or diameter, and width."""
        fields = self.pages[_PARCEL]
        length_um = fields[wire.PARCEL_LENGTH] * wire.STEP_UM
        return fields[wire.SHAPE], length_um, fields[wire.PARCEL_WIDTH] * wire.STEP_UM

    def take(self, fields):
        """Take a page; return whether it is kept."""
        fields = list(fields)
        page = fields[wire.PAGE]
        leg = fields[wire.LEG] if page == wire.GOAL else 0
        if page == wire.PARCEL:
            self.pages[_PARCEL] = fields
        elif page != wire.GOAL:
            return False
        elif 0 < leg < wire.JOINS:
            if not self._lacks_leg(fields, leg):
                return False
            self.pages[_GOAL + leg] = fields
            self._reach(fields)
        else:
            self._take_goal(fields, leg == wire.JOINS)
            self._reach(fields)
        self._look()
        return True

    def begin_at(self, fields):
        """The parcel is where this page says, and its way begins there."""
        self._boxed = False
        self._reach(fields)

    def _reach(self, fields):
        """The way leads to the place of this page."""
        box = self._box
        for axis in range(2):
            place = fields[wire.PLACE_X + axis]
            low, high = (box[2 * axis], box[2 * axis + 1]) if self._boxed else (place, place)
            box[2 * axis] = min(low, place)
            box[2 * axis + 1] = max(high, place)
        self._boxed = True

    def away(self, x, y):
        """How far a point is from the box around the way, along x or y [steps of the wire].

        That is farther than any point if the way is not known.
        """
        if not self._boxed:
            return 1 << 20
        box = self._box
        return max(box[0] - x, x - box[1], box[2] - y, y - box[3], 0)

    def _take_goal(self, fields, joins):
        sequence, legs = fields[wire.PROGRAM_SEQUENCE], fields[wire.LEGS]
        follows = self.has_goal and next_sequence(self.sequence) == sequence
        again = self.has_goal_of(fields) and legs == self.legs
        if joins and follows and self.pages[_GOAL + 1]:
            if self._is_at(fields, _GOAL + 1):
                self._shift()
        elif not again:
            self._drop_from(_GOAL)
        self.pages[_GOAL] = fields
        self.sequence, self.legs = sequence, legs
        self._drop_from(_GOAL + legs + 1)

    def _lacks_leg(self, fields, leg):
        """Whether that page is a leg of the way that this program has, and lacking."""
        of_this = self.has_goal and fields[wire.PROGRAM_SEQUENCE] == self.sequence
        return of_this and leg <= self.legs and not self.pages[_GOAL + leg]

    def advance(self):
        """Have the leg that follows for the goal; returns False where it is not there."""
        if not self.known_legs():
            return False
        self._shift()
        self.sequence = next_sequence(self.sequence)
        self.legs -= 1
        self._look()
        return True

    def outdate(self):
        """Have no goal until a neighbour hands on the present goal of the parcel.

        Sequence numbers come round again after three legs, so they do not tell.
        """
        if self.has_goal:
            self._drop_from(_GOAL)
            self._look()

    def _is_at(self, fields, number):
        page, first, end = self.pages[number], wire.PLACE_X, wire.PLACE_YAW + 1
        return page[first:end] == fields[first:end]

    def _drop_from(self, number):
        for place in range(number, len(self.pages)):
            self.pages[place] = []

    def _shift(self):
        self.pages.pop(_GOAL)
        self.pages.append([])

    def _look(self):
        self.complete = self.has_parcel and self.has_goal
        self.whole = self.complete and self.known_legs() == self.legs

    def known_legs(self):
        """How many legs that follow are there, up to the first that is lacking."""
        legs = 0
        while legs < self.legs and self.pages[_GOAL + legs + 1]:
            legs += 1
        return legs

    def place(self, leg):
        """Where the goal is, or a leg after it ends: x, y and turn."""
        fields = self.pages[_GOAL + leg]
        x_um, y_um = fields[wire.PLACE_X] * wire.STEP_UM, fields[wire.PLACE_Y] * wire.STEP_UM
        return x_um, y_um, turn_um(fields[wire.PLACE_YAW])

    def pack(self, number, frame, at):
        """Write a page as a frame: the parcel's, or from 1 on those of the goal and the legs.

        Return False for a missing page.
        """
        if not self.pages[number]:
            return False
        fields = list(self.pages[number])
        if number:
            fields[wire.PROGRAM_SEQUENCE] = self.sequence
            # A goal that came as a leg joins the way before.
            joins = wire.JOINS if fields[wire.LEG] else 0
            fields[wire.LEG] = number - _GOAL or joins
            fields[wire.LEGS] = self.legs
        wire.pack_program(fields, frame, at)
        return True


class Programs:
    """The programs that a cell keeps; the one that stays farthest away makes room for another.

    `x` and `y` are the cell's place [steps of the wire; table frame]. `own` returns the parcels
    that it is at or promised to, by identity; their programs stay.
    """

    def __init__(self, own=lambda: ()):
        self.x = self.y = 0
        self._own = own
        # The last used program comes first.
        self._slots = [Program() for _ in range(SLOTS)]

    def clear(self):
        """Keep none."""
        for slot in self._slots:
            slot.clear(0)

    @micropython.native
    def complete(self, identity):
        """The program of an identity; None if there is none that is complete."""
        program = self._slots[0]
        if program.identity != identity:
            program = self.find(identity)
        return program if program is not None and program.complete else None

    def find(self, identity):
        """The program of an identity; None if there is none."""
        for slot in self._slots:
            if identity and slot.identity == identity:
                self._move(slot, 0)
                return slot
        return None

    def _move(self, slot, place):
        self._slots.remove(slot)
        self._slots.insert(place, slot)

    def place_for(self, identity):
        """The program of an identity, begun anew if there is none."""
        found = self.find(identity)
        if found is None:
            found = self._to_replace()
            found.clear(identity)
            self._move(found, 0)
        return found

    def _to_replace(self):
        """A slot that is free, else the one of the farthest way, of several the longest unused."""
        own = self._own()
        found, farthest = self._slots[-1], -1
        for slot in self._slots:
            away = slot.away(self.x, self.y)
            if away >= farthest and not (slot.identity and slot.identity in own):
                found, farthest = slot, away
        return found

    def go_on(self):
        """Whether a parcel is on its way that goes on without the host."""
        return any(slot.sequence and slot.goes_on for slot in self._slots)

    def outdate(self, identity):
        """Without the host, keep no goal of any parcel but this one, where this cell is at it."""
        for slot in self._slots:
            if slot.identity != identity:
                slot.outdate()

    def drop(self, identity):
        """Keep nothing of an identity."""
        found = self.find(identity)
        if found is not None:
            found.clear(0)
            self._move(found, SLOTS)  # the last place, which is taken first


def next_sequence(sequence):
    """The sequence of the program that follows."""
    return sequence % wire.SEQUENCE_MAX + 1
