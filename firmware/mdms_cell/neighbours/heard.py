"""What a cell has last received from its neighbours, by direction, and since when."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr8, ptr32

from array import array

from mdms_cell import ticks
from mdms_cell.neighbours.geometry.place import DIRECTIONS
from mdms_protocol.neighbours import frames as wire

#: What neighbours' frames hold besides: statuswords before the presence bits, and two speeds.
_PRESENCE_AT = const(4)
_STATE_LENGTH = const(5)
_SPEEDS_LENGTH = const(8)
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
    which they came; they are to be passed on once, while `fresh[d]`. An edge is a direction, a
    sensor, what it shows now and a time [ms].
    """

    def __init__(self):
        self.beat = 0
        self.speeds = array("i", [0] * (2 * DIRECTIONS + 2))
        self.speeds_beat = array("i", [NEVER] * (DIRECTIONS + 1))
        self.presence = bytearray(DIRECTIONS + 1)
        self.seen = bytearray(DIRECTIONS + 1)
        self.repeat_ms = 0
        self._state_ms = array("i", [0] * DIRECTIONS)
        self.estimates = array("i", [0] * (wire.ESTIMATE_FIELDS * DIRECTIONS))
        self.estimate_beat = array("i", [NEVER] * DIRECTIONS)
        self.fresh = bytearray(DIRECTIONS)
        self.edges = 0
        self.edge_direction = bytearray(EDGES)
        self.edge_sensor = bytearray(EDGES)
        self.edge_covered = bytearray(EDGES)
        self.edge_ms = array("i", [0] * EDGES)

    def reset(self):
        """Nothing has been received."""
        for direction in range(DIRECTIONS + 1):
            self.speeds_beat[direction] = NEVER
            self.seen[direction] = 0
        for direction in range(DIRECTIONS):
            self.estimate_beat[direction] = NEVER
            self.fresh[direction] = 0
        self.edges = 0

    # Defaults, not variables from around: MicroPython allocates at each call for more than a few.

    def speeds_receiver(self, direction):
        """What takes a neighbour's TPDO 1; it returns False for one of another length."""
        at = 2 * direction

        def receive(data, heard=self, direction=direction, at=at):
            if len(data) != _SPEEDS_LENGTH:
                return False
            _read_speeds(data, heard.speeds, at)
            heard.speeds_beat[direction] = heard.beat
            return True

        return receive

    def estimate_receiver(self, direction):
        """What takes a neighbour's TPDO 3; it returns False for one that is none."""
        at = wire.ESTIMATE_FIELDS * direction

        def receive(data, heard=self, direction=direction, at=at, read=wire.read_estimate):
            if not read(data, len(data), heard.estimates, at):
                return False
            heard.estimate_beat[direction] = heard.beat
            heard.fresh[direction] = 1
            return True

        return receive

    def take_speeds(self, speeds_um_s, other_um_s):
        """The speeds of the cell's own wheels at the last SYNC."""
        self.speeds[2 * OWN] = speeds_um_s
        self.speeds[2 * OWN + 1] = other_um_s
        self.speeds_beat[OWN] = self.beat

    def on_state(self, direction, data, now_ms):
        """A neighbour's TPDO 2; returns False if it has another length."""
        if len(data) != _STATE_LENGTH:
            return False
        if not self.is_current(direction, now_ms):
            # One before it was lost: what has changed since may have changed long ago.
            self.seen[direction] = 0
        self._state_ms[direction] = now_ms
        self.take_presence(direction, data[_PRESENCE_AT], now_ms)
        return True

    def is_current(self, direction, now_ms):
        """Whether the presence bits of a cell are known; not if its repeated state is overdue."""
        if not self.seen[direction]:
            return False
        if direction == OWN or not self.repeat_ms:
            return True
        return abs(ticks.diff(now_ms, self._state_ms[direction])) <= self.repeat_ms + _LATE_MS

    def take_presence(self, direction, bits, now_ms):
        """Presence bits as they are now; what has changed are edges."""
        changed = bits ^ self.presence[direction]
        if self.seen[direction]:
            sensor = 0
            while changed:
                if changed & 1 and self.edges < EDGES:
                    self.edge_direction[self.edges] = direction
                    self.edge_sensor[self.edges] = sensor
                    self.edge_covered[self.edges] = bits >> sensor & 1
                    self.edge_ms[self.edges] = now_ms
                    self.edges += 1
                changed >>= 1
                sensor += 1
        self.presence[direction] = bits
        self.seen[direction] = 1

    def drop_estimates(self):
        """What has come may be of any age: it is not passed on."""
        for direction in range(DIRECTIONS):
            self.fresh[direction] = 0


@micropython.viper
def _read_speeds(data: ptr8, speeds: ptr32, at: int):
    speeds[at] = data[0] | data[1] << 8 | data[2] << 16 | ((data[3] ^ 0x80) - 0x80) << 24
    speeds[at + 1] = data[4] | data[5] << 8 | data[6] << 16 | ((data[7] ^ 0x80) - 0x80) << 24
