"""Lets a cell live for simulated hours, and looks at it all the time.

`python -m tests.soak [--hours H] [--nodes cpython|micropython|wasm] [--seed N]` prints its findings
and the steadiness of the memory. It ends with 1 if there was a finding. The same seed gives the
same frames on every interpreter, which the sum over them shows.
"""

import argparse
import sys
import time

from tests.soak.day import Day, live

NODES = ("micropython", "cpython", "wasm")
_MS_PER_HOUR = 3_600_000


def parser() -> argparse.ArgumentParser:
    """The options."""
    options = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    options.add_argument("--hours", type=float, default=12.0, help="simulated, 12 if not told")
    options.add_argument("--nodes", choices=NODES, default=NODES[0])
    options.add_argument("--seed", type=int, default=1)
    options.add_argument(
        "--wrap-after", type=float, default=300.0, metavar="S", help="until the clock wraps [s]"
    )
    return options


def main() -> int:
    """Run, report, and tell by the exit code whether all was well."""
    told = parser().parse_args()
    start_s = time.perf_counter()
    day = live(
        told.nodes, told.seed, round(told.hours * _MS_PER_HOUR), round(told.wrap_after * 1000)
    )
    report(day, time.perf_counter() - start_s)
    return 1 if day.findings else 0


def report(day: Day, wall_s: float) -> None:
    """Print the findings and the figures."""
    for finding in day.findings:
        print("found:", finding)
    rate = day.simulated_ms / wall_s
    hours = day.simulated_ms / _MS_PER_HOUR
    print(f"{hours:.2f} simulated hours on {day.nodes} in {wall_s:.0f} s: {rate:,.0f} ticks/s")
    print(f"{day.frames:,} frames sent, {day.heartbeats:,} heartbeats, sum {day.sum:08x}")
    if len(day.settled) >= 3:
        heaps = [each.heap for each in day.settled]
        unit = "blocks" if day.nodes == "cpython" else "bytes"
        slope, error = day.slope_per_hour()
        print(
            f"heap in use {min(heaps):,} to {max(heaps):,} {unit} in {len(heaps)} samples, "
            f"{slope:+.1f} +- {error:.1f} an hour"
        )
        resident = [each.resident_kb for each in day.settled if each.resident_kb is not None]
        if resident and day.nodes == "micropython":
            print(f"process {min(resident):,} to {max(resident):,} KB")
    print(f"{len(day.findings)} findings")


if __name__ == "__main__":
    sys.exit(main())
