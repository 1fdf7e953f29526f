"""Measures a beat of the neighbour layer on whatever interpreter runs this; prints `name value`.

Frames go the way that they go on a board: the interrupt puts them into the inbox, and turns of the
background loop take them. With a number of beats as its argument it replays those and no more, for
who counts instructions; with `apart` behind it the stand-ins for controller and board work alone.
"""

import gc
import sys
import time

from layer_bench import Middle

from mdms_cell.queues import Inbox
from mdms_cell.runner import Runner
from mdms_protocol.codecs import cob
from mdms_protocol.neighbours import frames as wire

BEATS = 60
ROUNDS = 5
#: Frames a beat that the filters of a bxCAN let through, and the cell drops; see `filters`.
DROPPED = 5
_NOT_LISTENED_TO = cob.TPDO_BASES[0] + 60


class Recorded:
    """A cell whose frames are noted by the turn of the loop in which it takes them."""

    def __init__(self, cell):
        self.turns = []
        self._frames = []
        self._cell = cell
        self._registers = cell._registers

    def on_frame(self, can_id, data, now_ms):
        self._frames.append((can_id, data))
        self._cell.on_frame(can_id, data, now_ms)

    def poll(self, now_ms):
        self.turns.append((now_ms, self._frames))
        self._frames = []
        self._cell.poll(now_ms)


class Controller:
    """Gives frames that were recorded, as `machine.CAN` does."""

    def recv(self, into):
        into[0], into[1] = next(self.frames)
        return into


class Loop:
    """The background loop of a cell in the middle, on a board without peripherals."""

    def __init__(self):
        middle = Middle()
        self.cell, self._board = middle.cell, middle.board
        self._can = Controller()
        self._board.inbox = Inbox(registers=self._board.registers)
        self._board.bus_off = False
        self._board.service = self._board.feed = self._board.show = lambda *_: None
        self._board.send = lambda _can_id, _data: True
        self._runner = Runner(self._board, self.cell)

    def replay(self, turns):
        can, inbox, runner = self._can, self._board.inbox, self._runner
        for now_ms, frames in turns:
            can.frames = iter(frames)
            for _ in frames:
                inbox.take(can)
            runner.turn(now_ms)

    def replay_apart(self, turns):
        """The stand-ins' own part: the controller gives its frames, and nobody is called."""
        can, into = self._can, [0, b"", 0, 0]
        for _, frames in turns:
            can.frames = iter(frames)
            for _ in frames:
                can.recv(into)


def now_us():
    """A clock in microseconds."""
    return time.ticks_us() if hasattr(time, "ticks_us") else time.perf_counter() * 1e6


def recorded(beats):
    """The turns of some beats in which the cell leads its wheels."""
    middle = Middle()
    middle.cell = Recorded(middle.cell)
    first = []
    for _ in range(beats):
        first.append(len(middle.cell.turns))
        middle.beat()
    turns = middle.cell.turns
    for number in first:
        turns[number][1].extend([(_NOT_LISTENED_TO, bytes(8))] * DROPPED)
    return turns


def beat_us(turns, replay=Loop.replay):
    """All turns of a beat, the best of some rounds."""
    best = 1e9
    for _ in range(ROUNDS):
        loop = Loop()
        gc.collect()
        start = now_us()
        replay(loop, turns)
        best = min(best, (now_us() - start) / BEATS)
    return best


def layer_bytes():
    """Bytes of the heap for the layer's data; 0 on CPython, which gives no figure."""
    if not hasattr(gc, "mem_alloc"):
        return 0
    from mdms_cell.neighbour_layer import Layer

    cell = Middle().cell
    gc.collect()
    before = gc.mem_alloc()
    layer = Layer(
        cell._objects,
        cell._registers,
        axes=cell._axes,
        pdos=cell._pdos,
        consumer=cell._consumer,
        emcy=cell._emcy,
        now=cell._now,
        wake=cell._wake,
        changed=cell._listen,
    )
    # As if all pages of all programs had come.
    for program in layer._pages.programs._slots:
        program.pages = [[0] * wire.PROGRAM_FIELDS for _ in program.pages]
    gc.collect()
    return gc.mem_alloc() - before


def main(arguments):
    turns = recorded(BEATS)
    if arguments:
        loop = Loop()
        replay = loop.replay_apart if arguments[1:] else loop.replay
        replay(turns[: int(arguments[0]) * len(turns) // BEATS])
    else:
        print("layer_bytes", layer_bytes())
        print("beat_us", beat_us(turns))
        print("apart_us", beat_us(turns, Loop.replay_apart))


if __name__ == "__main__":
    main(sys.argv[1:])
