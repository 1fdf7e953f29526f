"""Storms by seed: how often each rule of the referee is broken, and how runs end.

`python -m tests.benchmarks storms --cases N --seed S [--jobs J]` runs the storms of the seeds S to
S + N - 1. With `--cuts` cells steer, and the only trouble is a cell that is cut off for 1 s. Parts
with other seeds can be added. `bound` is the upper end of a one-sided 95 %
confidence interval of the share of storms that break a rule. The exit code is 1 where a rule of
safety is broken. A storm that is neither reached nor explained runs again without its troubles. If
its job is not done then either, it has no way for it, and counts in a row of its own.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import repeat
from math import comb, exp, log, log1p
from multiprocessing import get_context
from time import perf_counter
from typing import Any, NamedTuple

from tests.storms.draw import draw, draw_cut
from tests.storms.run import Ended
from tests.storms.run import run as run_storm

from mdms_sim.referee.rules import RULES

__all__ = ["run"]

CONFIDENCE = 0.95
#: A line of progress comes after so many storms.
SHOWN = 25


class Case(NamedTuple):
    """A storm and how it ended, and whether its job can be done without troubles."""

    seed: int
    setting: str
    ended: Ended
    possible: bool


def case(seed: int, cuts: bool = False) -> Case:
    """Draw and run one."""
    storm = draw_cut(seed) if cuts else draw(seed)
    ended = run_storm(storm)
    possible = ended.reached or ended.explained
    if not possible:
        possible = run_storm(replace(storm.with_faults(()), events=())).reached
    return Case(seed, storm.tables["title"].partition(": ")[2], ended, possible)


def cases(seeds: range, jobs: int, cuts: bool) -> Iterator[Case]:
    """Run the storms of these seeds, in their order."""
    if jobs == 1:
        yield from map(case, seeds, repeat(cuts))
        return
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        yield from pool.map(case, seeds, repeat(cuts))


def at_most(found: int, cases: int) -> float:
    """Upper bound of a share, one-sided, by Clopper and Pearson."""
    low, high = found / cases, 1.0
    for _ in range(50 if found < cases else 0):
        share = (low + high) / 2
        tail = sum(
            exp(log(comb(cases, k)) + k * log(share) + (cases - k) * log1p(-share))
            for k in range(found + 1)
        )
        low, high = (low, share) if tail < 1 - CONFIDENCE else (share, high)
    return high


def row(name: str, seeds: list[int], count: int, *, unit: str, **more: Any) -> dict[str, Any]:
    """A row of the table: in how many storms, of how many, and at most in what share."""
    return {
        "name": name,
        "ours": len(seeds),
        "peer": None,
        "ratio": None,
        "unit": unit,
        "cases": count,
        "bound": at_most(len(seeds), count),
        **more,
        "seeds": " ".join(map(str, seeds)) or None,
    }


def run(arguments: list[str] | None = None) -> list[dict[str, Any]]:
    """A row for each rule, then for how runs ended."""
    parser = argparse.ArgumentParser("python -m tests.benchmarks storms")
    parser.add_argument("--cases", type=int, default=20, help="number of storms")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--cuts", action="store_true", help="nothing but cells that are cut off")
    options = parser.parse_args(arguments or [])
    begun_s = perf_counter()
    seeds = range(options.seed, options.seed + options.cases)
    print(
        f"seeds {seeds[0]} to {seeds[-1]}; bounds one-sided, {CONFIDENCE:.0%}; "
        f"{options.jobs} processes",
        flush=True,
    )
    done = []
    for one in cases(seeds, options.jobs, options.cuts):
        done.append(one)
        if len(done) % SHOWN == 0:
            print(f"  {len(done)} of {len(seeds)} in {perf_counter() - begun_s:.0f} s", flush=True)
        for line in _remarks(one):
            print(f"  storm {one.seed}, {one.setting}: {line}", flush=True)
    wall_s = perf_counter() - begun_s
    lasted_s = sum(one.ended.lasted_s for one in done)
    print(f"{lasted_s:.0f} s simulated in {wall_s:.0f} s", flush=True)
    return list(rows(done))


def _remarks(one: Case) -> Iterator[str]:
    """The violations in the order of time: the first violation of each rule."""
    seen: set[str] = set()
    for each in one.ended.violations:
        if each.rule not in seen:
            seen.add(each.rule)
            where = f"cell {each.cell}, " if each.cell else ""
            yield f"{each.rule} at {each.time_s:.3f} s: {where}{each.text}"
    if one.ended.crash:
        yield f"crash: {one.ended.crash.strip().splitlines()[-1]}"


def rows(done: list[Case]) -> Iterator[dict[str, Any]]:
    """The table."""
    count = len(done)
    for rule in RULES.values():
        broken = [one.seed for one in done if rule.name in one.ended.rules]
        yield row(rule.name, broken, count, unit="storms", failed=rule.safety and bool(broken))
    crashed = [one.seed for one in done if one.ended.crash]
    yield row("crash", crashed, count, unit="storms", failed=bool(crashed))
    impossible = [one.seed for one in done if not one.possible]
    yield row("its job has no way without troubles either", impossible, count, unit="storms")
    done = [one for one in done if one.possible]
    count = len(done)
    unclear = [one.seed for one in done if not (one.ended.reached or one.ended.explained)]
    reached = sum(one.ended.reached for one in done)
    yield row("neither reached nor explained", unclear, count, unit="storms")
    yield {
        "name": "goals reached, or the reason names a trouble",
        "ours": 100 * (count - len(unclear)) / count,
        "peer": None,
        "ratio": None,
        "unit": "%",
        "reached": reached,
        "cases": count,
    }
