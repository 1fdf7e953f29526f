"""Throws seeded frames at a cell and sums up what it replies; the sum is the same everywhere.

Frames are drawn at random, or from valid ones with some bytes or the length changed. Every so many
frames a millisecond passes, or 50 at boot, in which the cell ticks and is polled.
"""

import binascii
import gc
from array import array

from mdms_cell import speed_loop
from mdms_cell.cell import Cell
from mdms_protocol import cob, nmt

NODE = 5
_FRAMES_PER_MS = 4

#: Identifiers worth more than chance gives them.
_IDENTIFIERS = (
    0x000,
    0x080,
    0x100,
    0x185,
    0x205,
    0x305,
    0x405,
    0x505,
    0x605,
    0x605,
    0x605,
    0x77F,
    0x7E5,
)
_VALID = (
    (0x000, b"\x01\x05"),
    (0x000, b"\x80\x00"),
    (0x000, b"\x81\x05"),
    (0x000, b"\x82\x00"),
    (0x080, b""),
    (0x080, b""),
    (0x080, b""),
    (0x000, b"\x01\x00"),
    (0x000, b"\x01\x00"),
    (0x205, b"\x0c\xf8\x00\x00\xf4\x07\xff\xff"),
    (0x205, b"\x00\x10\x00\x00\x00\x20\x00\x00"),
    (0x305, b"\x06\x00\x06\x00"),
    (0x305, b"\x06\x00\x06\x00"),
    (0x305, b"\x0f\x00\x0f\x00"),
    (0x305, b"\x0f\x00\x0f\x00"),
    (0x305, b"\x80\x00\x80\x00"),
    (0x605, b"\x40\x41\x60\x00\0\0\0\0"),
    (0x605, b"\x40\x09\x10\x00\0\0\0\0"),
    (0x605, b"\x60\0\0\0\0\0\0\0"),
    (0x605, b"\x70\0\0\0\0\0\0\0"),
    (0x605, b"\x2b\x17\x10\x00\x05\x00\0\0"),
    (0x605, b"\x2b\x00\x30\x00\x64\x00\0\0"),
    (0x605, b"\x2f\x00\x1a\x00\0\0\0\0"),
    (0x605, b"\x23\x00\x18\x01\x85\x01\0\x80"),
    (0x605, b"\x23\x00\x18\x01\x85\x01\0\0"),
    (0x605, b"\x2f\x00\x18\x02\xff\0\0\0"),
    (0x605, b"\x23\x00\x1a\x01\x08\0\x01\x30"),
    (0x605, b"\x2f\x00\x1a\x00\x01\0\0\0"),
    (0x605, b"\x2f\x00\x16\x00\0\0\0\0"),
    (0x605, b"\x23\x02\x14\x01\x86\x01\0\0"),
    (0x605, b"\x23\x16\x10\x01\x20\0\x7f\0"),
    (0x605, b"\x23\x10\x10\x01save"),
    (0x605, b"\x23\x11\x10\x01load"),
    (0x605, b"\x23\x00\x20\x00\0\x01\0\0"),
    (0x605, b"\x23\xff\x60\x00\x40\x42\x0f\0"),
    (0x605, b"\x21\x50\x1f\x01\x40\0\0\0"),
    (0x605, b"\x20\x00\x30\x00\0\0\0\0"),
    (0x605, b"\x01abcdefg"),
    (0x605, b"\xc6\x50\x1f\x01\x0e\0\0\0"),
    (0x605, b"\x01abcdefg"),
    (0x605, b"\x82abcdefg"),
    (0x605, b"\xc1\x8f\x0b\0\0\0\0\0"),
    (0x605, b"\xa4\x09\x10\x00\x7f\0\0\0"),
    (0x605, b"\xa3\0\0\0\0\0\0\0"),
    (0x605, b"\xa2\x03\x7f\0\0\0\0\0"),
    (0x605, b"\xa1\0\0\0\0\0\0\0"),
    (0x77F, b"\x05"),
    (0x7E5, b"\x04\x01\0\0\0\0\0\0"),
    (0x7E5, b"\x11\x05\0\0\0\0\0\0"),
    (0x7E5, b"\x17\0\0\0\0\0\0\0"),
    (0x7E5, b"\x04\x00\0\0\0\0\0\0"),
    (0x7E5, b"\x51\0\0\0\0\x80\0\0"),
)
_STATES = (nmt.INITIALISING, nmt.STOPPED, nmt.OPERATIONAL, nmt.PRE_OPERATIONAL)


class Chance:
    """Pseudo-random numbers that need no more than 31 bits (Lehmer, modulus 65537, two streams)."""

    def __init__(self, seed):
        self._first = seed % 65536 + 1
        self._second = seed // 65536 % 65536 + 7

    def below(self, limit):
        """A number from 0 to limit - 1, limit at most 2048."""
        self._first = self._first * 75 % 65537
        self._second = self._second * 74 % 65537
        return ((self._first ^ self._second) >> 3) % limit


class Memory:
    """Two banks of settings."""

    def __init__(self):
        self._banks = [bytearray(1024), bytearray(1024)]

    def read(self, bank):
        return self._banks[bank]

    def erase(self, bank):
        self._banks[bank][:] = b"\xff" * 1024

    def write(self, bank, offset, data):
        self._banks[bank][offset : offset + len(data)] = data


class Program:
    """A place for a program."""

    def begin(self, size):
        pass

    def write(self, data):
        pass

    def end(self):
        pass


class Board:
    """Sums up what the cell sends and how it drives; now and then there is no room."""

    def __init__(self, chance):
        self.registers = array("i", [0] * speed_loop.REGISTERS)
        self.settings = Memory()
        self.program = Program()
        self.serial = 0x1234
        self.bits = 0
        self.sum = 0
        self.frames = 0
        self._chance = chance

    def sample(self, registers):
        registers[speed_loop.COUNT] = self._chance.below(64)

    def drive(self, registers):
        volts = (registers[speed_loop.VOLTAGE] >> 8) & 0xFFFF
        self.sum = binascii.crc32(bytes((volts & 0xFF, volts >> 8)), self.sum)

    def presence(self):
        return self.bits

    def send(self, can_id, data):
        if self._chance.below(50) == 0:
            return False
        head = bytes((can_id & 0xFF, can_id >> 8, len(data)))
        self.sum = binascii.crc32(head + data, self.sum)
        self.frames += 1
        return True

    def motors_off(self):
        pass


def draw(chance):
    """An identifier and data."""
    kind = chance.below(8)
    if kind == 0:
        can_id = chance.below(2048)
        return can_id, bytes([chance.below(256) for _ in range(chance.below(9))])
    if kind == 1:
        can_id = _IDENTIFIERS[chance.below(len(_IDENTIFIERS))]
        return can_id, bytes([chance.below(256) for _ in range(chance.below(9))])
    can_id, data = _VALID[chance.below(len(_VALID))]
    if kind == 2:
        data = data[: chance.below(9)]
    elif kind == 3 and data:
        changed = bytearray(data)
        changed[chance.below(len(data))] = chance.below(256)
        data = bytes(changed)
    return can_id, data


def check(cell, board):
    """What must hold whatever came."""
    assert cell.state in _STATES
    assert cell.node_id == cob.NODE_NONE or cob.NODE_MIN <= cell.node_id <= cob.NODE_MAX
    registers = board.registers
    for base in (0, speed_loop.AXIS):
        if registers[base + speed_loop.MODE] == speed_loop.RUN:
            assert cell.state != nmt.INITIALISING
        if registers[base + speed_loop.MODE] == speed_loop.OFF:
            assert registers[base + speed_loop.VOLTAGE] == 0


def power_up(board, now_ms):
    """A cell that has claimed its node id; what it had saved is lost."""
    board.settings = Memory()
    cell = Cell(board, NODE)
    for elapsed_ms in range(0, 60, 10):
        cell.poll((now_ms + elapsed_ms) & ((1 << 30) - 1))
    return cell


def fuzz(seed, frames, measure=None):
    """Let a cell live through so many frames; the sum and number of its replies.

    `measure()` is called now and then, when the garbage has been collected.
    """
    chance = Chance(seed)
    board = Board(chance)
    now_ms = (1 << 30) - 1000
    cell = power_up(board, now_ms)
    for number in range(frames):
        cell.on_frame(*draw(chance))
        if number % _FRAMES_PER_MS == 0:
            elapsed_ms = 50 if cell.state == nmt.INITIALISING else 1
            now_ms = (now_ms + elapsed_ms) & ((1 << 30) - 1)
            board.bits = chance.below(32)
            cell.tick()
            cell.poll(now_ms)
            check(cell, board)
        if measure is not None and number % 10_000 == 9_999:
            gc.collect()
            measure()
        if number % 500 == 499 and cell.state == nmt.INITIALISING:
            # A cell that has lost its node id to a rival would sleep through the rest.
            cell = power_up(board, now_ms)
    return board.sum, board.frames
