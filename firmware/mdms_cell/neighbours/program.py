"""What a parcel is and where it is to go: the pages that a host sends and cells hand on."""

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython

from array import array

from mdms_cell.neighbours.geometry.angle import TURN_UM
from mdms_protocol.neighbours import frames as wire

#: A cell is near one parcel, and may be asked for by a few more.
SLOTS = 4
#: Numbers of a place: x, y and yaw, as the wire has them.
_PLACE = 3
#: Where the places begin behind the fields of the parcel's page: first that of the goal.
GOAL = const(9)
assert GOAL == wire.PROGRAM_FIELDS
#: The page of a goal or a leg that is sent; there once, so that nothing is allocated.
_PAGE = array("i", [0] * wire.PROGRAM_FIELDS)


class Program:
    """One parcel's data and the way to its goal, in `fields` as their pages have them.

    Those of the parcel's page come first, then x, y and yaw of the goal and of the legs. `complete`
    is whether parcel and goal are there, `whole` whether the legs that follow the goal are, too.
    These count for the time without a host alone: while there is one, it sets the next goal when
    that is to be gone to. `outdated` is whether a goal was there, and others may be on any leg
    after it by now.
    """

    def __init__(self):
        self.identity = 0
        self.used = 0
        self.fields = array("i", [0] * (GOAL + _PLACE * (wire.LEGS_MAX + 1)))
        self.clear(0)

    def clear(self, identity):
        """Begin anew, for this identity."""
        self.identity = identity
        self.sequence = 0
        self.has_parcel = self.has_goal = self.complete = self.whole = self.outdated = False
        # How many legs follow the goal, and the mask of places that are there: bit 0 the goal.
        self.legs = 0
        self._held = 0
        self._joins = False

    def size(self):
        """RECTANGLE or DISC, length or diameter, and width."""
        fields = self.fields
        length_um = fields[wire.PARCEL_LENGTH] * wire.STEP_UM
        return fields[wire.SHAPE], length_um, fields[wire.PARCEL_WIDTH] * wire.STEP_UM

    def take(self, fields):
        """Take a page; returns whether it is one that is kept."""
        page = fields[wire.PAGE]
        leg = fields[wire.LEG] if page == wire.GOAL else 0
        if page == wire.PARCEL:
            self._take_parcel(fields)
        elif page != wire.GOAL:
            return False
        elif 0 < leg < wire.JOINS:
            return self._take_leg(fields, leg)
        else:
            self._take_goal(fields, leg == wire.JOINS)
        self._look()
        return True

    def _take_parcel(self, fields):
        self.goes_on = bool(fields[wire.PROGRAM_FLAGS] & wire.GO_ON)
        self.has_parcel = True
        for place in range(wire.PROGRAM_FIELDS):
            self.fields[place] = fields[place]

    def _take_goal(self, fields, joins):
        sequence, legs = fields[wire.PROGRAM_SEQUENCE], fields[wire.LEGS]
        follows = self.has_goal and next_sequence(self.sequence) == sequence
        again = self._is_at(fields, 0) and (sequence, legs) == (self.sequence, self.legs)
        if joins and follows and self._held & 2:
            if self._is_at(fields, 1):
                self._shift()
        elif not again:
            self._held = 0
        self._put(fields, 0)
        self.outdated = False
        self.sequence, self.legs, self._joins = sequence, legs, joins
        self._held &= (2 << legs) - 1

    def _take_leg(self, fields, leg):
        """Take a leg of the way that this program has; returns whether it was lacking."""
        of_this = self.has_goal and fields[wire.PROGRAM_SEQUENCE] == self.sequence
        if not of_this or leg > self.legs or self._held >> leg & 1:
            return False
        self._put(fields, leg)
        self._look()
        return True

    def advance(self):
        """Have the leg that follows for the goal; returns False where it is not there."""
        if not self._held & 2:
            return False
        self._shift()
        self.sequence = next_sequence(self.sequence)
        self.legs -= 1
        self._joins = True
        self._look()
        return True

    def outdate(self):
        """Have no goal until somebody hands on the one that the parcel is on its way to.

        Sequence numbers come round again after three legs, so that they do not tell.
        """
        if self.complete:
            self._held = 0
            self._look()
            self.outdated = True

    def _put(self, fields, leg):
        for place in range(_PLACE):
            self.fields[GOAL + _PLACE * leg + place] = fields[wire.PLACE_X + place]
        self._held |= 1 << leg

    def _is_at(self, fields, leg):
        return self._held >> leg & 1 and all(
            self.fields[GOAL + _PLACE * leg + place] == fields[wire.PLACE_X + place]
            for place in range(_PLACE)
        )

    def _shift(self):
        for place in range(GOAL + _PLACE, len(self.fields)):
            self.fields[place - _PLACE] = self.fields[place]
        self._held >>= 1

    def _look(self):
        self.has_goal = bool(self._held & 1)
        self.complete = self.has_parcel and self.has_goal
        self.whole = self.complete and self._held == (2 << self.legs) - 1

    def known_legs(self):
        """How many legs that follow are there, up to the first that is lacking."""
        legs = 0
        while self._held >> legs + 1 & 1:
            legs += 1
        return legs

    def place(self, leg):
        """Where the goal is, or a leg after it ends: x, y and turn."""
        start = GOAL + _PLACE * leg
        x, y, yaw = self.fields[start : start + _PLACE]
        return x * wire.STEP_UM, y * wire.STEP_UM, turn_um(yaw)

    def pack(self, number, frame, at):
        """Write a page as a frame: the parcel's, or from 1 on those of the goal and the legs.

        Returns False for one that is not there.
        """
        if not number:
            wire.pack_program(self.fields, 0, frame, at)
            return True
        leg = number - 1
        if not self._held >> leg & 1:
            return False
        _PAGE[wire.PARCEL_IDENTITY] = self.identity
        _PAGE[wire.PAGE] = wire.GOAL
        _PAGE[wire.PROGRAM_SEQUENCE] = self.sequence
        _PAGE[wire.LEG] = leg or (wire.JOINS if self._joins else 0)
        _PAGE[wire.LEGS] = self.legs
        for place in range(_PLACE):
            _PAGE[wire.PLACE_X + place] = self.fields[GOAL + _PLACE * leg + place]
        wire.pack_program(_PAGE, 0, frame, at)
        return True


class Programs:
    """The programs that a cell keeps; the one longest unused makes room for another."""

    def __init__(self):
        self._slots = [Program() for _ in range(SLOTS)]
        self.clear()

    def clear(self):
        """Keep none."""
        for slot in self._slots:
            slot.clear(0)
            slot.used = 0
        self._latest = self._slots[0]
        self._uses = 0

    @micropython.native
    def complete(self, identity):
        """The program of an identity; None if there is none that is complete."""
        program = self._latest
        if program.identity != identity:
            program = self.find(identity)
        return program if program is not None and program.complete else None

    def find(self, identity):
        """The program of an identity; None if there is none."""
        for slot in self._slots:
            if identity and slot.identity == identity:
                self._use(slot)
                return slot
        return None

    def _use(self, slot):
        self._latest = slot
        self._uses += 1
        slot.used = self._uses

    def place_for(self, identity):
        """The program of an identity, begun anew if there is none."""
        found = self.find(identity)
        if found is None:
            found = self._slots[0]
            for slot in self._slots:
                if slot.used < found.used:
                    found = slot
            found.clear(identity)
            self._use(found)
        return found

    def go_on(self):
        """Whether a parcel is on its way that goes on without the host."""
        return any(
            slot.identity and (slot.complete or slot.outdated) and slot.goes_on
            for slot in self._slots
        )

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
            found.used = 0


def next_sequence(sequence):
    """The sequence of the program that follows."""
    return sequence % wire.SEQUENCE_MAX + 1


def turn_um(yaw):
    """An angle of the wire as the way of a point at the arm [um]."""
    return yaw * (TURN_UM // 8) // (wire.TURN // 8)
