"""The same scenario and seed give the same bytes on the bus, whatever else differs."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mdms_host.cli.exits import Exit

MDMS = Path(sys.executable).with_name("mdms")


def run_of(*arguments, hash_seed="0", scenario="array18", duration_s=1.2):
    """What comes over the bus, and where parcels are, in a run in a process of its own."""
    short = ("--set", f"run.duration_s={duration_s}")
    done = subprocess.run(
        [str(MDMS), "simulate", scenario, *short, "--json", *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONHASHSEED": hash_seed},
    )
    # So short a run ends before the box is at its goal.
    assert done.returncode == Exit.TIME_LIMIT
    return told(done.stdout)


def told(printed):
    figures = json.loads(printed)
    return {name: figures[name] for name in ("bus", "parcels")}


@pytest.fixture(scope="module")
def first():
    return run_of()


def test_another_process_with_another_order_of_sets_gives_the_same(first):
    assert run_of(hash_seed="1") == first


def test_kind_of_cells_that_steer_has_no_say():
    """The box is under way after 1.6 s, led by cells that have found and agreed where it is."""
    by_cells = {"scenario": "neighbours", "duration_s": 1.8}
    assert run_of("--nodes", "micropython", **by_cells) == run_of(**by_cells)


def test_runs_at_the_same_time_do_not_touch_each_other(first):
    command = [str(MDMS), "simulate", "array18", "--set", "run.duration_s=1.2", "--json"]
    runs = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    assert [told(run.communicate()[0]) for run in runs] == [first] * 2


def test_another_seed_gives_other_bytes(first):
    assert run_of("--seed", "2")["bus"]["log_sha256"] != first["bus"]["log_sha256"]
