"""Runs the benchmarks and prints one table: ours beside a peer in the same run.

`python -m tests.benchmarks [NAME ...]`: each NAME is a module somewhere below this folder
that has `run()`, which returns rows with `name`, `ours`, `peer` (or None), `ratio` (or None),
`unit` and whatever else is of use. One NAME may be followed by options, which its `run` takes as a
list. The exit code is 1 where a row has `failed`.
Everything goes into `build/bench.json` as well.
"""

import json
import platform
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RESULT = Path("build/bench.json")

Row = dict[str, Any]


def available() -> dict[str, str]:
    """Modules of all benchmarks by their names."""
    paths = Path(__file__).parent.rglob("*.py")
    return {
        path.stem: ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in sorted(paths, key=lambda path: path.stem)
        if not path.stem.startswith("_")
    }


def figure(value: object) -> str:
    """A number in four digits, a dash for none."""
    if value is None:
        return "-"
    return f"{value:,.4g}" if isinstance(value, int | float) else str(value)


def print_rows(rows: list[Row]) -> None:
    """One line a row; keys that are no column stand behind it."""
    for row in rows:
        rest = {
            key: value
            for key, value in row.items()
            if key not in ("name", "ours", "peer", "ratio", "unit", "failed")
        }
        notes = "  ".join(f"{key}={figure(value)}" for key, value in rest.items())
        print(
            f"  {row['name']:<52} {figure(row.get('ours')):>11} {figure(row.get('peer')):>11} "
            f"{figure(row.get('ratio')):>9} {row.get('unit', ''):<12} {notes}",
            flush=True,
        )


def main(arguments: list[str]) -> int:
    """Run the named benchmarks, or all."""
    modules = available()
    first = next((k for k, one in enumerate(arguments) if one.startswith("-")), len(arguments))
    names, options = arguments[:first], arguments[first:]
    if options and len(names) != 1:
        print("options are for one benchmark; name it before them")
        return 2
    unknown = sorted(set(names) - set(modules))
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(modules)}")
        return 2
    results: dict[str, list[Row]] = {}
    for name in names or modules:
        print(f"{name:<54} {'ours':>11} {'peer':>11} {'ratio':>9}", flush=True)
        results[name] = import_module(modules[name]).run(*([options] if options else []))
        print_rows(results[name])
    RESULT.parent.mkdir(exist_ok=True)
    machine = {"python": platform.python_version(), "machine": platform.machine()}
    RESULT.write_text(json.dumps({"machine": machine, "results": results}, indent=2) + "\n")
    print(f"written to {RESULT}")
    return int(any(row.get("failed") for rows in results.values() for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
