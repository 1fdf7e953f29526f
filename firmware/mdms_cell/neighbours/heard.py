"""What a cell has last received from its neighbours, by direction, and since when."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr8, ptr32

from array import array

from mdms_cell.mailboxes import STAMP, Mailboxes
from mdms_cell.neighbours.geometry.place import DIRECTIONS, SENSORS
from mdms_cell.ticks import diff
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
#: The beat of what has never come; beats count below it.
NEVER = const(1 << 24)


class Heard:
    """Speeds, presence, edges and estimates, the cell's own under `OWN`.

    `beat` is the present one. `speeds[2 * d]` and the next are those of direction d [um/s], valid
    where `speeds_beat[d]` is the present beat. `presence[d]` are its sensors' bits, valid where
    `seen[d]`. `estimates` has the fields of `neighbours.frames`, `estimate_beat[d]` the beat in
    which they came; they are to be passed on once, while `fresh[d]`. Of the `edges` that wait,
    `edge_ms` has the times and
    `edge_bytes` the rest; see `edge`.
    """

    def __init__(self):
        self.beat = 0
        self.boxes = Mailboxes(2 * DIRECTIONS, NEVER)
        self.speeds = array("i", [0] * (2 * DIRECTIONS + 2))
        self.speeds_beat = array("i", [NEVER] * (DIRECTIONS + 1))
        self.presence = bytearray(DIRECTIONS + 1)
        self.seen = bytearray(DIRECTIONS + 1)
        self.repeat_ms = 0
        self._state_ms = array("i", [0] * DIRECTIONS)
        self._words = array("H", [0] * (2 * DIRECTIONS))
        self.estimates = array("i", [0] * (wire.ESTIMATE_FIELDS * DIRECTIONS))
        self.estimate_beat = array("i", [NEVER] * DIRECTIONS)
        self.fresh = self.boxes.fresh
        self.edges = 0
        self.edge_bytes = bytearray(EDGES)  # direction, sensor and what it shows now, in one byte
        self.edge_ms = array("i", [0] * EDGES)

    def reset(self):
        """Nothing has been received."""
        for direction in range(DIRECTIONS + 1):
            self.speeds_beat[direction] = NEVER
            self.seen[direction] = 0
        for direction in range(DIRECTIONS):
            self.estimate_beat[direction] = NEVER
        for box in range(2 * DIRECTIONS):
            self.fresh[box] = 0
        self.edges = 0

    def begin_beat(self):
        """SYNC: what comes from now on is of the next beat."""
        self.beat = self.boxes.counts[STAMP] = (self.beat + 1) & 0xFFFFFF

    @micropython.native
    def read(self):
        """Take apart the estimates and speeds that have come; returns how many make no sense."""
        boxes = self.boxes
        wrong = wire.read_estimates(boxes.frames, boxes.fresh, self.estimates, 0, DIRECTIONS)
        _read(
            boxes.frames,
            boxes.fresh,
            boxes.stamps,
            self.estimate_beat,
            self.speeds,
            self.speeds_beat,
            self.beat,
        )
        return wrong

    def take_speeds(self, speeds_um_s, other_um_s):
        """The speeds of the cell's own wheels at the last SYNC."""
        self.speeds[2 * OWN] = speeds_um_s
        self.speeds[2 * OWN + 1] = other_um_s
        self.speeds_beat[OWN] = self.beat

    def on_state(self, direction, data, now_ms):
        """A neighbour's TPDO 2; returns False if it is none: cells alike have no more sensors."""
        if len(data) != _STATE_LENGTH or data[_PRESENCE_AT] >> SENSORS:
            return False
        first, second = data[0] | data[1] << 8, data[2] | data[3] << 8
        words, at = self._words, 2 * direction
        if (words[at], words[at + 1]) != (first, second) or self.age_ms(direction, now_ms) < 0:
            # Sent for another reason than a sensor, as one before it may have been that was lost:
            # what sensors show may have changed long ago.
            self.seen[direction] = 0
        words[at], words[at + 1] = first, second
        self._state_ms[direction] = now_ms
        self.take_presence(direction, data[_PRESENCE_AT], now_ms)
        return True

    @micropython.native
    def age_ms(self, direction, now_ms):
        """How long ago a cell's presence bits were sent; 0 if they are its own, or not repeated.

        Negative if they are not known, as when its repeated state is overdue.
        """
        if not self.seen[direction]:
            return -1
        repeat_ms = self.repeat_ms
        if direction == OWN or not repeat_ms:
            return 0
        age_ms = abs(diff(now_ms, self._state_ms[direction]))
        return age_ms if age_ms <= repeat_ms + _LATE_MS else -1

    def take_presence(self, direction, bits, now_ms):
        """Presence bits as they are now; what has changed are edges."""
        changed = bits ^ self.presence[direction]
        if self.seen[direction]:
            sensor = 0
            while changed:
                if changed & 1 and self.edges < EDGES:
                    shown = bits >> sensor & 1
                    self.edge_bytes[self.edges] = direction << 4 | sensor << 1 | shown
                    self.edge_ms[self.edges] = now_ms
                    self.edges += 1
                changed >>= 1
                sensor += 1
        self.presence[direction] = bits
        self.seen[direction] = 1

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
        return _clear(self.fresh)


@micropython.viper
def _clear(fresh: ptr8) -> int:
    mask = 0
    for direction in range(int(DIRECTIONS)):
        if fresh[direction]:
            fresh[direction] = 0
            mask |= 1 << direction
    return mask


@micropython.viper
def _read(  # noqa: PLR0917 - viper takes words
    frames: ptr8,
    fresh: ptr8,
    stamps: ptr32,
    estimate_beat: ptr32,
    speeds: ptr32,
    beats: ptr32,
    beat: int,
):
    """Note when estimates have come, and take apart speeds.

    Estimates of this beat and the one before stay fresh.
    """
    directions = int(DIRECTIONS)
    for direction in range(directions):
        if fresh[direction]:
            estimate_beat[direction] = stamps[direction]
            if (beat - stamps[direction]) & 0xFFFFFF > 1:
                fresh[direction] = 0
        box = directions + direction
        if fresh[box]:
            fresh[box] = 0
            beats[direction] = stamps[box]
            at = 8 * box
            speed = frames[at] | frames[at + 1] << 8 | frames[at + 2] << 16
            speeds[2 * direction] = speed | ((frames[at + 3] ^ 0x80) - 0x80) << 24
            speed = frames[at + 4] | frames[at + 5] << 8 | frames[at + 6] << 16
            speeds[2 * direction + 1] = speed | ((frames[at + 7] ^ 0x80) - 0x80) << 24
