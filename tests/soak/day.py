"""A cell's simulated day on one interpreter: run it, and judge its reports."""

import math
import sys
from dataclasses import dataclass, field
from pathlib import Path

from tests.soak.interpreters import ROOT, Run, run

CELL = Path(__file__).with_name("cell")
FUZZ = tuple(sorted((ROOT / "tests" / "both" / "fuzz").glob("fuzz_*.py")))
MODULES = (*sorted(CELL.glob("*.py")), *FUZZ)
# A build that collects garbage here only has 1 MB; 20 ms take 0.3 MB at most.
_CODE = """
import gc, sys
from life import Life

used = getattr(gc, "mem_alloc", None) or sys.getallocatedblocks
life = Life({seed}, {before_wrap_ms})
while life.live({until_ms}, 20):
    if life.sampling or {by_hand} and gc.mem_free() < 500_000:
        gc.collect()
    if life.sampling:
        life.tell_sample(used())
life.tell()
"""
#: The limit of noise, beyond three standard errors of the slope: bytes, or blocks of CPython.
_NOISE = {"cpython": 60.0, "micropython": 500.0, "wasm": 500.0}
_RESIDENT_NOISE_KB = 1024
_MS_PER_HOUR = 3_600_000


@dataclass(frozen=True, slots=True)
class Sample:
    """The heap [bytes, or blocks of CPython] and resident memory [KB] at a simulated time [ms]."""

    time_ms: int
    heap: int
    resident_kb: int | None


@dataclass(slots=True)
class Day:
    """The outcome of a day; `findings` are sentences with their simulated time."""

    nodes: str
    samples: list[Sample] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)
    simulated_ms: int = 0
    frames: int = 0
    heartbeats: int = 0
    sum: int = 0

    @property
    def settled(self) -> list[Sample]:
        """All samples but the first, which comes before anything has happened."""
        return self.samples[1:]

    def judge_memory(self) -> None:
        """Add a finding if the memory is not steady."""
        if len(self.settled) < 3:
            return
        hours = (self.settled[-1].time_ms - self.settled[0].time_ms) / _MS_PER_HOUR
        slope, error = self.slope_per_hour()
        if (slope - 3 * error) * hours > _NOISE[self.nodes]:
            self.findings.append(f"the heap grows by {slope:.0f} +- {error:.0f} an hour")
        resident = [each.resident_kb for each in self.settled if each.resident_kb is not None]
        if (
            self.nodes == "micropython"
            and resident
            and resident[-1] - resident[0] > (_RESIDENT_NOISE_KB)
        ):
            self.findings.append(f"the process grew from {resident[0]} to {resident[-1]} KB")

    def slope_per_hour(self) -> tuple[float, float]:
        """Slope of the heap over simulated hours by least squares, and its standard error."""
        times = [each.time_ms / _MS_PER_HOUR for each in self.settled]
        heaps = [each.heap for each in self.settled]
        count = len(times)
        mean_time, mean_heap = sum(times) / count, sum(heaps) / count
        spread = sum((time - mean_time) ** 2 for time in times)
        both = sum((t - mean_time) * (h - mean_heap) for t, h in zip(times, heaps, strict=True))
        slope = both / spread
        rest = sum(
            (h - mean_heap - slope * (t - mean_time)) ** 2
            for t, h in zip(times, heaps, strict=True)
        )
        return slope, math.sqrt(rest / (count - 2) / spread)


def clock(time_ms: int) -> str:
    """A simulated time as hours, minutes and seconds."""
    seconds, ms = divmod(time_ms, 1000)
    return f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}.{ms:03}"


def live(nodes: str, seed: int, duration_ms: int, before_wrap_ms: int) -> Day:
    """Let a cell live that long, or until Ctrl-C; its clock wraps after `before_wrap_ms`."""
    code = _CODE.format(
        seed=seed,
        until_ms=duration_ms,
        before_wrap_ms=before_wrap_ms,
        by_hand=nodes == "wasm",
    )
    day = Day(nodes)
    with run(nodes, code, MODULES) as running:
        try:
            for line in running:
                _take(day, line, running, duration_ms)
            if running.failed:
                day.findings.append("the program did not end as it should")
        except KeyboardInterrupt:
            _show("\n")
    day.judge_memory()
    return day


def _take(day: Day, line: str, running: Run, duration_ms: int) -> None:
    word, _, rest = line.partition(" ")
    if word == "at":
        day.simulated_ms, day.frames, day.heartbeats, day.sum = map(int, rest.split())
        _show(f"\r{clock(day.simulated_ms)} of {clock(duration_ms)}\x1b[K")
    elif word == "sample":
        time_ms, heap = map(int, rest.split())
        day.samples.append(Sample(time_ms, heap, running.resident_kb()))
    elif word == "finding":
        time_ms, text = rest.split(" ", 1)
        day.findings.append(f"{clock(int(time_ms))} {text}")
    elif line:
        day.findings.append(line)


def _show(text: str) -> None:
    if sys.stderr.isatty():
        print(text, end="", file=sys.stderr, flush=True)
