"""A cell raises nothing, stays valid, and replies alike everywhere, for any frames on the bus.

`python -m tests.soak.fuzz` does the same with a million frames.
"""

import sys
from pathlib import Path

import pytest

FUZZERS = Path(__file__).parents[1] / "both" / "fuzz"
SEED = 2026
FRAMES = 20_000


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


@pytest.mark.slow
def test_same_frames_give_the_same_replies_on_both_interpreters_and_leave_their_memory(micropython):
    used = []
    replies = fuzz(FRAMES, lambda: used.append(sys.getallocatedblocks()))
    assert replies[1] > FRAMES // 2
    assert max(used[4:]) <= max(used[:4]) + 40
    on_the_board, heap = on_micropython(micropython, FRAMES)
    assert on_the_board == replies
    assert max(heap[1:]) <= heap[0] + 1024
