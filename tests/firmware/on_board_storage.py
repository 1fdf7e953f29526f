"""When flash is written, with a model of the cache before it; runs on MicroPython."""

import os

import world
from bench import NODE, Bench

from boards import flash
from mdms_protocol import cia402, pdo


class Storage:
    """MicroPython's cache of a sector of flash, which stops the processor at its own times.

    A sector that was touched is erased within 256 ms, and written 5 s after it was touched last or
    when a file is closed, removed or renamed. `stops` counts all of that; none may happen while a
    bridge is awake. A file that is left open is closed by a garbage collection, whenever that is.
    """

    def __init__(self, bench):
        self._bench = bench
        self._erased = False
        self._touched_ms = None
        self.stops = 0
        self.left_open = 0
        self.stat = os.stat

    @property
    def dirty(self):
        return self._touched_ms is not None or self.left_open > 0

    def _stop(self):
        assert not world.levels[self._bench.wake], "a bridge is awake while flash is written"
        self.stops += 1

    def touch(self):
        self._touched_ms = world.now_ms

    def force(self):
        if self._touched_ms is not None:
            self._stop()
        self._touched_ms = None
        self._erased = False

    def pass_ms(self, count=1):
        for _ in range(count):
            self._bench.pass_ms()
            if self._touched_ms is None:
                continue
            if not self._erased and world.now_ms % 256 == 0:
                self._erased = True
                self._stop()
            if world.now_ms - self._touched_ms >= 5000:
                self.force()

    def remove(self, path):
        os.remove(path)
        self.touch()
        self.force()

    def rename(self, old, new):
        os.rename(old, new)
        self.touch()
        self.force()

    def open(self, path, mode):
        return CachedFile(self, path, mode) if mode != "rb" else open(path, mode)


class CachedFile:
    """A file that is written into the cache."""

    def __init__(self, storage, path, mode):
        self._storage = storage
        self._file = open(path, mode)  # noqa: SIM115 - what is tested closes it
        storage.left_open += 1
        storage.touch()

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self.close()

    def write(self, data):
        self._storage.touch()
        return self._file.write(data)

    def close(self):
        self._file.close()
        self._storage.left_open -= 1
        self._storage.force()


def cached(bench):
    """The board on storage as a real one has it, operational; nothing waits to be written."""
    bench.boot()
    bench.can.deliver(0x000, bytes((1, NODE)))
    bench.pass_ms(2)
    storage = Storage(bench)
    flash.os, flash.open = storage, storage.open
    return storage


def ask(bench, storage, *requests):
    for request in requests:
        bench.can.deliver(0x600 + NODE, request)
        storage.pass_ms(3)


def enable(bench, storage):
    """All that it takes to enable both axes, and targets for a while; what was sent meanwhile."""
    for word in (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION):
        bench.can.deliver(0x300 + NODE, pdo.CONTROLWORD.encode((word, word)))
        storage.pass_ms(2)
    sent = list(world.sent)
    keep(bench, storage, 20)
    return sent


def keep(bench, storage, ms):
    """Stream targets, and turn the wheels accordingly."""
    for _ in range(ms):
        for encoder, step in zip(bench.encoders, (4, -4)):  # noqa: B905 - MicroPython has no strict
            world.counts[encoder] = world.counts.get(encoder, 0) + step
        bench.target(100_000)
        storage.pass_ms()
        world.sent.clear()


def test_settings_are_stored_right_after_the_motors_were_on_with_the_bridges_asleep(bench):
    storage = cached(bench)
    enable(bench, storage)
    for _ in range(50):  # the wheels come to stand
        bench.target(100_000)
        storage.pass_ms()
    assert world.levels[bench.wake]
    world.told.clear()
    # Both frames lie in the inbox before the next turn, and no tick comes in between.
    bench.can.deliver(0x300 + NODE, pdo.CONTROLWORD.encode((0, 0)))
    bench.can.deliver(0x600 + NODE, b"\x23\x10\x10\x01save")
    bench.runner.turn(world.now_ms)
    assert storage.stops
    assert not storage.dirty
    assert world.told == [("watchdog", 5000)]
    storage.pass_ms(3)
    assert (0x580 + NODE, b"\x60\x10\x10\x01\0\0\0\0") in world.sent
    flash.os, flash.open = os, open


def test_node_id_is_not_stored_while_motors_are_on(bench):
    storage = cached(bench)
    enable(bench, storage)
    bench.can.deliver(0x7E5, b"\x04\x01\0\0\0\0\0\0")
    bench.can.deliver(0x7E5, b"\x17\0\0\0\0\0\0\0")
    bench.pass_ms(3)
    assert (0x7E4, b"\x17\x02\0\0\0\0\0\0") in world.sent
    assert not storage.dirty
    assert not bench.off()
    flash.os, flash.open = os, open


def run(board, name):
    globals()[name](Bench(board))
    print("done")
