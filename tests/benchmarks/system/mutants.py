"""Mutants: the share of small wrong changes of the code that tests notice, by cosmic-ray.

`python -m tests.benchmarks mutants [--part PART] [--cases N] [--seed S]` draws N places of a part
from the seed, and one change at each. A copy of the project gets the changes, one at a time. Tests
run until the first fails. Survivors are printed: they are tests that are missing, or changes that
alter nothing that anybody can see. `killed` is the share of all, `bound` the lower end of its
one-sided 95 % confidence interval (Clopper and Pearson).
"""

import argparse
import os
import random
import shutil
import sqlite3
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from tests.benchmarks.cells.neighbours import at_least

ROOT = Path(__file__).parents[3]
TIME_LIMIT_S = 600.0
#: The operator that removes decorators: those of a cell only compile, so nothing would change.
COMPILING = "core/RemoveDecorator"
#: Files that a copy of the project does without.
LEFT_OUT = (".git", ".venv", "build", "typings", ".*_cache", "__pycache__")


class Part(NamedTuple):
    """Folders of the code, and those of the tests that are to notice: the fastest first."""

    code: tuple[str, ...]
    tests: tuple[str, ...]


FIRMWARE = "tests/firmware/"
PARTS = {
    "cell": Part(
        ("firmware/mdms_cell",),
        (
            "tests/both",
            *(FIRMWARE + each for each in ("neighbours", "drive", "test_canopen.py", "fail_safe")),
        ),
    ),
    "host": Part(
        ("host/mdms_host/coordination", "host/mdms_host/estimation"),
        ("tests/host/coordination", "tests/host/estimation"),
    ),
    "programs": Part(
        ("host/mdms_host/routes", "host/mdms_host/programs"),
        ("tests/host/programs", "tests/host/routes"),
    ),
    "physics": Part(("sim_bus/mdms_sim/physics",), ("tests/sim_bus/physics",)),
}


def run(options: list[str] | None = None) -> list[dict[str, Any]]:
    """The rows of the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks mutants")
    parser.add_argument("--part", choices=PARTS, action="append")
    parser.add_argument("--cases", type=int, default=75)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(options or [])
    return [row(name, given.cases, given.seed) for name in given.part or PARTS]


def row(name: str, cases: int, seed: int) -> dict[str, Any]:
    """Draw the mutants of a part, run them, and print the survivors."""
    part = PARTS[name]
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*LEFT_OUT))
        session = Session(copy, part)
        session.draw(cases, seed)
        session.run()
        outcomes = session.outcomes()
    for outcome, place, change in outcomes:
        if outcome != "KILLED":
            print(f"  {outcome.lower()} {place}\n{change}", flush=True)
    killed = sum(outcome == "KILLED" for outcome, _, _ in outcomes)
    return {
        "name": f"{name}: mutants killed",
        "ours": killed,
        "unit": f"of {len(outcomes)}",
        "killed": killed / len(outcomes),
        "bound": at_least(killed, len(outcomes)),
        "seed": seed,
    }


class Session:
    """A session of cosmic-ray over a copy of the project."""

    def __init__(self, copy: Path, part: Part) -> None:
        self._copy = copy
        self._config, self._file = copy / "mutants.toml", copy / "mutants.sqlite"
        self._config.write_text(
            "[cosmic-ray]\n"
            f"module-path = {[*part.code]}\n"
            f"timeout = {TIME_LIMIT_S}\n"
            "excluded-modules = []\n"
            f"test-command = '{sys.executable} -m pytest -q -x -n0 -p no:cacheprovider "
            f"{' '.join(part.tests)}'\n"
            "[cosmic-ray.distributor]\n"
            "name = 'local'\n"
        )
        self._call("init", self._config, self._file)

    def draw(self, cases: int, seed: int) -> None:
        """Leave so many mutants, each at a place of its own."""
        places: dict[Any, list[str]] = defaultdict(list)
        with sqlite3.connect(self._file) as file:
            for job, *place in file.execute(
                "SELECT job_id, module_path, start_pos_row, start_pos_col FROM mutation_specs "
                "WHERE operator_name != ? ORDER BY operator_name, operator_args, occurrence",
                (COMPILING,),
            ):
                places[tuple(place)].append(job)
            drawn = random.Random(seed)
            kept = [drawn.choice(places[place]) for place in drawn.sample(sorted(places), cases)]
            marks = ", ".join("?" * len(kept))
            for table in ("mutation_specs", "work_items"):
                file.execute(f"DELETE FROM {table} WHERE job_id NOT IN ({marks})", kept)

    def run(self) -> None:
        """Have the tests run on the code as it is, which is to pass, and on each mutant."""
        self._call("baseline", self._config)
        self._call("exec", self._config, self._file)

    def outcomes(self) -> list[tuple[str, str, str]]:
        """The outcome of each mutant, its place, and the changed lines."""
        with sqlite3.connect(self._file) as file:
            rows = file.execute(
                "SELECT test_outcome, module_path, start_pos_row, diff FROM mutation_specs "
                "JOIN work_results USING (job_id) ORDER BY module_path, start_pos_row"
            ).fetchall()
        return [
            (outcome, f"{path}:{line}", "\n".join(changed_lines(diff or "")))
            for outcome, path, line, diff in rows
        ]

    def _call(self, verb: str, *arguments: Path) -> None:
        packages = ("firmware", "host", "protocol", "sim_bus", ".")
        path = os.pathsep.join(str(self._copy / each) for each in packages)
        subprocess.run(
            [sys.executable, "-m", "cosmic_ray.cli", verb, *map(str, arguments)],
            cwd=self._copy,
            env={**os.environ, "PYTHONPATH": path},
            check=True,
        )


def changed_lines(diff: str) -> list[str]:
    """The lines of a difference that it takes away or puts in."""
    heads = ("---", "+++")
    return [
        f"    {each}" for each in diff.splitlines() if each[:1] in "+-" and each[:3] not in heads
    ]
