"""The heap that all takes that is flashed, on the 32-bit MicroPython and faked peripherals."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from tests.firmware.images import flashed
from tests.micropython_builds import wasm32

HEAP = Path(__file__).parent / "_firmware_heap.py"
#: What the interpreter itself has taken.
_BARE = "import gc; print(gc.mem_alloc())"
#: What measures, and the peripherals, do not count.
_MEASURE = """
import gc
def note():
    gc.collect()
    return gc.mem_alloc()
import machine, pyb, world
from _firmware_heap import Driven, Traffic
before = note()
def load():
    __import__("mdms")
load()
code = note()
import started
booted = note()
traffic = Traffic(Driven(world, started.runner))
traffic.boot()
world.told.clear()
running = note()
cycles = %d
while cycles > 0:
    note()
    traffic.live(min(cycles, 400))
    cycles -= 400
print(code - before, booted - before, running - before, note() - before, started.cell.state)
"""
OPERATIONAL = 5


@dataclass(frozen=True, slots=True)
class FlashedHeap:
    """Bytes in use: code alone, with the cell made, operational, and after traffic.

    All but `code` have in them what the interpreter takes.
    """

    code: int
    made: int
    booted: int
    lived: int


def flashed_heap(folder: Path, cycles: int) -> FlashedHeap:
    """Start what is flashed as `main` does, boot it, and let so many SYNC periods pass."""
    flashed(folder, None)
    shutil.copy(HEAP, folder)
    printed = wasm32(folder, _MEASURE % cycles, time_limit_s=600)
    code, made, booted, lived, state = map(int, printed.split())
    assert state == OPERATIONAL
    bare = int(wasm32(folder, _BARE))
    return FlashedHeap(code, *(bare + each for each in (made, booted, lived)))
