"""Random well-formed instances of many parcels: does every parcel arrive, and touch no other?

Instances are of `_route_instances`. Plans are checked by `_route_outlines`, which has no code in
common with the planner. Times are of the processor, for all parcels at once (`ours`), and for a
single parcel that is planned anew while the others keep their routes (`one_ms`). Where somebody
would then have waited for it for ever, all were planned anew: in `anew` instances, with their times
counted apart (`anew_ms`, including the time of the vain plan for one). `bound` is the upper end of
a one-sided 95 % confidence interval of the share that fails.

`python -m tests.benchmarks.host.routes [--instances N] [--seed S] [--seconds T] [--table 9x6]`
prints more of it, by table.
"""

import argparse
import gc
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import inf
from random import Random
from time import monotonic, process_time
from typing import Any

import numpy as np
from tests.benchmarks.host._route_instances import TABLES, Table, instance
from tests.benchmarks.host._route_outlines import faults

from mdms_host.routes.planner import RoutePlan

CONFIDENCE = 0.95


@dataclass
class Count:
    """The outcome of the instances of a table."""

    instances: int = 0
    parcels: int = 0
    full: int = 0
    """Instances of as many parcels as the table may have."""
    bad: list[str] = field(default_factory=list)
    all_ms: list[float] = field(default_factory=list)
    one_ms: list[float] = field(default_factory=list)
    anew_ms: list[float] = field(default_factory=list)


def try_one(table: Table, seed: int, count: Count) -> None:
    """One instance: plan all, check, then plan one anew among the others' routes."""
    tasks = instance(table, seed)
    begun_s = process_time()
    plan = table.planner.plan(tasks)
    assert len(plan.reservations.waits) == len(tasks)  # they are worked out when asked for
    count.all_ms.append((process_time() - begun_s) * 1e3)
    count.instances += 1
    count.parcels += len(tasks)
    count.full += len(tasks) == table.parcels
    one = Random(seed).choice(tasks)
    begun_s = process_time()
    again = table.planner.plan([one], kept=table.planner.kept(plan, begun_m(plan), 0.0))
    times_ms = count.one_ms
    if again.blocked or held(again):
        # As on a table: who waits for it for ever is stopped, and all are planned anew.
        again, times_ms = table.planner.plan(tasks), count.anew_ms
    assert len(again.reservations.waits) == len(tasks)
    times_ms.append((process_time() - begun_s) * 1e3)
    wrong = faults(table.size_m, tasks, plan) + faults(table.size_m, tasks, again)
    wrong += [f"{name} waits for ever" for name in sorted(held(plan) | held(again))]
    if wrong:
        count.bad.append(f"seed {seed}: {'; '.join(wrong)}")


def held(plan: RoutePlan) -> frozenset[str]:
    """Parcels that never arrive from the begin of their routes while all keep to the tile order."""
    return plan.reservations.held(begun_m(plan), ())


def begun_m(plan: RoutePlan) -> dict[str, float]:
    """How far all have come on their routes when they begin."""
    return dict.fromkeys(plan.routes, 0.0)


def share_bound(bad: int, runs: int) -> float:
    """The share that is not exceeded with 95 % confidence (Clopper and Pearson)."""
    low, high = bad / max(runs, 1), 1.0
    for _ in range(50):
        share = (low + high) / 2
        term, total = (1 - share) ** runs, 0.0
        for k in range(bad + 1):
            total += term
            term *= (runs - k) / (k + 1) * share / (1 - share)
        low, high = (share, high) if total > 1 - CONFIDENCE else (low, share)
    return high


def p99(times_ms: Sequence[float]) -> float | None:
    return float(np.percentile(times_ms, 99)) if times_ms else None


def median(times_ms: Sequence[float]) -> float | None:
    return float(np.median(times_ms)) if times_ms else None


def rows_of(
    instances: int, seed: int, seconds: float = inf, tables: Sequence[Table] = TABLES
) -> Iterator[dict[str, Any]]:
    """So many instances of each table, or as many as so long a time allows."""
    for table in tables:
        count = Count()
        try_one(table, seed - 1, Count())  # results that are worked out once a shape, and compiled
        # As in runs in real time: present objects are not looked through for garbage.
        gc.collect()
        gc.freeze()
        end_s = monotonic() + seconds
        for number in range(instances):
            if monotonic() < end_s:
                try_one(table, seed + number, count)
        yield (
            {
                "name": f"routes: {table.parcels} on {table.columns} x {table.rows}, all planned",
                "ours": p99(count.all_ms),
                "peer": None,
                "ratio": None,
                "unit": "ms (p99)",
                "median_ms": median(count.all_ms),
                "one_ms": p99(count.one_ms),
                "one_median_ms": median(count.one_ms),
                "anew": len(count.anew_ms),
                "anew_ms": p99(count.anew_ms),
                "anew_median_ms": median(count.anew_ms),
                "instances": count.instances,
                "parcels": count.parcels,
                "full": count.full,
                "bad": len(count.bad),
                "bound": share_bound(len(count.bad), count.instances),
                "seeds": f"{seed}..{seed + count.instances - 1}",
                "first_bad": count.bad[:3],
            }
        )


def run() -> list[dict[str, Any]]:
    """Some of it, for the table of all benchmarks."""
    return list(rows_of(30, 1, seconds=60.0))


def main() -> None:
    """As many as are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--instances", type=int, default=100, help="of each table")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=inf, help="for each table at most")
    parser.add_argument("--table", choices=[table.name for table in TABLES], help="only this one")
    options = parser.parse_args()
    tables = [table for table in TABLES if options.table in (None, table.name)]
    for row in rows_of(options.instances, options.seed, options.seconds, tables):
        print(json.dumps(row, indent=1), flush=True)


if __name__ == "__main__":
    main()
