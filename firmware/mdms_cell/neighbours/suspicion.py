"""Who contradicts what a cell believes, and for how long: the neighbours that are left out.

A verdict turns when all evidence of half a second has been against it, either way: a suspect is
taken in again when it has agreed for as long. A beat without evidence counts for nothing.
"""

try:
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const

from mdms_cell.neighbours.geometry.outline import STEP_UM
from mdms_cell.neighbours.geometry.place import AXES, DIRECTIONS
from mdms_cell.neighbours.twist import SLIPS

# What a neighbour is suspected of; in an emergency, bits
PRESENCE = const(0)  # its sensors do not show what lies there, or show what does not
WHEELS = const(1)  # one of its wheels turns otherwise than the parcel moves
POSE = const(2)  # it believes the parcel elsewhere than all others
SILENCE = const(3)  # it believes and promises nothing, and the parcel needs it
KINDS = const(4)

#: In emergency messages: what they come from, and their code.
SOURCE = const(9)
CODE = const(0xFF01)

#: Poses are compared in each beat, all else of one cell a beat: so many times all evidence has to
#: be against a verdict until it turns, which is half a second.
POSE_BEATS = const(50)
_TIMES = bytes((6, 6, POSE_BEATS, 6))
_NOTHING = bytes(DIRECTIONS + 1)
#: So many cells whose sensors contradict at once are right.
_CROWD = const(3)
#: A wheel has to be so far inside the outline to be under it [steps].
_INSIDE = 10_000 // STEP_UM
#: The mask of a cell's wheels among its points.
_WHEELS = (1 << AXES) - 1
#: Wheels that are to agree before one is found wrong.
_ENOUGH_WHEELS = const(5)

#: Who has been silent for less has lost a frame.
_LATE_BEATS = const(3)

#: The cell itself, in the place of a direction.
_OWN = DIRECTIONS
#: Whose pose is left out: it is wrong, or made by sensors that are.
MISLEADING = 1 << POSE | 1 << PRESENCE


class Suspicion:
    """Verdicts on the eight neighbours and, in the place of a ninth, on the cell's own sensors.

    `out[d]` has a bit for each kind that is left out of direction d.
    """

    def __init__(self):
        self.out = bytearray(DIRECTIONS + 1)
        self._against = [bytearray(DIRECTIONS + 1) for _ in range(KINDS)]

    def reset(self):
        """Nobody is suspected."""
        for place in range(DIRECTIONS + 1):
            self.out[place] = 0
            for against in self._against:
                against[place] = 0

    def has(self, direction, kind):
        """Whether this is left out of that direction."""
        return self.out[direction] >> kind & 1

    def is_quiet(self, kind):
        """Whether nobody is suspected, and no evidence of this kind is against anybody."""
        return self._against[kind] == _NOTHING and self.out == _NOTHING

    def judge(self, direction, kind, contradicts):
        """The evidence of one beat."""
        against = self._against[kind]
        if bool(contradicts) == bool(self.has(direction, kind)):
            against[direction] = 0
            return
        against[direction] += 1
        if against[direction] >= _TIMES[kind]:
            against[direction] = 0
            self.out[direction] ^= 1 << kind

    def misleads(self, direction):
        """Whether a pose is left out: it is wrong, or made by sensors that are."""
        return self.out[direction] & MISLEADING

    def trusts(self, direction):
        """Whether presence bits of that direction may correct a belief.

        One that contradicts it may not, for it may be wrong; several at once are right.
        """
        if self.has(direction, PRESENCE):
            return False
        return not self._against[PRESENCE][direction] or self.crowd()

    def crowd(self):
        """Whether so many contradict by their presence bits that it is not they who are wrong."""
        against = self._against[PRESENCE]
        if against == _NOTHING:
            return False
        count = 0
        for direction in range(DIRECTIONS + 1):
            if against[direction] and not self.has(direction, PRESENCE):
                count += 1
        return count >= _CROWD

    def first(self):
        """The first direction that is suspected of anything; -1 for none."""
        if self.out != _NOTHING:
            for direction in range(DIRECTIONS + 1):
                if self.out[direction]:
                    return direction
        return -1


class Evidence:
    """Compares what neighbours send and measure with the belief of a cell under a parcel."""

    def __init__(self, footprint, heard, suspicion):
        self._footprint = footprint
        self._heard = heard
        self._suspicion = suspicion
        self._turn = 0

    def judge(self, tracking, asked):
        """One cell, by what it sent; `asked` is the mask of those asked for the parcel."""
        direction = self._turn = (self._turn + 1) % (DIRECTIONS + 1)
        if direction == _OWN:
            if tracking.is_sure():
                self._judge_wheels(tracking, _OWN)
        elif tracking.is_sure() and self._footprint.present >> direction & 1:
            self._judge_neighbour(tracking, direction, asked >> direction & 1)

    def _judge_neighbour(self, tracking, direction, asked):
        suspicion, heard, beat = self._suspicion, self._heard, self._heard.beat
        silent = (beat - heard.estimate_beat[direction]) & 0xFFFFFF > _LATE_BEATS
        if asked or not silent:
            suspicion.judge(direction, SILENCE, silent)
        if heard.speeds_beat[direction] == beat and not tracking.is_other(direction):
            self._judge_wheels(tracking, direction)

    def _judge_wheels(self, tracking, direction):
        """A wheel well under the parcel is wrong if it does not turn with it."""
        if tracking.twist.wheels < _ENOUGH_WHEELS:
            return
        inside = self._footprint.within(tracking.outline, direction, -_INSIDE) & _WHEELS
        shown = tracking.wheels_against(inside << AXES * direction) if inside else 0
        if shown:
            self._suspicion.judge(direction, WHEELS, shown & SLIPS)
