"""A garbage collection between any two steps of the background; runs on MicroPython.

While it lasts, 11 ms, the interrupts go on: 11 ticks, and five frames for the cell a millisecond.
"""

import gc

import world
from bench import NODE, Bench

from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop as s
from mdms_cell.runner import FRAMES_PER_TURN, Runner
from mdms_protocol import pdo

PAUSE_MS = 11
FRAMES_PER_MS = 5


class Pausing:
    """Another object, with a step of the background before everything that is asked of it.

    Its functions have one before each of their calls too, for who holds on to them.
    """

    def __init__(self, target, step):
        self._target = target
        self._step = step

    def __getattr__(self, name):
        self._step()
        return self._pausing(getattr(self._target, name))

    def _pausing(self, found):
        if not callable(found):
            return found

        def call(*arguments):
            self._step()
            return self._pausing(found(*arguments))

        return call


class Background:
    """Counts the steps of a turn, and pauses at one of them."""

    def __init__(self, bench):
        self.bench = bench
        self.steps = 0
        self.pause_at = None
        self.interrupt = False
        self.delivered = 0

    def step(self):
        if self.interrupt:
            return
        self.steps += 1
        if self.steps == self.pause_at:
            self.pause()

    def pause(self):
        self.interrupt = True
        gc.collect()
        for _ in range(PAUSE_MS):
            for _ in range(FRAMES_PER_MS):
                data = pdo.TARGET_VELOCITY.encode((self.delivered, -self.delivered))
                assert self.bench.can.deliver(0x200 + NODE, data)
                self.delivered += 1
            self.tick()
        self.interrupt = False

    def tick(self):
        interrupt, self.interrupt = self.interrupt, True
        world.advance()
        self.interrupt = interrupt


def boot(bench, background):
    """Boot a cell whose board, inbox and self are passed through the steps of the background."""
    step = background.step
    bench.board.inbox = Pausing(bench.board.inbox, step)
    board = Pausing(bench.board, step)
    bench.cell = Cell(board, NODE)
    bench.runner = Runner(board, Pausing(bench.cell, step))
    bench.board.start(lambda _timer: bench.cell.tick())
    while (0x700 + NODE, b"\x00") not in world.sent:
        bench.pass_ms()
    bench.drive(100_000)
    bench.pass_ms(20)


def turn(bench, background, pause_at):
    """One millisecond in which the cell has much to do, with a pause at a step or none."""
    background.tick()
    background.interrupt = True
    bench.target(100_000)
    bench.can.deliver(0x600 + NODE, b"\x40\x00\x10\x00\x00\x00\x00\x00")
    background.interrupt = False
    background.delivered += 3
    background.steps = 0
    background.pause_at = pause_at
    bench.runner.turn(world.now_ms)
    background.pause_at = None
    # Turns follow each other at once, and each takes a share of the waiting frames.
    background.interrupt = True
    for _ in range(PAUSE_MS * FRAMES_PER_MS // FRAMES_PER_TURN):
        bench.runner.turn(world.now_ms)
    background.interrupt = False


def run():
    bench = Bench("pybv11")
    background = Background(bench)
    boot(bench, background)
    turn(bench, background, None)
    places = background.steps
    first_ms = world.now_ms
    first_tick = bench.board.registers[s.TICKS]
    received = bench.cell.received
    background.delivered = 0
    for place in range(1, places + 1):
        turn(bench, background, place)
        turn(bench, background, None)
        assert bench.cell.received - received == background.delivered, place
    assert background.delivered == places * (PAUSE_MS * FRAMES_PER_MS + 6)
    assert bench.board.registers[s.TICKS] - first_tick == world.now_ms - first_ms
    assert world.now_ms - first_ms == places * (PAUSE_MS + 2)
    assert bench.board.inbox.lost == 0
    print("places", places)
