"""One cell as a MicroPython process, in lock step with the simulation; see `lockstep`.

Started as `micropython micropython_main.py NODE_ID SERIAL READ_FD WRITE_FD FLASH ADDRESS`, with the
file of the cell's flash ("-": none) and the address of the cell's block of memory.
"""

# mypy: ignore-errors

import gc
import os
import struct
import sys
from array import array

import lockstep
import uctypes
from lockstep import INBOX_SIZE, NOW_MS, PRESENCE, TAKEN, TICK
from virtual_board import VirtualBoard, VirtualFlash, leave_bus, rejoin_bus

from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop

AXES = 2
#: Garbage is collected after so many bytes. By itself MicroPython waits until its memory is full,
#: and as it looks for room from the bottom on, allocations become slow long before.
GARBAGE_MAX = 65536
#: So often the file of the flash is written, if the flash has changed [ms].
SAVE_MS = 1000


class Board(VirtualBoard):
    """A board whose registers lie where the simulation writes counts and currents into them."""

    def sample(self, registers):
        """Nothing is left to do."""

    def place(self):
        """See `VirtualBoard`."""
        return self.words[lockstep.PLACE]

    def blink(self, on):
        """Have the LEDs blink where the simulation sees it."""
        self.words[lockstep.BLINKING] = on


class FiledFlash(VirtualFlash):
    """A flash that begins with the content of a file ("-": none), and is saved there."""

    def __init__(self, path):
        super().__init__()
        self._path = path
        if path != "-":
            with open(path, "rb") as file:
                self.load(file)
        self._saved = self.changes

    def keep(self):
        """Write the file anew if the flash has changed; it is whole at any time."""
        if self.changes == self._saved:
            return
        self._saved = self.changes
        if self._path != "-":
            with open(self._path + ".new", "wb") as file:
                self.save(file)
            os.rename(self._path + ".new", self._path)


class ProcessNode:
    """A cell and its board, over the block at `address`."""

    def __init__(self, node_id, serial, flash, address):
        self._node_id = node_id
        self._serial = serial
        self.words = words_at(address, lockstep.WORDS)
        self._registers = words_at(address + lockstep.REGISTERS, speed_loop.REGISTERS)
        self._voltages_uv = words_at(address + lockstep.VOLTAGES_UV * lockstep.WORD, AXES)
        self._inbox = uctypes.bytearray_at(address + lockstep.INBOX, lockstep.INBOX_MAX)
        self._outbox = uctypes.bytearray_at(address + lockstep.OUTBOX, lockstep.OUTBOX_MAX)
        self._silent = []
        self.flash = flash
        self.start()

    def start(self):
        """Begin as at power-up, with what flash has; the supply is the simulation's."""
        supply_uv = self._registers[speed_loop.SUPPLY]
        self.board = Board(self._registers, self._serial, self.flash)
        self.board.voltages_uv = self._voltages_uv
        self.board.words = self.words
        self.board.motors_off()
        self.cell = Cell(self.board, self._node_id)
        self._registers[speed_loop.SUPPLY] = supply_uv

    def take_in(self, size):
        """Hand the frames in the inbox to the cell."""
        inbox = self._inbox
        at = 0
        while at < size:
            can_id = inbox[at] | inbox[at + 1] << 8
            end = at + lockstep.FRAME_HEAD_SIZE + inbox[at + 2]
            self._hand_over(can_id, bytes(inbox[at + lockstep.FRAME_HEAD_SIZE : end]))
            at = end

    def _hand_over(self, can_id, data):
        queued = len(self.board.frames)
        self.cell.on_frame(can_id, data, self.cell.now_ms)
        if can_id in self._silent and len(self.board.frames) > queued:
            raise RuntimeError("a frame that may have waited has been answered", can_id)

    def act(self, request):
        """Do what happens seldom."""
        if request == lockstep.RESTART:
            self._node_id = self.words[lockstep.NODE_ID]
            self.start()
        elif request == lockstep.LEAVE_BUS:
            leave_bus(self.cell, self.board)
        elif request == lockstep.REJOIN_BUS:
            rejoin_bus(self.cell, self.board)

    def report(self):
        """Write the queued frames into the outbox; returns its size."""
        board = self.board
        at = 0
        if board.identifiers is not None:
            self._silent = self.cell.silent()
            at = put_identifiers(self._outbox, at, lockstep.LISTENS, board.identifiers)
            at = put_identifiers(self._outbox, at, lockstep.SILENT, self._silent)
            board.identifiers = None
        for can_id, data in board.frames:
            at = put_frame(self._outbox, at, can_id, data)
        return at


def words_at(address, count):
    """Signed 32-bit numbers in memory, to be indexed."""
    return uctypes.struct(address, {"words": (0 | uctypes.ARRAY, count | uctypes.INT32)}).words


def put_identifiers(buffer, at, what, identifiers):
    """Write a list of identifiers at `at`; returns where it ends."""
    return put_frame(buffer, at, what, bytes(array("H", identifiers)))


def put_frame(buffer, at, can_id, data):
    """Write a frame at `at`; returns where it ends."""
    struct.pack_into("<HB", buffer, at, can_id, len(data))
    at += lockstep.FRAME_HEAD_SIZE
    buffer[at : at + len(data)] = data
    return at + len(data)


def serve(node, read, write):
    """Take turns until the other end closes its pipe."""
    words, board, cell = node.words, node.board, node.cell
    turn = bytearray(1)
    while read(turn):
        request = turn[0]
        if request & TAKEN:
            request &= ~TAKEN
            board.frames.clear()
        if words[INBOX_SIZE]:
            node.take_in(words[INBOX_SIZE])
            words[INBOX_SIZE] = 0
        if request == TICK:
            board.presence_bits = words[PRESENCE]
            cell.tick()
            cell.poll(words[NOW_MS])
            if words[NOW_MS] % SAVE_MS == 0:
                node.flash.keep()
            if board.restarting:
                node.start()
                board, cell = node.board, node.cell
                cell.poll(words[NOW_MS])
        elif request:
            node.act(request)
            board, cell = node.board, node.cell
        turn[0] = 0
        if board.frames or board.identifiers is not None:
            turn[0] = 1
            words[lockstep.OUTBOX_SIZE] = node.report()
        write(turn)
    node.flash.keep()


flash = FiledFlash(sys.argv.pop(5))
node_id, serial, read_fd, write_fd, address = [int(argument) for argument in sys.argv[1:]]
requests = open(read_fd, "rb")  # noqa: SIM115 - open as long as the process lives
answers = open(write_fd, "wb")  # noqa: SIM115
node = ProcessNode(node_id, serial, flash, address)
gc.collect()
gc.threshold(GARBAGE_MAX)
serve(node, requests.readinto, answers.write)
