"""Makes a storm smaller that breaks a rule: fewer troubles, then fewer parcels, then less time.

`python -m tests.storms.shrink SEED [RULE]` prints the smallest storm found that still breaks the
rule (or the first that the storm breaks); a file in place of a seed is read.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any

from mdms_model.errors import InputError
from tests.storms.draw import draw
from tests.storms.run import report, run
from tests.storms.storm import Storm, Table, load, parts_of, scenario_of, written

Fails = Callable[[Storm], bool]


def shrink(storm: Storm, fails: Fails) -> Storm:
    """A smaller storm that still fails, by plain bisection."""
    storm = _with_parts(
        storm, _fewest(parts_of(storm), lambda kept: fails(_with_parts(storm, kept)))
    )
    if "stream" not in storm.tables:
        parcels = list(storm.tables["parcel"])
        kept = _fewest(parcels, lambda some: bool(some) and fails(_with_parcels(storm, some)))
        storm = _with_parcels(storm, kept)
    return _shorter(storm, fails)


def _fewest(items: Sequence[Any], fails: Callable[[list[Any]], bool]) -> list[Any]:
    """Some of the items with which it fails: halves are left out, then quarters, then one."""
    kept = list(items)
    size = ceil(len(kept) / 2)
    while kept and size:
        for start in range(0, len(kept), size):
            rest = kept[:start] + kept[start + size :]
            if fails(rest):
                kept = rest
                break
        else:
            size = 0 if size == 1 else ceil(size / 2)
            continue
        size = min(size, max(1, len(kept)))
    return kept


def _with_parts(storm: Storm, parts: Sequence[tuple[str, Table]]) -> Storm:
    faults = tuple(part for where, part in parts if where == "fault")
    events = tuple(part for where, part in parts if where == "event")
    return replace(storm.with_faults(faults), events=events)


def _with_parcels(storm: Storm, parcels: Sequence[Table]) -> Storm:
    """The storm with some of its parcels, and with what concerns no others."""
    names = {parcel["name"] for parcel in parcels}

    def stays(table: Table) -> bool:
        named = {table["parcel"]} if "parcel" in table else set()
        return named | set(table.get("parcels", ())) <= names

    tables = dict(storm.tables) | {"parcel": list(parcels)}
    if "task" in tables:
        tables["task"] = [task for task in tables["task"] if stays(task)]
        if tables["task"] and tables["task"][0].get("beside"):
            first = {key: value for key, value in tables["task"][0].items() if key != "beside"}
            tables["task"] = [first, *tables["task"][1:]]
    smaller = replace(storm, tables=tables)
    return _with_parts(smaller, [part for part in parts_of(storm) if stays(part[1])])


def _shorter(storm: Storm, fails: Fails) -> Storm:
    """The storm with less time, in steps of a quarter."""
    while True:
        run_table = dict(storm.tables["run"])
        run_table["duration_s"] = round(0.75 * run_table["duration_s"], 2)
        shorter = replace(storm, tables=dict(storm.tables) | {"run": run_table})
        if run_table["duration_s"] < 1.0 or not fails(shorter):
            return storm
        storm = shorter


def breaking(rule: str) -> Fails:
    """Whether a storm is legal and breaks a rule; `crash` stands for an exception."""

    def fails(storm: Storm) -> bool:
        try:
            scenario_of(storm)
        except InputError:
            return False
        ended = run(storm)
        broken = ended.crash is not None if rule == "crash" else rule in ended.rules
        print(
            f"{len(parts_of(storm))} troubles, {len(storm.tables['parcel'])} parcels: "
            f"{'still' if broken else 'no more'}",
            file=sys.stderr,
            flush=True,
        )
        return broken

    return fails


def main(arguments: list[str]) -> None:
    """Shrink one storm and print it."""
    path = Path(arguments[0])
    storm = load(path.read_text("utf-8")) if path.exists() else draw(int(arguments[0]))
    first = run(storm)
    rule = arguments[1] if len(arguments) > 1 else "crash" if first.crash else None
    rule = rule or (first.violations[0].rule if first.violations else None)
    if rule is None:
        print(*report(storm, first), sep="\n")
        return
    smallest = shrink(storm, breaking(rule))
    print(written(smallest))
    print(*(f"# {line}" for line in report(smallest, run(smallest))), sep="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
