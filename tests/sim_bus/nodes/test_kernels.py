"""Compiled kernels of a cell: all of them, each with the results of the plain function."""

import re
import sys
from array import array
from collections import Counter
from contextlib import closing
from pathlib import Path

import pytest

import mdms_cell
import mdms_protocol
from mdms_array.host import coordinator_of
from mdms_cell.drive import speed_loop
from mdms_model.compiled import COMPILING
from mdms_model.scenario.file import load_scenario
from mdms_sim.nodes.kernels import KERNEL_PACKAGES, plain
from mdms_sim.simulation import Simulation, addresses_of, open_bank

pytestmark = pytest.mark.skipif(not COMPILING, reason="nothing is compiled")

MODULE_LEVEL = re.compile(r"^@micropython\.viper\ndef (\w+)", re.MULTILINE)
#: Calls of one kernel that are compared; they are spread over the run.
COMPARED = 400
EVERY = 29


def sources():
    """Names of modules and their texts."""
    for package in (mdms_cell, mdms_protocol):
        folder = Path(package.__path__[0])
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder.parent).with_suffix("").parts
            yield ".".join(parts), path.read_text("utf-8")


def kernels():
    """All functions for viper that cells call, by module and name."""
    return {
        (module, name): getattr(sys.modules[module], name)
        for module, text in sources()
        for name in MODULE_LEVEL.findall(text)
        if module != speed_loop.__name__
    }


@pytest.fixture(autouse=True)
def bank():
    """The kernels are compiled for the first cells."""
    scenario = load_scenario("neighbours")
    with closing(open_bank("cpython", addresses_of(scenario).node_ids)) as bank:
        yield bank


def test_all_kernels_of_a_cell_are_compiled():
    assert len(kernels()) >= 14
    assert [at for at, kernel in kernels().items() if not hasattr(kernel, "py_func")] == []


def copied(argument):
    """An argument of a kernel, for a call that may change it."""
    return argument[:] if isinstance(argument, array | bytearray) else argument


@pytest.mark.compiles
def test_kernels_give_the_results_of_the_plain_functions(bank, monkeypatch):
    calls: Counter[tuple[str, str]] = Counter()
    wrong = []

    def comparing(at, kernel):
        def call(*arguments):
            calls[at] += 1
            if calls[at] > COMPARED and calls[at] % EVERY:
                return kernel(*arguments)
            others = [copied(each) for each in arguments]
            expected = plain(kernel)(*others)
            result = kernel(*arguments)
            if result != expected or list(arguments) != others:
                wrong.append((at, others, expected))
            return result

        return call

    for at, kernel in kernels().items():
        call = comparing(at, kernel)
        for name, module in list(sys.modules.items()):
            if name.startswith(KERNEL_PACKAGES):
                for attribute, value in list(vars(module).items()):
                    if value is kernel:
                        monkeypatch.setattr(module, attribute, call)
    scenario = load_scenario("neighbours")
    Simulation(scenario, bank, [coordinator_of(scenario)]).run_until(4.0)
    assert wrong == []
    # All but those that only other kernels call.
    assert {name for (_, name), number in calls.items() if number > COMPARED} >= {
        *("fit", "read_estimates", "points_within", "squares_overlapped", "root"),
        *("_take_in", "_stays_under", "_clear_the_wheels", "directions_having", "pack_estimate"),
    }
