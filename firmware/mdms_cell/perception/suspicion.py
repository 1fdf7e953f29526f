"""Who contradicts what a cell believes, and for how long: the neighbours that are left out.

A verdict turns when all evidence of half a second has been against it, either way: a suspect is
taken in again when it has agreed for as long. A beat without evidence counts for nothing.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from mdms_cell.perception.footprint import PRESENT, points_within
from mdms_cell.perception.place import AXES, DIRECTIONS
from mdms_cell.perception.twist import SLIPS, against
from mdms_cell.perception.twist import WHEELS as TWIST_WHEELS
from mdms_protocol.compat import const, micropython, ptr8

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
_TIMES = const(6)
#: The eight neighbours, and the cell itself.
_CELLS = const(9)
assert _CELLS == DIRECTIONS + 1
# Where evidence begins behind the verdicts, the mask of cases behind that, and whose turn it is.
_AGAINST = const(9)
CASES = const(45)
_TURN = const(46)
assert (_AGAINST, CASES) == (_CELLS, _CELLS * (KINDS + 1))
#: So many cells whose sensors contradict at once are right.
_CROWD = const(3)
#: Wheels that are to agree before one is found wrong.
_ENOUGH_WHEELS = const(5)

#: Who has been silent for less has lost a frame.
_LATE_BEATS = const(3)

#: A wheel has to be so far inside the outline to be under it, 10 mm [steps].
_INSIDE = const(625)
#: The cell itself, in the place of a direction.
_OWN = const(8)
_DIRECTIONS = const(8)
assert _OWN == _DIRECTIONS == DIRECTIONS
# What is used in every beat; constants of another module would be looked up.
_AXES = const(2)
_WHEELS_SHOWN = const(26)
_SLIPS = const(2)
_PRESENT = const(36)
assert _PRESENT == PRESENT
assert (_AXES, _WHEELS_SHOWN, _SLIPS) == (AXES, TWIST_WHEELS, SLIPS)
#: Whose pose is left out: it is wrong, or made by sensors that are.
MISLEADING = 1 << POSE | 1 << PRESENCE


class Suspicion:
    """Verdicts on the eight neighbours and, in the place of a ninth, on the cell's own sensors.

    `out[d]` has a bit for each kind that is left out of direction d; behind these comes for each
    kind the evidence against the cells, and `out[CASES]`, the mask of those kinds of which somebody
    is suspected, or evidence is counted: of the others evidence counts that contradicts, and no
    other.
    """

    def __init__(self):
        self.out = bytearray(_TURN + 1)

    def reset(self):
        """Nobody is suspected."""
        for place in range(CASES + 1):
            self.out[place] = 0

    @micropython.native
    def has(self, direction, kind):
        """Whether this is left out of that direction."""
        return self.out[direction] >> kind & 1

    @micropython.native
    def judge(self, direction, kind, contradicts):
        """The evidence of one beat; it contradicts (1, True), or not."""
        out = self.out
        if contradicts or out[CASES] >> kind & 1:
            _judge(out, direction, kind, contradicts)

    def misleads(self, direction):
        """Whether a pose is left out: it is wrong, or made by sensors that are."""
        return self.out[direction] & MISLEADING

    def trusts(self, direction):
        """Whether presence bits of that direction may correct a belief.

        One that contradicts it may not, for it may be wrong; several at once are right.
        """
        if self.has(direction, PRESENCE):
            return False
        return not self.out[_AGAINST + _CELLS * PRESENCE + direction] or self.crowd()

    def crowd(self):
        """Whether so many contradict by their presence bits that it is not they who are wrong."""
        return _crowd(self.out) >= _CROWD

    @micropython.native
    def first(self):
        """The first direction that is suspected of anything; -1 for none."""
        return _first(self.out)


@micropython.viper
def _judge(out: ptr8, cell: int, kind: int, contradicts: int):
    """Count the evidence against a verdict, which turns after so many times."""
    times = POSE_BEATS if kind == POSE else _TIMES
    evidence = _AGAINST + _CELLS * kind
    count = out[evidence + cell] + 1
    if contradicts == out[cell] >> kind & 1:
        count = 0
    elif count >= times:
        count = 0
        out[cell] ^= 1 << kind
    out[evidence + cell] = count
    left = 0
    for each in range(_CELLS):
        left |= out[each] >> kind & 1 | out[evidence + each]
    others = out[CASES] & ~(1 << kind)
    out[CASES] = others | 1 << kind if left else others


@micropython.viper
def _crowd(out: ptr8) -> int:
    """How many cells contradict by their presence bits, and are not suspected for them."""
    count = 0
    for cell in range(_CELLS):
        if out[_AGAINST + _CELLS * PRESENCE + cell] and not out[cell] >> PRESENCE & 1:
            count += 1
    return count


@micropython.viper
def _first(out: ptr8) -> int:
    for cell in range(_CELLS):
        if out[cell]:
            return cell
    return -1


def judging(tracking, footprint, heard, suspicion):
    """What compares what a neighbour sends and measures with the belief of a cell under a parcel.

    One cell a beat; it looks up what changes, and nothing else.
    """

    @micropython.native
    def judge(  # noqa: PLR0917 - all is at hand
        asked,
        tracking=tracking,
        suspicion=suspicion,
        out=suspicion.out,
        footprint=footprint.registers,
        registers=tracking.belief.registers,
        heard=heard,
        estimate_beat=heard.estimate_beat,
        stamps=heard.boxes.stamps,
        frames=heard.boxes.frames,
        points_within=points_within,
        against=against,
    ):
        """`asked` is the mask of those asked for the parcel."""
        direction = out[_TURN]
        direction = out[_TURN] = direction + 1 if direction < _OWN else 0
        if not tracking.is_sure():
            return
        if direction != _OWN:
            if not footprint[_PRESENT] >> direction & 1:
                return
            beat = heard.beat
            silent = (beat - estimate_beat[direction]) & 0xFFFFFF > _LATE_BEATS
            if asked >> direction & 1 if silent else out[CASES] >> SILENCE & 1:
                suspicion.judge(direction, SILENCE, silent)
            if stamps[_DIRECTIONS + direction] != beat or tracking.others >> direction & 1:
                return
        if registers[_WHEELS_SHOWN] >= _ENOUGH_WHEELS:
            # A wheel well under the parcel is wrong if it does not turn with it.
            wheels = points_within(registers, footprint, direction, _AXES, -_INSIDE)
            shown = against(registers, footprint, frames, direction, wheels)
            if shown & _SLIPS or (shown and out[CASES] >> WHEELS & 1):
                suspicion.judge(direction, WHEELS, shown & _SLIPS != 0)

    return judge
