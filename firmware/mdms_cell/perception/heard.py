"""What a cell has last received from its neighbours, by direction, and since when."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array
from struct import pack_into

from mdms_cell.drive import speed_loop
from mdms_cell.mailboxes import LENGTH, STAMP, Mailboxes
from mdms_cell.perception.place import DIRECTIONS, SENSORS
from mdms_cell.ticks import diff
from mdms_protocol.compat import const, micropython, ptr8, ptr32
from mdms_protocol.neighbours import frames as wire

#: A neighbour's TPDO 2 holds statuswords before the presence bits.
_PRESENCE_AT = const(4)
_STATE_LENGTH = const(5)
#: A state that is repeated may be later than its time by this.
_LATE_MS = const(20)
#: Edges that may wait for the next update.
EDGES = 16
#: The cell itself, in the place of a direction.
OWN = DIRECTIONS
#: In the place of presence bits: they are known, and the bits themselves.
SEEN = const(0x80)
BITS = const(0x1F)
#: The beat of what has never come; beats count below it.
NEVER = const(1 << 24)

# What is used in every beat; constants of another module would be looked up.
_OWN = const(8)
_DIRECTIONS = const(8)
_SENSORS = const(5)
_STAMP = const(0)
_OWN_SPEEDS = const(128)  # where they are among the frames
assert _OWN_SPEEDS == LENGTH * (DIRECTIONS + OWN)
_ACTUAL = const(30)
_OTHER_ACTUAL = const(81)
assert (_OWN, _DIRECTIONS, _SENSORS, _STAMP) == (OWN, DIRECTIONS, SENSORS, STAMP)
assert (1 << SENSORS) - 1 == BITS
assert (_ACTUAL, _OTHER_ACTUAL) == (speed_loop.ACTUAL, speed_loop.AXIS + speed_loop.ACTUAL)


class Heard:
    """Speeds, presence, edges and estimates, the cell's own under `OWN`.

    `beat` is the present one. The boxes have the neighbours' estimates by direction, and behind
    them the frames with their speeds, which are read where they are, stamped with their beat.
    `presence[d]` are a cell's sensors' bits, known with `SEEN`. `estimates` has the fields of
    `neighbours.frames`, `estimate_beat[d]` the beat in which they came; they are to be passed on
    once, while their box is fresh. Of the `edges` that wait, `edge_ms` has the times and
    `edge_bytes` the rest; see `edge`.
    """

    def __init__(self):
        self.beat = 0
        self.boxes = Mailboxes(2 * DIRECTIONS + 1, NEVER)
        self.presence = bytearray(DIRECTIONS + 1)
        self.repeat_ms = 0
        self._state_ms = array("i", [0] * DIRECTIONS)
        self._words = array("H", [0] * (2 * DIRECTIONS))
        self.estimates = array("h", [0] * (wire.ESTIMATE_FIELDS * DIRECTIONS))
        self.estimate_beat = array("i", [NEVER] * DIRECTIONS)
        #: Takes apart estimates that have come; returns how many make no sense.
        self.read = _reading(self, self.boxes)
        self.edges = 0
        self.edge_bytes = bytearray(EDGES)  # direction, sensor and what it shows now, in one byte
        self.edge_ms = array("i", [0] * EDGES)

    def reset(self):
        """Nothing has been received."""
        for direction in range(DIRECTIONS + 1):
            self.presence[direction] &= BITS
            self.boxes.stamps[DIRECTIONS + direction] = NEVER
        for direction in range(DIRECTIONS):
            self.estimate_beat[direction] = NEVER
            self.boxes.fresh[direction] = 0
        self.edges = 0

    @micropython.native
    def begin_beat(self, registers):
        """SYNC: what comes from now on is of the next beat.

        As are the speeds of the cell's own wheels, from the registers of the speed loop.
        """
        boxes = self.boxes
        beat = self.beat = self.beat + 1 & 0xFFFFFF
        boxes.counts[_STAMP] = boxes.stamps[_DIRECTIONS + _OWN] = beat
        first, second = registers[_ACTUAL], registers[_OTHER_ACTUAL]
        pack_into("<ii", boxes.frames, _OWN_SPEEDS, first, second)

    @micropython.native
    def on_state(self, direction, data, now_ms):
        """A neighbour's TPDO 2; returns False if it is none: cells alike have no more sensors."""
        if len(data) != _STATE_LENGTH or data[_PRESENCE_AT] >> _SENSORS:
            return False
        first, second = data[0] | data[1] << 8, data[2] | data[3] << 8
        words, at = self._words, 2 * direction
        known = words[at] == first and words[at + 1] == second
        if not known or self.age_ms(direction, now_ms) < 0:
            # Sent for another reason than a sensor, as one before it may have been that was lost:
            # what sensors show may have changed long ago.
            self.presence[direction] &= BITS
        words[at] = first
        words[at + 1] = second
        self._state_ms[direction] = now_ms
        self.take_presence(direction, data[_PRESENCE_AT], now_ms)
        return True

    @micropython.native
    def age_ms(self, direction, now_ms):
        """How long ago a cell's presence bits were sent; 0 if they are its own, or not repeated.

        Negative if they are not known, as when its repeated state is overdue.
        """
        if not self.presence[direction] & SEEN:
            return -1
        repeat_ms = self.repeat_ms
        if direction == _OWN or not repeat_ms:
            return 0
        age_ms = abs(diff(now_ms, self._state_ms[direction]))
        return age_ms if age_ms <= repeat_ms + _LATE_MS else -1

    @micropython.native
    def take_presence(self, direction, bits, now_ms):
        """Presence bits as they are now; what has changed are edges."""
        before = self.presence[direction]
        if before & SEEN:
            changed = bits ^ before & BITS
            sensor = 0
            while changed:
                if changed & 1 and self.edges < EDGES:
                    shown = bits >> sensor & 1
                    self.edge_bytes[self.edges] = direction << 4 | sensor << 1 | shown
                    self.edge_ms[self.edges] = now_ms
                    self.edges += 1
                changed >>= 1
                sensor += 1
        self.presence[direction] = bits | SEEN

    def edge(self, number):
        """The direction of an edge that waits, its sensor, and what that shows now."""
        edge = self.edge_bytes[number]
        return edge >> 4, edge >> 1 & 7, edge & 1

    def keep_edge(self, number, place):
        """Have an edge wait in another place."""
        self.edge_bytes[place] = self.edge_bytes[number]
        self.edge_ms[place] = self.edge_ms[number]

    def passed_on(self):
        """No estimate is fresh any more; returns the mask of those that were."""
        return _clear(self.boxes.fresh)


def _reading(heard, boxes):
    """What takes apart estimates; it looks nothing up."""

    @micropython.native
    def read(  # noqa: PLR0917 - all is at hand
        frames=boxes.frames,
        fresh=boxes.fresh,
        stamps=boxes.stamps,
        counts=boxes.counts,
        estimates=heard.estimates,
        estimate_beat=heard.estimate_beat,
        read_estimates=wire.read_estimates,
        date=_date,
    ):
        wrong = read_estimates(frames, fresh, estimates, _DIRECTIONS)
        date(fresh, stamps, estimate_beat, counts[_STAMP])
        return wrong

    return read


@micropython.viper
def _clear(fresh: ptr8) -> int:
    mask = 0
    for direction in range(_DIRECTIONS):
        if fresh[direction]:
            fresh[direction] = 0
            mask |= 1 << direction
    return mask


@micropython.viper
def _date(fresh: ptr8, stamps: ptr32, estimate_beat: ptr32, beat: int):
    """Note when estimates have come; those of this beat and the one before stay fresh."""
    for direction in range(_DIRECTIONS):
        if fresh[direction]:
            estimate_beat[direction] = stamps[direction]
            if (beat - stamps[direction]) & 0xFFFFFF > 1:
                fresh[direction] = 0
