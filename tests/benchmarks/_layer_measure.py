"""Measures a beat of the neighbour layer on whatever interpreter runs this; prints `name value`."""

import gc
import time

from layer_bench import Middle

BEATS = 100
ROUNDS = 5


class Recorded:
    """A cell whose calls are noted, so that only they are timed."""

    def __init__(self, cell):
        self.calls = []
        self._cell = cell
        self._registers = cell._registers

    def on_frame(self, can_id, data, now_ms):
        self.calls.append((can_id, data, now_ms))
        self._cell.on_frame(can_id, data, now_ms)

    def poll(self, now_ms):
        self.calls.append((now_ms,))
        self._cell.poll(now_ms)


def now_us():
    """A clock in microseconds."""
    return time.ticks_us() if hasattr(time, "ticks_us") else time.perf_counter() * 1e6


def recorded():
    """The calls of some beats in which the cell leads its wheels."""
    middle = Middle()
    middle.cell = Recorded(middle.cell)
    for _ in range(BEATS):
        middle.beat()
    return middle.cell.calls


def beat_us(calls):
    """Frames and update of a beat, the best of some rounds."""
    best = 1e9
    for _ in range(ROUNDS):
        cell = Middle().cell
        gc.collect()
        start = now_us()
        for call in calls:
            if len(call) == 1:
                cell.poll(call[0])
            else:
                cell.on_frame(*call)
        best = min(best, (now_us() - start) / BEATS)
    return best


def layer_bytes():
    """What the layer's data take of the heap; 0 on CPython, which does not say."""
    if not hasattr(gc, "mem_alloc"):
        return 0
    from mdms_cell.neighbours.layer import Layer

    cell = Middle().cell
    gc.collect()
    before = gc.mem_alloc()
    kept = Layer(
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
    gc.collect()
    after = gc.mem_alloc()
    assert kept is not None
    return after - before


print("layer_bytes", layer_bytes())
print("beat_us", beat_us(recorded()))
