"""The host's files and functions that run in a steady control cycle of `array18`.

A box is under way for 0.1 s, by a program and by the goal of the scenario. Fewer files and
functions are easier to follow. Comprehensions and other nameless code are left out.
"""

import sys
from contextlib import closing
from pathlib import Path
from types import FrameType
from typing import Any

import mdms_host
from mdms_array.host import coordinator_of
from mdms_host.programs.program import Main
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import Simulation, addresses_of, open_bank

FOLDER = str(Path(mdms_host.__file__).parent)
UNDER_WAY_S = 0.8
WATCHED_S = 0.1


async def carry(table: Any) -> None:
    """A job of one move."""
    await table["box"].move(0.10, 0.0, 0.2)


def run() -> list[dict[str, Any]]:
    """A row for each way to order a move."""
    return [_row("by a program", carry), _row("by the scenario's goal", None)]


def _row(name: str, main: Main | None) -> dict[str, Any]:
    scenario = load_scenario("array18")
    called: set[tuple[str, str]] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(FOLDER) and code.co_name[0] != "<":
            called.add((code.co_filename, code.co_qualname))

    with closing(open_bank("cpython", addresses_of(scenario).node_ids)) as bank:
        simulation = Simulation(
            scenario, bank, [coordinator_of(scenario, main=main)], recording=None
        )
        simulation.run_until(UNDER_WAY_S)
        sys.setprofile(note)
        simulation.run_until(UNDER_WAY_S + WATCHED_S)
        sys.setprofile(None)
    files = {file for file, _ in called}
    return {"name": name, "ours": len(files), "unit": "files", "functions": len(called)}
