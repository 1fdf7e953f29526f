"""A cell's simulated minute with everything that happens to it, while the clock wraps."""

import importlib
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.micropython_builds import skipping_without_micropython

from mdms_sim.nodes.micropython_process import find_micropython

ROOT = Path(__file__).parents[2]
SOAK = ROOT / "tests" / "soak"
SEED = 5
#: All chapters of the story once, and the wrap in the middle.
HOURS = 0.016
WRAP_AFTER_S = 30
SUM = re.compile(r"([\d,]+) frames sent, ([\d,]+) heartbeats, sum (\w+)")


def soak(nodes: str, **options: object) -> subprocess.CompletedProcess[str]:
    told = {"seed": SEED, "hours": HOURS, "wrap-after": WRAP_AFTER_S, **options}
    more = [f"--{name}={value}" for name, value in told.items()]
    return subprocess.run(
        [sys.executable, "-m", "tests.soak", "--nodes", nodes, *more],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def sent(done: subprocess.CompletedProcess[str]) -> tuple[int, int, str]:
    assert done.returncode == 0, done.stdout + done.stderr
    found = SUM.search(done.stdout)
    assert found is not None
    frames, heartbeats = (int(each.replace(",", "")) for each in found.groups()[:2])
    return frames, heartbeats, found[3]


@pytest.mark.slow
def test_a_minute_across_the_wrap_is_the_same_on_both_interpreters():
    with skipping_without_micropython():
        find_micropython()
    frames, heartbeats, _ = both = sent(soak("cpython"))
    assert frames > 5_000
    assert heartbeats > 400
    assert sent(soak("micropython")) == both


@pytest.fixture
def day(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("tests.soak.day")


def lived(day, heaps, resident_kb=12_000):
    samples = [day.Sample(600_000 * n, heap, resident_kb) for n, heap in enumerate(heaps)]
    lived = day.Day("micropython", samples)
    lived.judge_memory()
    return lived


def test_heap_that_grows_is_found_and_one_that_sways_is_not(day):
    sway = [200_000 + 400 * (n * 7 % 5) for n in range(72)]
    assert not lived(day, sway).findings
    assert lived(day, [heap + 30 * n for n, heap in enumerate(sway)]).findings


def test_frame_off_its_grid_is_found(monkeypatch):
    monkeypatch.syspath_prepend(str(SOAK / "cell"))
    grids = importlib.import_module("grid")
    found = []
    grid = grids.Grid("heartbeat", 100, SimpleNamespace(find=found.append))
    grid.start(0)
    for now_ms in (100, 203, 300):
        grid.heard(now_ms)
        grid.poll(now_ms)
    assert not found
    grid.heard(399)
    assert found == ["heartbeat -1 ms off its grid"]
    for now_ms in range(400, 506):
        grid.poll(now_ms)
    assert found[1:] == ["heartbeat missing"]
