"""The same scenario and seed give the same bytes on the bus, whatever else differs."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.micropython_builds import skipping_without_micropython

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_sim.nodes.micropython_process import find_micropython

MDMS = Path(sys.executable).with_name("mdms")


#: The box is carried from half a second on, and so short a run ends before it is at its goal.
BY_HOST = ["simulate", "array18", "--json", "--set", "run.duration_s=1.0"]
#: The box is under way after 0.8 s, led by cells that have found and agreed where it is.
BY_CELLS = ["simulate", "neighbours", "--json", "--set", "run.duration_s=1.4"]
BY_CELLS += ["--set", "array.columns=4"]


@pytest.fixture
def run_of(capsys):
    """The traffic of the bus, and the places of parcels."""

    def run(command, *arguments, nodes="cpython"):
        assert main([*command, "--nodes", nodes, *arguments]) == ExitCode.TIME_LIMIT
        printed = capsys.readouterr().out
        assert json.loads(printed)["nodes"] == nodes
        return told(printed)

    return run


def told(printed):
    figures = json.loads(printed)
    return {name: figures[name] for name in ("bus", "parcels")}


def test_processes_at_the_same_time_with_other_orders_of_sets_give_the_same(run_of):
    runs = [
        subprocess.Popen(
            [str(MDMS), *BY_HOST],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONHASHSEED": hash_seed},
        )
        for hash_seed in "01"
    ]
    assert [told(run.communicate()[0]) for run in runs] == [run_of(BY_HOST)] * 2


@pytest.mark.parametrize("command", [BY_HOST, BY_CELLS], ids=["by host", "by cells"])
def test_kind_of_cells_has_no_say(run_of, command):
    with skipping_without_micropython():
        find_micropython()
    assert run_of(command, nodes="micropython") == run_of(command)


def test_another_seed_gives_other_bytes(run_of):
    one, other = (run_of(BY_HOST, "--seed", seed) for seed in "12")
    assert one["bus"]["log_sha256"] != other["bus"]["log_sha256"]


@given(st.tuples(*[st.integers()] * 20))
def law(numbers):
    """It holds for all, and keeps the examples."""
    EXAMPLES.append(numbers)


EXAMPLES = []


def test_a_law_is_tried_on_the_same_examples_whatever_is_loaded(tmp_path, monkeypatch):
    law()
    before = EXAMPLES.copy()
    EXAMPLES.clear()
    numbers = "".join(f"A{number} = {7919 * number}\n" for number in range(1, 60))
    (tmp_path / "loaded_by_another.py").write_text(numbers)
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("loaded_by_another")
    law()
    assert len(before) > 10
    assert before == EXAMPLES
