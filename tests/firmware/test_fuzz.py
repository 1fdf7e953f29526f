"""Whatever comes over the bus, a cell raises nothing, stays valid, and replies alike everywhere.

`python -m tests.soak.fuzz` does the same with a million frames.
"""

import sys
from pathlib import Path

import pytest

FUZZERS = Path(__file__).parents[1] / "both" / "fuzz"
SEED = 2026


def fuzz(frames, measure=None):
    sys.path.insert(0, str(FUZZERS))
    try:
        from fuzz_cell import fuzz as run
    finally:
        sys.path.remove(str(FUZZERS))
    return run(SEED, frames, measure)


def on_micropython(micropython, frames):
    code = (
        "import gc\n"
        "from fuzz_cell import fuzz\n"
        "used = []\n"
        f"print(*fuzz({SEED}, {frames}, lambda: used.append(gc.mem_alloc())))\n"
        "print(*used)\n"
    )
    replies, used = micropython(code, *sorted(FUZZERS.glob("fuzz_*.py"))).splitlines()[-2:]
    return tuple(map(int, replies.split())), list(map(int, used.split()))


def test_same_frames_give_the_same_replies_on_micropython_and_leave_its_heap(micropython):
    replies, used = on_micropython(micropython, 20_000)
    assert replies == fuzz(20_000)
    assert replies[1] > 10_000
    assert max(used[1:]) <= used[0] + 1024


@pytest.mark.slow
def test_60_000_frames_raise_nothing_and_leave_the_memory_as_it_was():
    used = []
    fuzz(60_000, lambda: used.append(sys.getallocatedblocks()))
    assert max(used[3:]) <= max(used[:3]) + 100
