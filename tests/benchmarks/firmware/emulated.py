"""A beat of the neighbour layer on an emulated Cortex-M4: instructions, data, and a cell's heap.

Runs the firmware frozen into MicroPython's port for QEMU, as it is frozen into a PYBv1.1. The
emulator counts each instruction as a nanosecond, so the microseconds that its clock shows are
thousands of instructions. Needs `qemu-system-arm`, `arm-none-eabi-gcc` with newlib, and in
MICROPYTHON the path of a checkout of MicroPython, prepared by `make -C mpy-cross` and
`make -C ports/qemu submodules`; without them there are no rows.

MicroPython keeps the places of names that were looked up last: of 128, or of as many as its build
says. FREEZING.md has 1,024.
"""

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from tests.benchmarks.firmware.firmware import (
    HEAP,
    LAYER,
    LAYER_KB,
    STAGE,
    measured,
    row,
    shares,
)
from tests.micropython_builds import stage

TOOLS = ("qemu-system-arm", "arm-none-eabi-gcc")
MACHINE = "mps2-an386"
CORE = "cortex-m4"
#: Of the protocol, what MicroPython does not compile, besides the generators.
HOST_ALONE = ("mdms_protocol/neighbours/messages.py",)
#: Places of names that MicroPython keeps: its own number, and that of FREEZING.md.
KEPT_PLACES = (128, 1024)
HEAP_BYTES = 2_500_000
TIME_LIMIT_S = 300
#: The files that MicroPython's build reads of a board.
_BOARD = f"""
QEMU_ARCH = arm
CFLAGS += -mthumb -mcpu={CORE} -mfloat-abi=soft -DQEMU_SOC_MPS2
CFLAGS += -DMICROPY_HW_MCU_NAME='"{CORE}"'
LDSCRIPT = mcu/arm/mps2.ld
SRC_BOARD_O = shared/runtime/gchelper_native.o shared/runtime/gchelper_thumb2.o
MPY_CROSS_FLAGS += -march=armv7em
"""
_RUN = """
import gc, machine, sys
try:
    from _firmware_heap import Board
    from mdms_cell.cell import Cell
    from mdms_cell.queues import Inbox, Outbox
    cell = Cell(Board(Inbox(), Outbox()), 5)
    for now_ms in range(1000): cell.poll(now_ms)
    gc.collect()
    print("heap_bytes", gc.mem_alloc())
    import _layer_measure
    _layer_measure.main(())
except Exception as error:
    sys.print_exception(error)
machine.reset()
"""
_FIGURE = re.compile(r"\w+ [\d.]+")
Row = dict[str, Any]


def run() -> list[Row]:
    """Instructions of a beat, its share of each board, data, and heap."""
    tree = os.environ.get("MICROPYTHON")
    if tree is None or None in map(shutil.which, TOOLS):
        print("  not counted: it needs", *TOOLS, "and MICROPYTHON, a checkout of it")
        return []
    return [each for kept in KEPT_PLACES for each in _counted(Path(tree), kept)]


def _counted(micropython: Path, kept: int) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        found = measured(_emulated(_built(micropython, Path(folder), kept)))
    stand_ins = 1000 * found["apart_us"]
    beat = 1000 * found["beat_us"] - stand_ins
    name = f"a beat of the layer, {kept} places of names kept"
    return [
        row(name, beat, "instructions", stand_ins=stand_ins),
        *shares(beat),
        row("data of the layer", found["layer_bytes"] / 1024, "KB", bound=LAYER_KB),
        row("heap of a cell with its queues", found["heap_bytes"] / 1024, "KB"),
    ]


def _built(micropython: Path, folder: Path, kept: int) -> Path:
    """MicroPython with the firmware and what measures it frozen in."""
    frozen = folder / "frozen"
    stage(frozen, [LAYER, HEAP, *STAGE])
    for name in HOST_ALONE:
        (frozen / name).unlink()
    shutil.rmtree(frozen / "mdms_protocol" / "generators")
    (folder / "mpconfigboard.mk").write_text(_BOARD)
    manifest = folder / "manifest.py"
    manifest.write_text(f"freeze({str(frozen)!r})\n")
    settings = {
        "BOARD": MACHINE,
        "BOARD_DIR": folder,
        "BUILD": folder / "build",
        "FROZEN_MANIFEST": manifest,
        "MICROPY_HEAP_SIZE": HEAP_BYTES,
        "CFLAGS_EXTRA": f"-DMICROPY_OPT_MAP_LOOKUP_CACHE_SIZE={kept}",
    }
    given = [f"{name}={setting}" for name, setting in settings.items()]
    port = str(micropython / "ports" / "qemu")
    made = subprocess.run(["make", "-C", port, *given], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    return folder / "build" / "firmware.elf"


def _emulated(firmware: Path) -> str:
    """The output of the measurement; it is typed at MicroPython's prompt."""
    clock = ["-icount", "shift=0,sleep=off"]
    quiet = ["-nographic", "-monitor", "none", "-serial", "stdio", "-semihosting"]
    done = subprocess.run(
        ["qemu-system-arm", "-machine", MACHINE, *quiet, *clock, "-kernel", str(firmware)],
        input="\x05" + _RUN + "\x04",
        capture_output=True,
        text=True,
        check=True,
        timeout=TIME_LIMIT_S,
    )
    figures = [line for line in done.stdout.splitlines() if _FIGURE.fullmatch(line)]
    assert figures, done.stdout
    return "\n".join(figures)
