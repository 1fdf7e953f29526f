"""`mdms commission` on a bus of firmware cells in virtual time."""

import pytest
from tests.host.cli.commission.on_the_table import ORDER
from tests.virtual_array import StandingArray, virtual_time

from mdms_host.cli import main
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.network import Commissioning
from mdms_sim.nodes.python_bank import PythonBank


@pytest.fixture
def cells(request):
    """Cells whose wheels stand, in virtual time; blank ones, or three."""
    node_ids = getattr(request, "param", (1, 2, 3))
    with virtual_time(StandingArray(PythonBank(node_ids), len(node_ids))) as ready:
        yield ready


@pytest.fixture
def commission(cells, tmp_path):
    """Runs the verb; the array file goes to `array.toml` in the test's folder."""

    def run(*arguments, out=True):
        files = ("--out", tmp_path / "array.toml") if out else ()
        return main(["commission", *map(str, (*arguments, *files)), "-i", "virtual"])

    return run


@pytest.fixture
def listed(tmp_path):
    path = tmp_path / "list.txt"
    path.write_text("".join(f"{serial:08X}\n" for serial in ORDER))
    return path


@pytest.fixture
def bus(cells):
    """The cells by another master."""
    with Commissioning(None, MonotonicClock()) as ready:
        yield ready
