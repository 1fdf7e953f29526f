"""Suspicion: neighbours that contradict a cell's belief for long are left out.

A verdict turns when all evidence of half a second has been against it, either way. So a suspect is
taken in again when it has agreed for as long. A beat without evidence counts for nothing.
"""

from mdms_cell.perception.place import DIRECTIONS
from mdms_protocol.compat import const, micropython

# Kinds of suspicion of a neighbour; in an emergency, bits
PRESENCE = const(0)  # its sensors miss a parcel that lies there, or show one that does not
WHEELS = const(1)  # one of its wheels turns otherwise than the parcel moves
POSE = const(2)  # it believes the parcel elsewhere than all others
SILENCE = const(3)  # it believes and promises nothing, and the parcel needs it
KINDS = const(4)

#: The source and the code of emergency messages.
SOURCE = const(9)
CODE = const(0xFF01)

#: So many times all evidence has to be against a pose until the verdict turns: half a second.
POSE_BEATS = const(50)
#: The eight neighbours, and the cell itself.
CELLS = DIRECTIONS + 1
#: Whose pose is left out: it is wrong, or made by sensors that are.
MISLEADING = 1 << POSE | 1 << PRESENCE


class Suspicion:
    """Verdicts on the eight neighbours and, in the place of a ninth, on the cell's own sensors.

    `out[d]` has a bit for each kind of report that is left out of direction d. `evidence` counts
    the evidence against a verdict, for each kind of each cell. `cases` is the mask of the kinds
    with a suspect or with evidence. Of the other kinds only contradicting evidence counts. `turn`
    is the cell that is judged in this beat.
    """

    def __init__(self):
        self.out = bytearray(CELLS)
        self.evidence = bytearray(CELLS * KINDS)
        self.reset()

    def reset(self):
        """Nobody is suspected."""
        self.cases = self.turn = 0
        self.out[:] = bytes(CELLS)
        self.evidence[:] = bytes(CELLS * KINDS)

    @micropython.native
    def has(self, direction, kind):
        """Whether this is left out of that direction."""
        return self.out[direction] >> kind & 1

    @micropython.native
    def judge(self, direction, kind, contradicts):
        """The evidence of one beat; it contradicts (1, True), or not."""
        if contradicts or self.has_case(kind):
            self._count(direction, kind, bool(contradicts))

    @micropython.native
    def has_case(self, kind):
        """Whether somebody is suspected of this, or evidence of it is counted."""
        return self.cases >> kind & 1

    def _count(self, cell, kind, contradicts):
        """Count the evidence against a verdict, which turns after half a second.

        Poses are compared in each beat, and all else of one cell a beat.
        """
        out, evidence, first = self.out, self.evidence, CELLS * kind
        count = evidence[first + cell] + 1
        if contradicts == bool(out[cell] >> kind & 1):
            count = 0
        elif count >= (POSE_BEATS if kind == POSE else 6):
            count = 0
            out[cell] ^= 1 << kind
        evidence[first + cell] = count
        self.cases &= ~(1 << kind)
        for each in range(CELLS):
            if out[each] >> kind & 1 or evidence[first + each]:
                self.cases |= 1 << kind

    def misleads(self, direction):
        """Whether a pose is left out: it is wrong, or made by sensors that are."""
        return self.out[direction] & MISLEADING

    def trusts(self, direction):
        """Return whether presence bits of that direction may correct a belief.

        Those of one cell that contradicts it may not, since the cell may be wrong. Several cells at
        once are right.
        """
        if self.has(direction, PRESENCE):
            return False
        return not self.evidence[CELLS * PRESENCE + direction] or self.crowd()

    def crowd(self):
        """Return whether sensors of three cells contradict at once: the belief is wrong then."""
        count = 0
        for cell in range(CELLS):
            if self.evidence[CELLS * PRESENCE + cell] and not self.has(cell, PRESENCE):
                count += 1
        return count >= 3

    @micropython.native
    def first(self):
        """The first direction that is suspected of anything; -1 for none."""
        for cell in range(CELLS):
            if self.out[cell]:
                return cell
        return -1
