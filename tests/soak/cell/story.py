"""A cell's life as a generator that yields frames for the cell, or None to wait for a millisecond.

Between two chapters the cell is led back to 'operation enabled'.
"""

import world
from sdo_client import Client
from traffic import HOST, NEIGHBOUR, SYNC_MS
from watch import EVENT_AT_REST_MS, EVENT_MS, INHIBIT_MS, NODE

from mdms_cell.drive import speed_loop
from mdms_protocol.codecs import cia402, cob, lss, nmt

_UP = (0, cia402.FAULT_RESET, cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)
_PAUSE_MAX_MS = 2000
_BOOT_MS = 200
_REST_MS = 500
_VOLTAGE_2 = speed_loop.AXIS + speed_loop.VOLTAGE
#: Differences from the defaults: two heartbeats watched; RPDO3 takes a neighbour's speeds and
#: leaves them; TPDO3 carries the mode, which never changes, TPDO4 the position, which always may.
_SETTINGS = (
    (0x1016, 1, (HOST << 16 | 250).to_bytes(4, "little")),
    (0x1016, 2, (NEIGHBOUR << 16 | 350).to_bytes(4, "little")),
    (0x1402, 1, cob.INVALID.to_bytes(4, "little")),
    (0x1602, 0, b"\x00"),
    (0x1402, 5, (100).to_bytes(2, "little")),
    (0x1602, 1, b"\x20\x00\x04\x00"),
    (0x1602, 2, b"\x20\x00\x04\x00"),
    (0x1602, 0, b"\x02"),
    (0x1402, 1, (cob.TPDO_BASES[0] + NEIGHBOUR).to_bytes(4, "little")),
    (0x1802, 5, EVENT_MS.to_bytes(2, "little")),
    (0x1802, 1, cob.INVALID.to_bytes(4, "little")),
    (0x1802, 2, b"\xff"),
    (0x1A02, 0, b"\x00"),
    (0x1A02, 1, b"\x08\x00\x61\x60"),
    (0x1A02, 0, b"\x01"),
    (0x1802, 1, (cob.FLAG_30 | cob.TPDO_BASES[2] + NODE).to_bytes(4, "little")),
    (0x1803, 1, cob.INVALID.to_bytes(4, "little")),
    (0x1803, 3, (INHIBIT_MS * 10).to_bytes(2, "little")),
    (0x1803, 5, EVENT_AT_REST_MS.to_bytes(2, "little")),
    (0x1803, 2, b"\xff"),
    (0x1A03, 0, b"\x00"),
    (0x1A03, 1, b"\x20\x00\x63\x60"),
    (0x1A03, 0, b"\x01"),
    (0x1803, 1, (cob.FLAG_30 | cob.TPDO_BASES[3] + NODE).to_bytes(4, "little")),
)


class Story:
    """The life of the cell of `life`; a chapter is a function that gets the story."""

    def __init__(self, life, chance, chapters):
        self.life = life
        self.watch = life.watch
        self.chance = chance
        self.client = Client(life.watch)
        self.emergencies = []
        self.status = bytes(5)
        self.lss = []
        self.booted = False
        self._chapters = chapters

    def hear(self, can_id, data):
        """The cell has sent a frame."""
        if can_id == cob.SDO_RESPONSE_BASE + NODE:
            self.client.responses.append(data)
        elif can_id == cob.EMCY_BASE + NODE:
            self.emergencies.append(data[0] | data[1] << 8)
        elif can_id == cob.TPDO_BASES[1] + NODE:
            self.status = data
        elif can_id == cob.LSS_RESPONSE:
            self.lss.append(data)
        elif can_id == cob.HEARTBEAT_BASE + NODE and data == b"\x00":
            self.booted = True

    def tell(self):
        """The whole life."""
        yield from self._get_node_id()
        yield from self.configure()
        while True:
            for chapter in self._shuffled():
                yield from self.drive()
                yield from self.pause(self.chance.below(_PAUSE_MAX_MS))
                if self.life.sample_due():
                    while world.now_ms % SYNC_MS:
                        yield None
                    self.life.sample()
                    yield None
                self.emergencies.clear()
                yield from chapter(self)
                yield from self.pause(20)

    def _shuffled(self):
        left = list(self._chapters)
        while left:
            yield left.pop(self.chance.below(len(left)))

    def pause(self, duration_ms):
        """Let some time pass."""
        for _ in range(duration_ms):
            yield None

    def _get_node_id(self):
        """A cell out of the box gets its node id, and keeps it."""
        yield from self.pause(100)
        self.watch.expect(not self.booted, "booted without a node id")
        for part in ((lss.SWITCH_GLOBAL, 1), (lss.CONFIGURE_NODE_ID, NODE), (lss.STORE, 0)):
            yield cob.LSS_REQUEST, bytes(part) + bytes(6)
            yield from self.pause(3)
        yield cob.LSS_REQUEST, bytes((lss.SWITCH_GLOBAL, 0)) + bytes(6)
        yield from self.boot()

    def boot(self):
        """Wait for the boot-up message."""
        self.booted = False
        for _ in range(_BOOT_MS):
            yield None
            if self.booted:
                return
        self.watch.find("not booted")

    def configure(self):
        """Give the cell its settings and save them."""
        yield from self.come_to_rest()
        for index, sub, value in _SETTINGS:
            yield from self.write(index, sub, value)
        yield from self.write(0x1010, 1, b"save")

    def come_to_rest(self):
        """To 'pre-operational', and until no wheel brakes any more: flash is written after that."""
        yield from self.command(nmt.ENTER_PRE_OPERATIONAL)
        yield from self.pause(_REST_MS)

    def drive(self):
        """To 'operation enabled', with both wheels turning."""
        yield from self.command(nmt.START)
        for word in _UP:
            yield cob.RPDO_BASES[1] + NODE, bytes((word, 0, word, 0))
            yield from self.pause(2)
        yield from self.pause(60)
        for place in range(2):
            state = cia402.state(self.status[2 * place] | self.status[2 * place + 1] << 8)
            self.watch.expect(state == cia402.OPERATION_ENABLED, f"drive state 0x{state:02X}")
        self.watch.expect(self.turning() == 2, "a motor is off")

    def turning(self):
        """How many motors are on."""
        registers = self.life.board.registers
        count = 0
        for base in (0, speed_loop.AXIS):
            running = registers[base + speed_loop.MODE] == speed_loop.RUN
            count += running and not registers[base + speed_loop.FAULTS]
        return 0 if registers[speed_loop.CUT] else count

    def still(self):
        """Whether no motor has a voltage."""
        registers = self.life.board.registers
        return not registers[speed_loop.VOLTAGE] and not registers[_VOLTAGE_2]

    def command(self, command):
        """An NMT command that leads to another state."""
        yield cob.NMT, bytes((command, NODE))
        yield from self.pause(2)
        wanted = nmt.TRANSITIONS[command]
        self.watch.expect(self.life.cell.state == wanted, f"NMT command {command} not obeyed")

    def restart(self, command):
        """An NMT command that leads to a new boot."""
        self.watch.heartbeat.stop()
        yield cob.NMT, bytes((command, NODE))
        yield from self.boot()

    def through(self, exchange):
        """The requests of the client, on the identifier of the cell's server."""
        try:
            request = next(exchange)
            while True:
                if request is None:
                    yield None
                else:
                    yield cob.SDO_REQUEST_BASE + NODE, request
                request = next(exchange)
        except StopIteration as end:
            return end.value

    def write(self, index, sub, value):
        """Write an entry at once."""
        yield from self.through(self.client.write(index, sub, value))

    def read(self, index, sub):
        """Read an entry; return its bytes."""
        return (yield from self.through(self.client.read(index, sub)))

    def expect_emergency(self, code):
        """A finding, unless there was this emergency message since the chapter began."""
        told = self.emergencies
        self.watch.expect(code in told, f"no emergency 0x{code:04X} but {told}")
