"""The last frames of a cell's neighbours, by direction, with their age."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array
from struct import pack_into

from mdms_cell.drive import speed_loop
from mdms_cell.mailboxes import LENGTH, STAMP, Mailboxes
from mdms_cell.perception.place import DIRECTIONS, OWN, SENSORS
from mdms_cell.ticks import diff
from mdms_protocol.codecs import cia402
from mdms_protocol.compat import const, micropython, ptr8, ptr16, ptr32
from mdms_protocol.neighbours import frames as wire

#: Edges that may wait for the next update.
EDGES = const(16)
#: In the place of presence bits: they are known, and the bits themselves.
SEEN = const(0x80)
BITS = const(0x1F)
#: The beat of a frame that has never come; beats count below it.
NEVER = const(1 << 24)
#: Beats come round after two days. Before that a frame of so long ago counts as never come.
_FORGOTTEN = const(1 << 22)
#: The box of a direction's speeds is so many behind that of its estimates.
SPEEDS_AT = const(8)


class Heard:
    """Speeds, presence, edges and estimates, the cell's own under `OWN`.

    `beat` is the present one. The boxes have the neighbours' estimates by direction. Behind them
    they have the frames with speeds, stamped with their beat and read in place. `presence[d]` are a
    cell's sensor bits, known with `SEEN`. `estimates` has the fields of `neighbours.frames`, and
    `estimate_beat[d]` the beat in which they came. They are to be passed on once, while their box
    is fresh. Of the waiting `edges`, `edge_ms` has the times and `edge_bytes` the rest; see `edge`.
    `unsupplied` is the mask of the directions whose last statusword says that their motors' supply
    is too low.
    """

    def __init__(self):
        self.beat = 0
        self.boxes = Mailboxes(2 * DIRECTIONS + 1, NEVER)
        self.presence = bytearray(DIRECTIONS + 1)
        self.repeat_ms = self.unsupplied = 0
        self._state_ms = array("i", [0] * DIRECTIONS)
        self._words = array("H", [0] * (2 * DIRECTIONS))
        self.estimates = array("h", [0] * (wire.ESTIMATE_FIELDS * DIRECTIONS))
        self.estimate_beat = array("i", [NEVER] * DIRECTIONS)
        self.edges = 0
        self.edge_bytes = bytearray(EDGES)  # direction, sensor and its present value, in one byte
        self.edge_ms = array("i", [0] * EDGES)

    def reset(self):
        """Nothing has been received."""
        for direction in range(DIRECTIONS + 1):
            self.presence[direction] &= BITS
            self.boxes.stamps[DIRECTIONS + direction] = NEVER
        for direction in range(DIRECTIONS):
            self.estimate_beat[direction] = NEVER
        for field in range(len(self.estimates)):
            self.estimates[field] = 0
        self.pass_over()
        self.edges = self.unsupplied = 0

    @micropython.native
    def begin_beat(self, registers):
        """Begin a beat at SYNC: frames from now on belong to it.

        The speeds of the cell's own wheels belong to it too, from the registers of the speed loop.
        """
        boxes = self.boxes
        beat = self.beat = self.beat + 1 & 0xFFFFFF
        boxes.counts[STAMP] = boxes.stamps[SPEEDS_AT + OWN] = beat
        if not beat & _FORGOTTEN - 1:
            self._forget()
        first = registers[speed_loop.ACTUAL]
        second = registers[speed_loop.AXIS + speed_loop.ACTUAL]
        pack_into("<ii", boxes.frames, LENGTH * (SPEEDS_AT + OWN), first, second)

    def _forget(self):
        """Have frames of long ago count as never come."""
        for dates in (self.boxes.stamps, self.estimate_beat):
            for place in range(len(dates)):
                if dates[place] != NEVER and (self.beat - dates[place]) & 0xFFFFFF >= _FORGOTTEN:
                    dates[place] = NEVER

    @micropython.native
    def read(self):
        """Take apart estimates that have come; returns how many make no sense."""
        boxes = self.boxes
        wrong = wire.read_estimates(boxes.frames, boxes.fresh, self.estimates, DIRECTIONS)
        _date(boxes.fresh, boxes.stamps, self.estimate_beat, self.beat)
        return wrong

    @micropython.native
    def age(self, direction):
        """How many beats ago the last estimate of a direction came; NEVER if none has."""
        came = self.estimate_beat[direction]
        return NEVER if came == NEVER else self.beat - came & 0xFFFFFF

    @micropython.native
    def speeds_age(self, direction):
        """How many beats ago the last speeds of a direction came; NEVER if none have."""
        came = self.boxes.stamps[SPEEDS_AT + direction]
        return NEVER if came == NEVER else self.beat - came & 0xFFFFFF

    @micropython.native
    def hears(self):
        """Whether speeds or an estimate of any neighbour have come in this beat."""
        stamps, beat = self.boxes.stamps, self.beat
        for box in range(2 * DIRECTIONS):  # noqa: SIM110 - no generator
            if stamps[box] == beat:
                return True
        return False

    @micropython.native
    def having(self, field, least, most=None):
        """The mask of the directions whose last estimate has a field of this number, or up to."""
        return directions_having(self.estimates, field, least, least if most is None else most)

    @micropython.native
    def posed(self, identity):
        """The mask of the directions whose last estimate has the pose of the parcel over them."""
        there = self.having(wire.STATE, wire.UNDER) & self.having(wire.IDENTITY, identity)
        return there & self.having(wire.CERTAINTY, 1, 15)

    def silent_beats(self, direction):
        """For how many beats nothing has come of a direction; NEVER if nothing has."""
        return min(self.age(direction), self.speeds_age(direction))

    @micropython.native
    def on_state(self, direction, data, now_ms):
        """A neighbour's TPDO 2: statuswords, and presence bits behind them.

        Returns False if it is none: cells alike have no more sensors.
        """
        if len(data) != 5 or data[4] >> SENSORS:
            return False
        first, second = data[0] | data[1] << 8, data[2] | data[3] << 8
        words, at = self._words, 2 * direction
        known = words[at] == first and words[at + 1] == second
        if not known or self.age_ms(direction, now_ms) < 0:
            # The frame has another cause than a sensor. A lost frame before it may have had one:
            # the sensors may have changed long ago.
            self.presence[direction] &= BITS
        words[at] = first
        words[at + 1] = second
        self.unsupplied |= 1 << direction
        if first & cia402.VOLTAGE_ENABLED:
            self.unsupplied ^= 1 << direction
        self._state_ms[direction] = now_ms
        self.take_presence(direction, data[4], now_ms)
        return True

    @micropython.native
    def age_ms(self, direction, now_ms):
        """How long ago a cell's presence bits were sent; 0 if they are its own, or not repeated.

        Negative if they are not known, as when its repeated state is overdue by 20 ms.
        """
        if not self.presence[direction] & SEEN:
            return -1
        repeat_ms = self.repeat_ms
        if direction == OWN or not repeat_ms:
            return 0
        age_ms = abs(diff(now_ms, self._state_ms[direction]))
        return age_ms if age_ms <= repeat_ms + 20 else -1

    def supply_is_gone(self, now_ms):
        """Whether most neighbours that are heard, two at least, say that of their motors."""
        heard = low = 0
        for direction in range(DIRECTIONS):
            if self.age_ms(direction, now_ms) >= 0:
                heard += 1
                low += self.unsupplied >> direction & 1
        return low >= 2 and 2 * low > heard

    @micropython.native
    def take_presence(self, direction, bits, now_ms):
        """Take presence bits as they are now; changes are edges."""
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

    def pass_over(self):
        """No estimate is fresh any more."""
        for direction in range(DIRECTIONS):
            self.boxes.fresh[direction] = 0


@micropython.viper
def directions_having(estimates: ptr16, field: int, least: int, most: int) -> int:
    """See `Heard.having`; no number is negative."""
    mask = 0
    fields = int(wire.ESTIMATE_FIELDS)
    for direction in range(int(DIRECTIONS)):
        if least <= estimates[fields * direction + field] <= most:
            mask |= 1 << direction
    return mask


@micropython.viper
def _date(fresh: ptr8, stamps: ptr32, estimate_beat: ptr32, beat: int):
    """Note when estimates have come; those of this beat and the one before stay fresh."""
    for direction in range(int(DIRECTIONS)):
        if fresh[direction]:
            estimate_beat[direction] = stamps[direction]
            if (beat - stamps[direction]) & 0xFFFFFF > 1:
                fresh[direction] = 0


@micropython.viper
def speed_um_s(frames: ptr8, wheel: int, most: int) -> int:
    """The speed of a wheel, 2 * direction + axis, in its cell's frame; none is above `most`."""
    at = SPEEDS_AT * int(LENGTH) + 4 * wheel
    speed = frames[at] | frames[at + 1] << 8 | frames[at + 2] << 16
    speed |= ((frames[at + 3] ^ 0x80) - 0x80) << 24
    if speed > most:
        return most
    return speed if speed > 0 - most else 0 - most
