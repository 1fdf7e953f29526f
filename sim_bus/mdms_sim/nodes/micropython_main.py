"""One cell as a MicroPython process, in lock step with the simulation over two pipes.

Started as `micropython micropython_main.py NODE_ID READ_FD WRITE_FD`. Every request is answered by
one reply; the layouts are those of `mdms_sim.nodes.lockstep`.
"""

# mypy: ignore-errors

import struct
import sys
from array import array

from virtual_board import VirtualBoard

from mdms_cell import speed_loop
from mdms_cell.cell import Cell

REQUEST = "<HBBiiI"
REQUEST_SIZE = 16
REPLY = "<Hii"
REPLY_SIZE = 10
FRAME_HEAD_SIZE = 3


def deliver(cell: Cell, view: memoryview, size: int) -> None:
    """Hand the frames in the first `size` bytes of `view` to the cell."""
    at = 0
    while at < size:
        can_id = view[at] | view[at + 1] << 8
        end = at + FRAME_HEAD_SIZE + view[at + 2]
        cell.on_frame(can_id, bytes(view[at + FRAME_HEAD_SIZE : end]))
        at = end


def reply(board: VirtualBoard, buffer: bytearray) -> int:
    """Write voltages and queued frames into `buffer`; returns the size."""
    at = REPLY_SIZE
    for can_id, data in board.frames:
        buffer[at] = can_id & 0xFF
        buffer[at + 1] = can_id >> 8
        buffer[at + 2] = len(data)
        at += FRAME_HEAD_SIZE
        buffer[at : at + len(data)] = data
        at += len(data)
    board.frames.clear()
    struct.pack_into(REPLY, buffer, 0, at, board.voltages_uv[0], board.voltages_uv[1])
    return at


def main(node_id: int, requests, replies):
    """Serve until the other end closes its pipe."""
    board = VirtualBoard(array("i", bytes(4 * speed_loop.REGISTERS)))
    cell = Cell(board, node_id)
    head = bytearray(REQUEST_SIZE)
    body = bytearray(1 << 16)
    view = memoryview(body)
    out = bytearray(4096)
    while requests.readinto(head):
        size, tick, presence, count1, count2, now_ms = struct.unpack(REQUEST, head)
        if size:
            requests.readinto(body, size)
            deliver(cell, view, size)
        if tick:
            board.counts[0] = count1
            board.counts[1] = count2
            board.presence_bits = presence
            cell.tick()
            cell.poll(now_ms)
        replies.write(out, reply(board, out))


requests = open(int(sys.argv[2]), "rb")  # noqa: SIM115 - open as long as the process lives
replies = open(int(sys.argv[3]), "wb")  # noqa: SIM115
main(int(sys.argv[1]), requests, replies)
