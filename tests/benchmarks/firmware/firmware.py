"""The cell on MicroPython and CPython: time a tick and a frame, heap, code size, and an estimate.

The estimate for an STM32F405 at 168 MHz rests on the Thumb-2 code that mpy-cross makes of
`speed_loop.step`: its instructions are counted, the largest share of its lines that a tick has
executed on the stream of extreme settings is the share that runs, and `CYCLES` comes from viper
code counted on an emulated Cortex-M4, calibrated with published scores of boards (480 instructions
in 6 us). It leaves out the calls around it and the peripherals.

The estimate for the neighbour layer rests on the instructions of the unix port under valgrind that
a beat takes, and on how many of an emulated Cortex-M4 it takes for each (`emulated`). Beats are
replayed as a board gets them: each frame from the controller through the inbox, with five that
filters let through and the cell drops, and turns of the background loop. The replay and the
stand-in for the controller, which on a board is C, are counted apart and left out.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from array import array
from pathlib import Path
from typing import Any

from tests.benchmarks.firmware._flashed_heap import HEAP, WAYS, flashed_heap
from tests.firmware.conftest import ROOT, stage, unix
from tests.micropython_builds import compile_staged, unix_command, wasm32

from mdms_cell.drive import speed_loop
from mdms_host.flashing.firmware import compile_module, compiled_firmware
from mdms_host.flashing.flashing import COPIES_HEAP, ROM_HEAP

HERE = Path(__file__).parent
MEASURE = HERE / "_firmware_measure.py"
LAYER = HERE / "_layer_measure.py"
BENCH = ROOT / "tests" / "both" / "bench"
STAGE = (BENCH / "layer_bench.py", BENCH / "cell_bench.py")
EMITTERS = ("viper", "native", "bytecode")
CYCLES = 2.1
ARCHITECTURE = "armv7emsp"
STM32F405_HZ = 168_000_000
#: Boards: clock, and cycles an instruction; those of a Cortex-M7 by CoreMark a MHz, 5.01 to 3.40.
BOARDS = {
    "PYBv1.1": (STM32F405_HZ, CYCLES),
    "NUCLEO-G474RE": (170_000_000, CYCLES),
    "WeAct STM32H743": (480_000_000, 1.43),
    "Teensy 4.1": (600_000_000, 1.43),
}
#: Of a board's processor, for the neighbour layer: of those that have room for all firmware.
LAYER_SHARE = 0.3
LAYER_BOARDS = ("WeAct STM32H743", "Teensy 4.1")
LAYER_KB = 16
#: Instructions of a Cortex-M4 for one of the unix port: a beat, counted on both; see `emulated`.
CORTEX_M4_SHARE = 237 / 311
SYNC_HZ = 100
#: Counts of beats whose difference is counted.
LAYER_BEATS = (20, 60)
#: SYNC periods of 10 ms in an hour.
HOUR_CYCLES = 360_000
#: The required free heap of a board; firmware of a slot has the rest beside its image.
NEEDS = {"copies": COPIES_HEAP, "romfs": ROM_HEAP}
#: A cell with its loop and queues, every tick and poll; garbage is collected at 100 KB more.
_HOUR = """
import gc
from _firmware_heap import Board, Traffic
from mdms_cell.cell import Cell
from mdms_cell.queues import Inbox, Outbox
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
        figures = {each: measured(_unix(here / each, each)) for each in EMITTERS}
        figures["CPython"] = measured(_cpython())
        return [*_times(figures), *_layer(here), *_heap(here), *_sizes(), _estimate()]


def measured(printed: str) -> dict[str, float]:
    pairs = [line.split() for line in printed.splitlines()]
    return {name: float(value) for name, value in pairs if value not in ("True", "False")}


def _cpython() -> str:
    return subprocess.run(
        [sys.executable, str(MEASURE)], capture_output=True, text=True, check=True
    ).stdout


def _unix(folder: Path, emitter: str) -> str:
    """The measurement on the unix port, with the tick compiled by this emitter."""
    stage(folder, [MEASURE])
    source = folder / Path(speed_loop.__file__).relative_to(ROOT / "firmware")
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
            rows.append(row(f"{name}, MicroPython {kind}", ours, "us", peer=peer))
    best = figures["viper"]
    together = best["tick_us"] + best["frame_us"] + best["sync_us"]
    rows.append(row("tick and SYNC cycle, MicroPython viper", together, "us", bound=40))
    rows.append(row("allocated a tick", best["tick_bytes"], "bytes", bound=0))
    rows.append(row("allocated a SYNC period of 10 ms", best["cycle_bytes"], "bytes"))
    return rows


def _layer(folder: Path) -> list[Row]:
    """A beat of the neighbour layer, reception included, in the middle of a moving parcel."""
    stage(folder / "layer", [LAYER, *STAGE])
    done = unix(folder / "layer", LAYER.name)
    assert done.returncode == 0, done.stdout + done.stderr
    ours = measured(done.stdout)
    search = os.pathsep.join([str(STAGE[0].parent), os.environ.get("PYTHONPATH", "")])
    peer = subprocess.run(
        [sys.executable, str(LAYER)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": search},
    ).stdout
    beat = "a beat of the neighbour layer, MicroPython"
    return [
        row(beat, ours["beat_us"], "us", peer=measured(peer)["beat_us"]),
        *_share(folder / "layer"),
        row("data of the neighbour layer, 64 bits", ours["layer_bytes"] / 1024, "KB"),
        row("data of it, 32 bits", _layer_bytes32(folder / "layer32") / 1024, "KB", bound=LAYER_KB),
    ]


def _layer_bytes32(folder: Path) -> int:
    stage(folder, [LAYER, *STAGE], viper=False)
    compile_staged(folder)
    return int(wasm32(folder, "from _layer_measure import layer_bytes; print(layer_bytes())"))


def _share(folder: Path) -> list[Row]:
    """The cost of that beat on a Cortex-M4, counted by valgrind; no rows without valgrind."""
    if shutil.which("valgrind") is None:
        return []
    stand_ins = _a_beat(folder, "apart")
    counted = _a_beat(folder) - stand_ins
    expected = counted * CORTEX_M4_SHARE
    how = {"counted": round(counted), "counted_by": "valgrind, unix port", "cycles_each": CYCLES}
    how["stand_ins"] = round(stand_ins)
    return [
        row("a beat of it, estimate for a Cortex-M4", expected, "", **how),
        *shares(expected),
    ]


def shares(instructions: float) -> list[Row]:
    """The share of each board's processor for a beat of this many instructions."""
    return [
        row(
            f"its share of a {board} at 100 Hz",
            instructions * cycles * SYNC_HZ / hz,
            "",
            bound=LAYER_SHARE if board in LAYER_BOARDS else None,
        )
        for board, (hz, cycles) in BOARDS.items()
    ]


def _a_beat(folder: Path, *how: str) -> float:
    """Instructions of the unix port that replays a beat."""
    few, many = LAYER_BEATS
    return (_instructions(folder, many, *how) - _instructions(folder, few, *how)) / (many - few)


def _instructions(folder: Path, beats: int, *how: str) -> int:
    """Instructions of the unix port, its start included, that replays so many beats."""
    tool = ["valgrind", "--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null"]
    done = subprocess.run(
        [*tool, *unix_command(), "-X", "heapsize=32m", LAYER.name, str(beats), *how],
        env={**os.environ, "MICROPYPATH": str(folder)},
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    found = re.search(r"I\s+refs:\s+([\d,]+)", done.stderr)
    assert found is not None, done.stderr
    return int(found[1].replace(",", ""))


def row(name: str, ours: float, unit: str, peer: float | None = None, **more: object) -> Row:
    ratio = None if peer is None else ours / peer
    return {"name": name, "ours": ours, "peer": peer, "ratio": ratio, "unit": unit, **more}


def _heap(folder: Path) -> list[Row]:
    """The firmware's share of a heap, including the interpreter's share at its start."""
    rows = [row for way in WAYS for row in _flashed(folder / way, way)]
    return [*rows, *_full_hour(folder / "hour")]


def _flashed(folder: Path, way: str) -> list[Row]:
    """All that is flashed, on faked peripherals: of each SYNC period of the hour two ticks."""
    heap = flashed_heap(folder, way, HOUR_CYCLES)
    where = f"32 bits, all that is flashed, {way}"
    need = NEEDS.get(way, heap.left) / 1024
    return [
        row(f"heap after boot, {where}", heap.made / 1024, "KB", bound=need),
        row(f"heap after an hour of traffic, {where}", heap.lived / 1024, "KB", bound=need),
        row(f"heap with every module loaded, {where}", heap.whole / 1024, "KB", bound=need),
        row("of it, code that the start loads", heap.code / 1024, "KB"),
    ]


def _full_hour(folder: Path) -> list[Row]:
    """The same hour on the 64-bit unix port, nothing left out."""
    stage(folder, [HEAP])
    done = unix(folder, "-c", _HOUR)
    booted, last, most = (int(each) / 1024 for each in done.stdout.split())
    return [
        row("heap after boot, 64 bits", booted, "KB"),
        row("heap after an hour with every tick and poll, 64 bits", last, "KB"),
        row("heap before a collection in that hour, 64 bits", most, "KB"),
    ]


def _sizes() -> list[Row]:
    firmware = compiled_firmware(ARCHITECTURE)
    in_rom = firmware.in_rom()
    return [
        row("files for a PYBv1.1", sum(map(len, firmware.files.values())) / 1024, "KB"),
        row("image for its ROMFS, if it had one", len(in_rom.rom or b"") / 1024, "KB"),
    ]


def _estimate() -> Row:
    source = Path(speed_loop.__file__)
    code = _viper_code(compile_module(source.name, source, ARCHITECTURE))
    instructions = speed_loop.AXES * count_thumb(code) * _executed_share()
    tick_us = instructions * CYCLES / STM32F405_HZ * 1e6
    return row(
        "arithmetic of a tick at worst, estimate for STM32F405",
        tick_us,
        "us",
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
    sys.path.insert(0, str(BENCH))
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
