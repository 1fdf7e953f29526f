"""A cell raises nothing, stays valid, and replies alike everywhere, for any frames on the bus.

`python -m tests.soak.fuzz` does the same with a million frames.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FUZZERS = Path(__file__).parents[1] / "both" / "fuzz"
SEED = 2026
FRAMES = 20_000


def code(gauge):
    return (
        "import gc, sys\n"
        "from fuzz_cell import fuzz\n"
        "used = []\n"
        f"print(*fuzz({SEED}, {FRAMES}, lambda: used.append({gauge})))\n"
        "print(*used)\n"
    )


def read(printed):
    replies, used = printed.splitlines()[-2:]
    return tuple(map(int, replies.split())), list(map(int, used.split()))


def on_cpython():
    """An interpreter of its own: here, other threads and tests take memory, too."""
    path = os.pathsep.join([str(FUZZERS), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", code("sys.getallocatedblocks()")],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    return read(done.stdout)


def on_micropython(micropython):
    return read(micropython(code("gc.mem_alloc()"), *sorted(FUZZERS.glob("fuzz_*.py"))))


@pytest.mark.slow
def test_same_frames_give_the_same_replies_on_both_interpreters_and_leave_their_memory(micropython):
    replies, used = on_cpython()
    assert replies[1] > FRAMES // 2
    assert max(used[4:]) <= max(used[:4]) + 40
    on_the_board, heap = on_micropython(micropython)
    assert on_the_board == replies
    assert max(heap[1:]) <= heap[0] + 1024
