"""Memory and disk of a table that works for an hour: `sort54` in virtual time, with `--log all`.

`python -m tests.benchmarks hour` takes an hour of virtual time; MDMS_SECONDS=120 takes less. Memory
is that of the whole process, the simulator included. It is compared after a quarter of the time,
when the ring and all caches are full, and at the end. Below 1,200 s the record of the run still
fills meanwhile, so more is allowed; below 130 s no log file is full.
"""

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from tests.system.long_run import LongRun

from mdms_host.cli.log_files import EVENT_BYTES, EVENT_FILES, FRAME_BYTES, FRAME_FILES

SECONDS = float(os.environ.get("MDMS_SECONDS", "3600"))
#: The longest that the kept samples of a run may still grow: they are halved when they are full.
GROWS = 1.3
#: Samples of the record of `mdms run`, which are halved at 30,000: full after so long [s].
RECORD_BYTES, RECORD_S = 250_000_000, 300.0


def run() -> list[dict[str, Any]]:
    """Run it, and look at memory and disk sixteen times."""
    with TemporaryDirectory() as folder, LongRun("sort54", Path(folder)) as table:
        began_s, seen = perf_counter(), []
        for _ in range(16):
            table.pass_s(SECONDS / 16)
            seen.append((_resident_bytes(), table.objects))
        took_s, disk = perf_counter() - began_s, table.disk_bytes
        events, frames = (
            len(table.coordinator.events),
            sum(b.frames for b in table.simulation.buses),
        )
    (before, objects_before), (after, objects_after) = seen[3], seen[-1]
    fills_bytes = RECORD_BYTES if SECONDS / 4 < RECORD_S else 0
    most = EVENT_BYTES * EVENT_FILES + FRAME_BYTES * FRAME_FILES
    return [
        {
            "name": f"{SECONDS:g} s of sort54: memory",
            "ours": after / 1e6,
            "peer": before / 1e6,
            "ratio": after / before,
            "unit": "MB",
            "failed": after > before * GROWS + fills_bytes,
            "objects": objects_after,
            "objects_before": objects_before,
            "took_s": took_s,
        },
        {
            "name": f"{SECONDS:g} s of sort54: disk",
            "ours": disk / 1e6,
            "peer": most / 1e6,
            "ratio": disk / most,
            "unit": "MB",
            "failed": disk > most * 1.01,
            "events": events,
            "frames": frames,
        },
    ]


def _resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
