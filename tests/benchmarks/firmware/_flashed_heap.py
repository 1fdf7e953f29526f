"""The heap that all takes that is flashed, on the 32-bit MicroPython and faked peripherals.

That build makes no machine code, so the machine code of a board is bytecode here.
"""

from dataclasses import dataclass
from pathlib import Path

from tests.micropython_builds import EMITTER_LINE, wasm32

from mdms_host.flashing.firmware import START, compile_module, rom_image, sources

HEAP = Path(__file__).parent / "_firmware_heap.py"
_FAKED = ("machine", "pyb", "stm", "world", "pin_names", "can_controller", "can_stm32", "can_bx")
_FAKED += ("can_fd",)
FAKES = tuple(Path(__file__).parents[2] / "firmware" / "fakes" / f"{name}.py" for name in _FAKED)
BOARD = "pybv11"
#: Modules of boards with room for a second firmware; `main` loads `mdms_boot` from files.
ROOMY = ("mdms_cell.update", "mdms_protocol.codecs.bundle", "mdms_boot")
OTHERS = ("boards.nucleo", "boards.weact", "boards.teensy")
#: From files, from a ROMFS in flash, and from a slot, whose image lies in the heap besides.
WAYS = ("copies", "romfs", "slot")
#: The memory of the interpreter itself.
_BARE = "import gc; print(gc.mem_alloc())"
#: Measuring code and peripherals do not count. That build finds garbage at module level only.
_MEASURE = """
import gc, sys
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
if %r:
    import vfs
    with open("/input/firmware.romfs", "rb") as file: rom = memoryview(file.read())
    vfs.mount(vfs.VfsRom(rom), "/rom")
    sys.path.append("/rom")
    del file
before = note()
load("main")
load("boards.start")
load("boards.%s")
code = note()
from boards import start
board = sys.modules["boards.%s"].board()
cell = start.Cell(board, 5)
runner = start.Runner(board, cell)
board.start(runner.tick)
booted = note()
traffic = Traffic(Driven(world, runner))
traffic.boot()
world.told.clear()
running = note()
for _ in range(2):
    half = note()
    cycles = %d
    while cycles > 0:
        note()
        traffic.live(min(cycles, 100))
        cycles -= 100
lived = note()
growth = gc.mem_alloc()
traffic.live(100)
growth = gc.mem_alloc() - growth
%s
whole = note()
left = gc.mem_free() + gc.mem_alloc() - board.image_room()
print(code - before, booted - before, running - before, half - before, lived - before)
print(whole - before)
print(left, growth, cell.state)
"""
OPERATIONAL = 5


@dataclass(frozen=True, slots=True)
class FlashedHeap:
    """Bytes in use: code alone, cell made, operational, after traffic, with every module loaded.

    `half` is amid the traffic. All figures but `code` include the memory of the interpreter. `left`
    is the rest of the heap beside the image of a slot, `garbage` the growth in a second of traffic.
    """

    code: int
    made: int
    running: int
    half: int
    lived: int
    whole: int
    left: int
    garbage: int


def flashed_heap(folder: Path, way: str, cycles: int) -> FlashedHeap:
    """Start the flashed firmware as `main` does, boot it, and let this many SYNC periods pass."""
    folder.mkdir()
    modules = _staged(folder, way)
    loads = "\n".join(f"load({name!r})" for name in modules)
    code = _MEASURE % (way != "copies", BOARD, BOARD, cycles // 2, loads)
    *figures, state = map(int, wasm32(folder, code, time_limit_s=600).split())
    assert state == OPERATIONAL
    bare = int(wasm32(folder, _BARE))
    inside, *together, left, garbage = figures
    return FlashedHeap(inside, *(bare + each for each in together), left, garbage)


def _staged(folder: Path, way: str) -> list[str]:
    """Put the firmware and what measures into a folder; the names of modules for this board."""
    compiled = {}
    for place, path in sources().items():
        source = folder / "source.py"
        source.write_text(EMITTER_LINE.sub("", path.read_text(encoding="utf-8")), encoding="utf-8")
        if place == START:
            source.rename(folder / START)
        else:
            compiled[f"{place[:-3]}.mpy"] = compile_module(place, source, None)
    (folder / "source.py").unlink()
    files = {} if way == "romfs" else compiled
    if way == "slot":
        files = {place: data for place, data in compiled.items() if place.startswith("mdms_boot")}
    if way != "copies":
        in_rom = {place: data for place, data in compiled.items() if place not in files}
        (folder / "firmware.romfs").write_bytes(rom_image(in_rom))
    for place, data in files.items():
        (folder / place).parent.mkdir(exist_ok=True)
        (folder / place).write_bytes(data)
    for path in (*FAKES, HEAP):
        compiled_path = folder / f"{path.stem}.mpy"
        compiled_path.write_bytes(compile_module(path.name, path, None))
    names = [place[: -len(".mpy")].replace("/", ".") for place in compiled]
    others = OTHERS if way == "slot" else OTHERS + ROOMY
    return [name for name in names if not name.startswith(others) and "_init_" not in name]
