"""The heap that all takes that is flashed, on the 32-bit MicroPython and faked peripherals."""

import re
from dataclasses import dataclass
from pathlib import Path
from string import ascii_uppercase

from tests.firmware.images import FAKES, flashed
from tests.micropython_builds import wasm32

from mdms_image.compiler import compile_source

HEAP = Path(__file__).parent / "_firmware_heap.py"
#: What the interpreter itself has taken.
_BARE = "import gc; print(gc.mem_alloc())"
#: What measures, and the peripherals, do not count.
_MEASURE = """
import gc
def note():
    gc.collect()
    return gc.mem_alloc()
def load(name):
    __import__(name)
load("pyb")
load("machine")
load("_firmware_heap")
import world
from _firmware_heap import Driven, Traffic
before = note()
load("mdms")
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
    traffic.live(min(cycles, 100))
    cycles -= 100
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
    for path in (*FAKES, HEAP):
        _compile(path, folder)
    printed = wasm32(folder, _MEASURE % cycles, time_limit_s=600)
    code, made, booted, lived, state = map(int, printed.split())
    assert state == OPERATIONAL
    bare = int(wasm32(folder, _BARE))
    return FlashedHeap(code, *(bare + each for each in (made, booted, lived)))


def _compile(path: Path, folder: Path) -> None:
    """Leave local and private names out: the table of names is not to grow by what no board has."""
    source = path.read_text(encoding="utf-8")
    private = sorted(set(re.findall(r"\b_[a-z]\w*", source)))
    short = {name: f"a{ascii_uppercase[place]}" for place, name in enumerate(private)}
    source = re.sub(r"\b_[a-z]\w*", lambda found: short[found[0]], source)
    (folder / f"{path.stem}.mpy").write_bytes(compile_source(source, path.stem, None))
    (folder / path.name).unlink(missing_ok=True)
