"""Tables that grow: the array in closed loop on one, three and ten buses of 18 cells.

A box is steered in the middle, and gateways forward the states of cells at a border. The traffic of
a cell must not depend on the table's size. Counted are the bytes of data in frames that cells send,
and in frames that pass their filters: the mean of all cells and the most of one.
"""

import time
from contextlib import closing
from typing import Any

from mdms_array.host import coordinator_of
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes import CellBank
from mdms_sim.simulation import Simulation, addresses_of, open_bank

#: Columns and rows of the table, and of the block of cells on each bus.
TABLES = ((6, 3, 6, 3), (9, 6, 3, 6), (30, 6, 6, 3))
WARM_UP_S = 1.0
DURATION_S = 2.0
ROUNDS = 3


def tables() -> list[dict[str, Any]]:
    """Times real time, and bytes a second and cell, by size of the table."""
    return [table(*sizes) for sizes in TABLES]


def scenario_of(columns: int, rows: int, wide: int, high: int) -> Scenario:
    """A box steered in the middle of a table, with a bus for each block of cells."""
    blocks = [
        [(y + up) * columns + x + along + 1 for up in range(high) for along in range(wide)]
        for y in range(0, rows, high)
        for x in range(0, columns, wide)
    ]
    several = [f"array.buses={blocks}", "array.forwarded=[1]"] if len(blocks) > 1 else []
    return load_scenario("array18", [f"array.columns={columns}", f"array.rows={rows}", *several])


class Counted:
    """A bank whose cells' bytes are counted."""

    def __init__(self, bank: CellBank, cells: int) -> None:
        self.sent = [0] * cells
        self.received = [0] * cells
        self._bank = bank

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bank, name)

    def deliver(self, cell: int, frame: Frame) -> None:
        """Counts the bytes that a cell receives."""
        self.received[cell] += len(frame.data)
        self._bank.deliver(cell, frame)

    def collect(self, cell: int) -> list[Frame]:
        """Counts the bytes that a cell sends."""
        return self._count(cell, self._bank.collect(cell))

    def collect_all(self) -> list[tuple[int, list[Frame]]]:
        """The same of all."""
        return [(cell, self._count(cell, frames)) for cell, frames in self._bank.collect_all()]

    def _count(self, cell: int, frames: list[Frame]) -> list[Frame]:
        self.sent[cell] += sum(len(frame.data) for frame in frames)
        return frames


def table(columns: int, rows: int, wide: int, high: int) -> dict[str, Any]:
    """One line of the table."""
    scenario = scenario_of(columns, rows, wide, high)
    wall_s = min(lap(scenario)[0] for _ in range(ROUNDS))
    _, simulation, counted = lap(scenario, counted=True)
    cells, buses = columns * rows, len(simulation.buses)
    return {
        "name": f"{cells} cells on {buses} bus{'es' if buses > 1 else ''} in closed loop",
        "ours": DURATION_S / wall_s,
        "peer": None,
        "ratio": None,
        "unit": "x real time",
        "load": max(bus.load() for bus in simulation.buses),
        "gateways": len(simulation.gateways),
        "dropped": sum(way.dropped for gate in simulation.gateways for way in gate.ways),
    } | {
        f"{what}_bytes_a_second_{kind}": take(each) / DURATION_S
        for what, each in (("sent", counted.sent), ("received", counted.received))
        for kind, take in (("mean", lambda each: sum(each) / cells), ("most", max))
    }


def lap(scenario: Scenario, *, counted: bool = False) -> tuple[float, Simulation, Any]:
    """Wall time of one run after its warm-up [s], the run, and its bank."""
    node_ids = addresses_of(scenario).node_ids
    with closing(open_bank("cpython", node_ids)) as cells:
        bank: Any = Counted(cells, len(node_ids)) if counted else cells
        simulation = Simulation(scenario, bank, [coordinator_of(scenario)])
        simulation.run_until(WARM_UP_S)
        if counted:
            bank.sent[:] = bank.received[:] = [0] * len(node_ids)
        start_s = time.perf_counter()
        simulation.run_until(WARM_UP_S + DURATION_S)
        return time.perf_counter() - start_s, simulation, bank
