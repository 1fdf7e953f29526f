"""One cell as a MicroPython process, in lock step with the simulation over two pipes.

Started as `micropython micropython_main.py NODE_ID SERIAL READ_FD WRITE_FD`. Every request is
answered by one reply; what they look like stands in `mdms_sim.nodes.lockstep`.
"""

# mypy: ignore-errors

import struct
import sys
from array import array

from virtual_board import VirtualBoard, VirtualFlash, leave_bus, rejoin_bus

from mdms_cell import speed_loop
from mdms_cell.cell import Cell

TICK, RESTART, LEAVE_BUS, REJOIN_BUS = range(1, 5)
LISTEN = 0xFFFF
REQUEST_FRAMES_MAX = 4096
SIZE, WHAT, PRESENCE, COUNT1, COUNT2, CURRENT1, CURRENT2, NOW_MS, HEAD = range(9)
REPLY = "<Hii"
REPLY_SIZE = 10
FRAME_HEAD_SIZE = 3


class Node:
    """A cell and its board."""

    def __init__(self, node_id, serial):
        self._node_id = node_id
        self._serial = serial
        self._flash = VirtualFlash()
        self._start()

    def _start(self):
        registers = array("i", bytes(4 * speed_loop.REGISTERS))
        self.board = VirtualBoard(registers, self._serial, self._flash)
        self.cell = Cell(self.board, self._node_id)

    def deliver(self, view, size):
        """Hand the frames in the first `size` bytes of `view` to the cell."""
        at = 0
        while at < size:
            can_id = view[at] | view[at + 1] << 8
            end = at + FRAME_HEAD_SIZE + view[at + 2]
            self.cell.on_frame(can_id, bytes(view[at + FRAME_HEAD_SIZE : end]))
            at = end

    def tick(self, head):
        """One control period and the timers."""
        board = self.board
        board.presence_bits = head[PRESENCE]
        board.counts[0] = head[COUNT1]
        board.counts[1] = head[COUNT2]
        board.currents_ma[0] = head[CURRENT1]
        board.currents_ma[1] = head[CURRENT2]
        self.cell.tick()
        self.cell.poll(head[NOW_MS])

    def act(self, what, node_id):
        """Do what happens seldom."""
        if what == RESTART:
            self._node_id = node_id
            self._start()
        elif what == LEAVE_BUS:
            leave_bus(self.cell, self.board)
        elif what == REJOIN_BUS:
            rejoin_bus(self.cell, self.board)

    def reply(self, buffer):
        """Write voltages and queued frames into `buffer`; returns the size."""
        board = self.board
        at = REPLY_SIZE
        if board.identifiers is not None:
            listen = bytes(array("H", board.identifiers))
            at = put_frame(buffer, at, LISTEN, listen)
            board.identifiers = None
        for can_id, data in board.frames:
            at = put_frame(buffer, at, can_id, data)
        board.frames.clear()
        struct.pack_into(REPLY, buffer, 0, at, board.voltages_uv[0], board.voltages_uv[1])
        return at


def put_frame(buffer, at, can_id, data):
    """Write a frame at `at`; returns where it ends."""
    struct.pack_into("<HB", buffer, at, can_id, len(data))
    at += FRAME_HEAD_SIZE
    buffer[at : at + len(data)] = data
    return at + len(data)


def serve(node, requests, replies):
    """Answer until the other end closes its pipe."""
    head = array("i", range(HEAD))
    body = bytearray(REQUEST_FRAMES_MAX)
    view = memoryview(body)
    out = bytearray(4096)
    while requests.readinto(head):
        if head[SIZE]:
            requests.readinto(body, head[SIZE])
            node.deliver(view, head[SIZE])
        if head[WHAT] == TICK:
            node.tick(head)
        elif head[WHAT]:
            node.act(head[WHAT], head[COUNT1])
        replies.write(out, node.reply(out))


requests = open(int(sys.argv[3]), "rb")  # noqa: SIM115 - open as long as the process lives
replies = open(int(sys.argv[4]), "wb")  # noqa: SIM115
serve(Node(int(sys.argv[1]), int(sys.argv[2])), requests, replies)
