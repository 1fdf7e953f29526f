"""The heap that all takes that is flashed, on the 32-bit MicroPython and faked peripherals."""

import array
import builtins
import io
import keyword
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.firmware.images import BOARD, FAKES, flashed
from tests.micropython_builds import wasm32

from mdms_image.compiler import compile_source
from mdms_image.image import merged

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
#: Names that stay: keywords, MicroPython's own, and those of modules.
_KEPT = {
    *keyword.kwlist,
    *(
        name
        for each in (builtins, dict, list, bytes, memoryview, array.array)
        for name in dir(each)
    ),
    *("array", "pyb", "machine", "world"),
}


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
    sources = {path.stem: path.read_text(encoding="utf-8") for path in (*FAKES, HEAP)}
    words = _Words(list(sources.values()), set(_names(_MEASURE % cycles)))
    for name, source in sources.items():
        (folder / f"{name}.mpy").write_bytes(compile_source(words.say(source), name, None))
        (folder / f"{name}.py").unlink(missing_ok=True)
    printed = wasm32(folder, _MEASURE % cycles, time_limit_s=600)
    code, made, booted, lived, state = map(int, printed.split())
    assert state == OPERATIONAL
    bare = int(wasm32(folder, _BARE))
    return FlashedHeap(code, *(bare + each for each in (made, booted, lived)))


class _Words:
    """Says what measures, and what fakes the peripherals, in names that the image has anyway.

    The interpreter keeps names for good, and doubles their table when it is full. A board has its
    peripherals' names in its own flash, and none of those that only measure.
    """

    def __init__(self, sources: list[str], kept: set[str]) -> None:
        kept = kept | _KEPT
        image = merged(BOARD, emits=False).sources.values()
        known = {name for source in image for name in _names(source)}
        own = {name for source in sources for name in _names(source)}
        free = sorted(name for name in known - own - kept if name.isalpha() and len(name) < 3)
        self._short = dict(zip(sorted(own - known - kept), free, strict=False))

    def say(self, source: str) -> str:
        """The source in these words."""
        tokens = tokenize.generate_tokens(io.StringIO(source).readline)
        return tokenize.untokenize((kind, self._short.get(text, text)) for kind, text, *_ in tokens)


def _names(source: str) -> Iterator[str]:
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return (each.string for each in tokens if each.type == tokenize.NAME)
