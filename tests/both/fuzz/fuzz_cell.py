"""Throws seeded frames at a cell and sums up its replies; the sum is the same everywhere.

Frames come as the CAN interrupt finds them, and every so many a millisecond passes, in which the
cell ticks and the background makes a turn.
"""

import binascii
import gc
from array import array

import fuzz_services
from fuzz_frames import Chance, Frames
from fuzz_services import NODE, SERIAL

from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop
from mdms_cell.queues import Inbox
from mdms_cell.runner import Runner
from mdms_protocol.codecs import cob, nmt

_FRAMES_PER_MS = 4
_MS_MASK = (1 << 30) - 1
#: In a pause the background makes a turn only so often.
_PAUSE_STEP_MS = 5
_LOST_FRAMES = 500
_SLICE = 2_500
_BANK_SIZE = 1024
_OVER_CURRENT_MA = 1_000_000
_STATES = (nmt.INITIALISING, nmt.STOPPED, nmt.OPERATIONAL, nmt.PRE_OPERATIONAL)


class Memory:
    """Two banks of settings."""

    def __init__(self):
        self._banks = [bytearray(_BANK_SIZE), bytearray(_BANK_SIZE)]
        self.broken = False

    def read(self, bank):
        return self._banks[bank]

    def erase(self, bank):
        if self.broken:
            raise OSError(5)
        self._banks[bank][:] = b"\xff" * _BANK_SIZE

    def write(self, bank, offset, data):
        self._banks[bank][offset : offset + len(data)] = data


class Board:
    """Sums up the frames and the drive of the cell; now and then there is no room."""

    def __init__(self, chance):
        self.registers = array("i", [0] * speed_loop.REGISTERS)
        self.settings = Memory()
        self.serial = SERIAL
        self.inbox = Inbox()
        self.bus_off = False
        self.bits = 0
        self.current_ma = 0
        self.full = False
        self.sum = 0
        self.frames = 0
        self._chance = chance
        self._received = None

    # What interrupts call

    def sample(self, registers):
        registers[speed_loop.COUNT] = self._chance.below(64)
        registers[speed_loop.CURRENT] = self.current_ma

    def drive(self, registers):
        volts = (registers[speed_loop.VOLTAGE] >> 8) & 0xFFFF
        self.sum = binascii.crc32(bytes((volts & 0xFF, volts >> 8)), self.sum)

    def motors_off(self):
        pass

    def receive(self, can_id, data, flags):
        """A frame has come from the bus."""
        self._received = (can_id, data, flags)
        self.inbox.take(self)

    def recv(self, frame):
        """The received frame, as a CAN controller gives it."""
        if self._received is None:
            return None
        frame[0], data, frame[2] = self._received
        frame[1] = memoryview(data)
        self._received = None
        return frame

    # The calls of the background

    def service(self, now_ms):
        pass

    def show(self, now_ms, state, faulty):
        pass

    def feed(self):
        pass

    def presence(self):
        return self.bits

    def place(self):
        return 0

    def send(self, can_id, data):
        if self.full or self._chance.below(50) == 0:
            return False
        head = bytes((can_id & 0xFF, can_id >> 8, len(data)))
        self.sum = binascii.crc32(head + data, self.sum)
        self.frames += 1
        return True


def check(cell, registers):
    """Assert the conditions that hold after any frame."""
    assert cell.state in _STATES
    assert cell.node_id == cob.NODE_NONE or cob.NODE_MIN <= cell.node_id <= cob.NODE_MAX
    for base in (0, speed_loop.AXIS):
        if registers[base + speed_loop.MODE] == speed_loop.RUN:
            assert cell.state == nmt.OPERATIONAL
        if registers[base + speed_loop.MODE] == speed_loop.OFF:
            assert registers[base + speed_loop.VOLTAGE] == 0


class Bench:
    """A cell on a board, and the time."""

    def __init__(self, seed):
        self._chance = Chance(seed)
        self._frames = Frames(self._chance)
        self._now_ms = _MS_MASK - 1000
        self._count = 0
        self.board = Board(self._chance)
        self.power_up()

    def power_up(self):
        """The firmware starts anew."""
        board = self.board
        self.cell = Cell(board, NODE)
        self._runner = Runner(board, self.cell)
        self.pause(60)

    def replace(self):
        """Put in a new cell for a cell that has lost its node id, and would sleep on."""
        self.board.settings = Memory()
        self.power_up()

    def pause(self, duration_ms):
        """Let time pass with nothing on the bus."""
        for _ in range(0, duration_ms, _PAUSE_STEP_MS):
            self.pass_ms(_PAUSE_STEP_MS)

    def pass_ms(self, elapsed_ms=1):
        """Let the cell tick once, and the background turn once."""
        self._now_ms = (self._now_ms + elapsed_ms) & _MS_MASK
        self._runner.tick()
        # The last work of the background must show in this tick.
        check(self.cell, self.board.registers)
        self._runner.turn(self._now_ms)

    def live(self, frames):
        """Throw so many frames at the cell."""
        for _ in range(frames):
            self._step()
            if self._count % _FRAMES_PER_MS == 0:
                self._change_presence()
                self.pass_ms()
            self._count += 1
            cell = self.cell
            lost = cell.state == nmt.INITIALISING or cell.node_id != NODE
            if lost and self._count % _LOST_FRAMES == 0:
                self.replace()

    def _step(self):
        """The next frame, or whatever else happens."""
        can_id, data, flags = self._frames.draw()
        if can_id >= 0:
            self.board.receive(can_id, data, flags)
        elif can_id == fuzz_services.PAUSE:
            self.pause(data)
        elif can_id == fuzz_services.POWER:
            self.power_up()
        elif can_id == fuzz_services.BUS:
            self.board.bus_off = bool(data)
        elif can_id == fuzz_services.CURRENT:
            self.board.current_ma = data * _OVER_CURRENT_MA
        elif can_id == fuzz_services.MEMORY:
            self.board.settings.broken = bool(data)
        else:
            self.board.full = bool(data)

    def _change_presence(self):
        """Something may have come or gone."""
        if self._chance.below(4) == 0:
            self.board.bits = self._chance.below(32)


def fuzz(seed, frames, measure=None):
    """Let a cell live through so many frames; the sum and number of its replies.

    `measure()` is called now and then, when the garbage has been collected.
    """
    bench = Bench(seed)
    for start in range(0, frames, _SLICE):
        bench.live(min(_SLICE, frames - start))
        if measure is not None:
            gc.collect()
            measure()
    return bench.board.sum, bench.board.frames
