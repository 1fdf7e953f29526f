"""A cell's hour on the bus, for the heap that it takes; runs on the 32-bit MicroPython.

Targets and SYNC come at 100 Hz, a heartbeat to watch at 10 Hz, an SDO request every second, a long
and a block transfer every minute. `live` looks after the cell every 5 ms and leaves out the ticks,
which is all that can take memory; `live_fully` leaves out nothing.
"""

from array import array

NODE = 5
CYCLE_MS = 10
HOUR_MS = 3_600_000


class Board:
    """Takes frames and throws them away."""

    def __init__(self, inbox, outbox):
        from mdms_cell.drive import speed_loop  # not before the firmware is measured

        self.registers = array("i", [0] * speed_loop.REGISTERS)
        self.inbox = inbox
        self.outbox = outbox
        self.sent = 0

    def sample(self, registers):
        pass

    def drive(self, registers):
        pass

    def presence(self):
        return 0

    def place(self):
        return 0

    def send(self, can_id, data):
        self.sent += 1
        return True


class Driven:
    """A cell on faked peripherals, spoken to over its bus; a poll is a tick and a turn."""

    def __init__(self, world, runner):
        self._world = world
        self._runner = runner
        self.now_ms = 0

    def on_frame(self, can_id, data, _now_ms):
        self._world.buses[0].deliver(can_id, data)
        self._runner.turn(self._world.now_ms)

    def poll(self, now_ms):
        world = self._world
        self.now_ms = now_ms
        world.now_ms = now_ms - 1
        world.advance()
        self._runner.turn(now_ms)
        world.sent.clear()


class Traffic:
    """Frames that a cell receives; `live` is called until it returns False."""

    def __init__(self, cell):
        self._cell = cell
        self._now_ms = 0

    def boot(self):
        """Let the cell claim its node id, and take it to 'operational' with its motors on."""
        while self._now_ms < 200:
            self._cell.poll(self._now_ms)
            self._now_ms += 1
        self._cell.on_frame(0x000, b"\x01\x00", self._cell.now_ms)
        self._ask(b"\x23\x16\x10\x01\xf4\x01\x7f\x00")
        for word in (b"\x06\0\x06\0", b"\x07\0\x07\0", b"\x0f\0\x0f\0"):
            self._cell.on_frame(0x300 + NODE, word, self._cell.now_ms)

    def live(self, cycles):
        """Let so many periods of SYNC pass; False when the hour is over."""
        cell = self._cell
        for _ in range(cycles):
            now_ms = self._now_ms
            self._cycle()
            cell.poll(now_ms)
            cell.poll(now_ms + 5)
        return self._now_ms < HOUR_MS

    def live_fully(self, cycles):
        """As `live`, with a tick and a poll every millisecond."""
        cell = self._cell
        for _ in range(cycles):
            now_ms = self._now_ms
            self._cycle()
            for ms in range(now_ms, now_ms + CYCLE_MS):
                cell.tick()
                cell.poll(ms)
        return self._now_ms < HOUR_MS

    def _cycle(self):
        cell = self._cell
        now_ms = self._now_ms
        cell.on_frame(0x200 + NODE, b"\x20\x4e\0\0\xe0\xb1\xff\xff", cell.now_ms)
        cell.on_frame(0x080, b"", cell.now_ms)
        if now_ms % 100 == 0:
            cell.on_frame(0x77F, b"\x05", cell.now_ms)
        if now_ms % 1000 == 0:
            self._ask(b"\x40\x6c\x60\x00\0\0\0\0")
        if now_ms % 60_000 == 30_000:
            self._read_text()
        if now_ms % 60_000 == 0:
            self._read_block()
        self._now_ms = now_ms + CYCLE_MS

    def _ask(self, request):
        self._cell.on_frame(0x600 + NODE, request, self._cell.now_ms)

    def _read_text(self):
        self._ask(b"\x40\x09\x10\x00\0\0\0\0")
        for toggle in (0x60, 0x70, 0x60):
            self._ask(bytes((toggle, 0, 0, 0, 0, 0, 0, 0)))

    def _read_block(self):
        for request in (b"\xa4\x09\x10\x00\x7f\0\0\0", b"\xa3", b"\xa2\x03\x7f", b"\xa1"):
            self._ask(request + bytes(8 - len(request)))
