"""Throws any number of seeded frames at a cell, on any interpreter.

`python -m tests.soak.fuzz [--frames N] [--nodes cpython|micropython|wasm] [--seed N]` prints
number and sum of the replies, which are the same everywhere, and the heap in use on the way. It
ends with 1 if a frame raised anything, or if more memory is in use in the second half than in the
first. With `--lines` it prints instead which lines of the firmware the frames do not reach.
"""

import argparse
import sys
import time
from pathlib import Path

from tests.soak.day import FUZZ
from tests.soak.interpreters import ROOT, run
from tests.soak.lines import missed

NODES = ("cpython", "micropython", "wasm")
_CODE = """
import gc, sys
from fuzz_cell import Bench

used = getattr(gc, "mem_alloc", None) or sys.getallocatedblocks
bench = Bench({seed})
for start in range(0, {frames}, {piece}):
    bench.live(min({piece}, {frames} - start))
    if {by_hand} or start % 10_000 == 0:
        gc.collect()
    if start % 10_000 == 0:
        print("heap", used())
print("replies", bench.board.frames, bench.board.sum)
"""
#: Frames between two collections on a build that collects here only, and has 1 MB.
_PIECE = {"cpython": 10_000, "micropython": 10_000, "wasm": 50}
#: The growth allowed in the second half: blocks of CPython, bytes of MicroPython.
_MORE = {"cpython": 100, "micropython": 1024, "wasm": 1024}


def parser() -> argparse.ArgumentParser:
    """The options."""
    options = argparse.ArgumentParser(prog="python -m tests.soak.fuzz", description=__doc__)
    options.add_argument("--frames", type=int, default=1_000_000)
    options.add_argument("--nodes", choices=NODES, default=NODES[0])
    options.add_argument("--seed", type=int, default=2026)
    options.add_argument("--lines", action="store_true", help="tell what is not reached")
    return options


def main() -> int:
    """Run and report; the exit code is whether the cell withstood it."""
    told = parser().parse_args()
    if told.lines:
        tell_lines(told.seed, told.frames)
        return 0
    code = _CODE.format(
        seed=told.seed,
        frames=told.frames,
        piece=_PIECE[told.nodes],
        by_hand=told.nodes == "wasm",
    )
    heaps: list[int] = []
    start_s = time.perf_counter()
    with run(told.nodes, code, FUZZ) as running:
        for line in running:
            word, _, rest = line.partition(" ")
            if word == "heap":
                heaps.append(int(rest))
            else:
                print(line)
        failed = running.failed
    unit = "blocks" if told.nodes == "cpython" else "bytes"
    if heaps:
        print(f"heap in use {min(heaps):,} to {max(heaps):,}, at last {heaps[-1]:,} {unit}")
    print(f"{told.frames:,} frames in {time.perf_counter() - start_s:.0f} s")
    grown = growth(heaps)
    if grown > _MORE[told.nodes]:
        print(f"found: {grown:,} {unit} more in use in the second half than in the first")
    return 1 if failed or grown > _MORE[told.nodes] else 0


def growth(heaps: list[int]) -> int:
    """How far the most that is in use in the second half exceeds that of the first."""
    half = len(heaps) // 2
    return max(heaps[half:]) - max(heaps[:half]) if half else 0


def tell_lines(seed: int, frames: int) -> None:
    """Print by module how much of it the frames reach, and what not."""
    import mdms_cell

    sys.path.insert(0, str(ROOT / "tests" / "both" / "fuzz"))
    from fuzz_cell import fuzz  # type: ignore[import-not-found]

    assert mdms_cell.__file__ is not None
    figures = missed(Path(mdms_cell.__file__).parent, lambda: fuzz(seed, frames))
    count = sum(lines for _, lines in figures.values())
    reached = count - sum(len(lines) for lines, _ in figures.values())
    for name, (lines, of) in figures.items():
        if lines:
            print(f"{name:<18} {of - len(lines):>4} of {of:<4} not", *lines)
    print(f"{reached} of {count} lines: {reached / count:.1%}")


if __name__ == "__main__":
    sys.exit(main())
