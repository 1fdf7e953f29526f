"""Measures a cell on whatever interpreter runs this; prints `name value` lines."""

import gc
import sys
import time
from array import array

from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop
from mdms_protocol import pdo
from mdms_protocol.codecs import cob

NODE = 5
START_MS = 3000


class Board:
    """Takes frames and throws them away."""

    def __init__(self):
        self.registers = array("i", [0] * speed_loop.REGISTERS)
        self.sent = 0

    def sample(self, registers):
        registers[speed_loop.COUNT] = registers[speed_loop.COUNT] + 2 & 0xFFFF

    def drive(self, registers):
        pass

    def presence(self):
        return 0

    def place(self):
        return 0

    def send(self, can_id, data):
        self.sent += 1
        return True

    def motors_off(self):
        pass


def now_us():
    """A clock in microseconds."""
    return time.ticks_us() if hasattr(time, "ticks_us") else time.perf_counter() * 1e6


def per_call(count, function, *arguments):
    """Microseconds a call, the best of five rounds."""
    best = 1e9
    for _ in range(5):
        start = now_us()
        for _ in range(count):
            function(*arguments)
        best = min(best, (now_us() - start) / count)
    return best


def driving():
    """A cell that is booted, operational and enabled."""
    board = Board()
    cell = Cell(board, NODE)
    now_ms = 0
    while not (board.sent and cell.state != 0) and now_ms < START_MS:
        cell.poll(now_ms)
        now_ms += 1
    cell.on_frame(cob.NMT, bytes((1, NODE)), cell.now_ms)
    for word in (0x06, 0x07, 0x0F):
        cell.on_frame(0x300 + NODE, bytes((word, 0, word, 0)), cell.now_ms)
    return cell, board, now_ms


def cycle(cell, target, now_ms):
    """A SYNC period as the cell sees it: target, SYNC with its answer, ten ticks and polls."""
    cell.on_frame(0x200 + NODE, target, cell.now_ms)
    cell.on_frame(cob.SYNC, b"", cell.now_ms)
    for ms in range(now_ms, now_ms + 10):
        cell.tick()
        cell.poll(ms)


def allocated(function, *arguments):
    """Bytes of heap that a call takes, with nothing given back."""
    gc.collect()
    gc.disable()
    before = gc.mem_alloc()
    function(*arguments)
    taken = gc.mem_alloc() - before
    gc.enable()
    return taken


def main():
    """Print everything."""
    cell, board, now_ms = driving()
    target = pdo.TARGET_VELOCITY.encode((100_000, -100_000))
    print("step_us", per_call(3000, speed_loop.step, board.registers))
    print("tick_us", per_call(3000, cell.tick))
    print("frame_us", per_call(3000, cell.on_frame, 0x200 + NODE, target, 0))
    print("sync_us", per_call(3000, cell.on_frame, cob.SYNC, b"", 0))
    print("poll_us", per_call(3000, cell.poll, now_ms))
    print("cycle_us", per_call(500, cycle, cell, target, now_ms))
    print("cycle_sends", board.sent > 0)
    if hasattr(gc, "mem_alloc"):
        cycle(cell, target, now_ms)
        print("cycle_bytes", allocated(cycle, cell, target, now_ms + 10))
        print("tick_bytes", allocated(cell.tick))


if __name__ == "__main__":
    main()
    sys.exit(0)
