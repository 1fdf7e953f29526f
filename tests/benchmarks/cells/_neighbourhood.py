"""The costs of one cell of a growing table: time, memory and bytes of a cell that steers.

A box goes over the cell in the middle of 18, 54 and 180 cells, at the same speed and at the same
places about it, so that the traffic of its neighbourhood is the same. Counted over the beats in
which it lies there are the processor time in that cell, the least of some rounds; the calls of
Python functions, which no other load of the machine changes; the bytes of data in frames that it
sends and takes; and the memory of all objects that only this cell has.
"""

import gc
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from tests.benchmarks.sim_bus._tables import TABLES, Counted
from tests.system.cells.neighbour_host import BEAT_S, Box, NeighbourHost, scenario_of

from mdms_array.host import layout_of
from mdms_cell.cell import Cell
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation, addresses_of

SIZE_M = 0.28
PITCH_M = 0.127
#: The box goes so far before and beyond the cell.
WAY_M = 0.14
#: It moves from about 1.0 s on, and lies over the cell's middle in this time.
BEGIN_S, END_S = 1.5, 2.5
ROUNDS = 3
#: Code, and the registers of all cells, of which each has one row.
_SHARED = (ModuleType, FunctionType, BuiltinFunctionType, CodeType, type, np.ndarray)


class Watched:
    """A cell whose time and calls are counted while `counting`."""

    def __init__(self, cell: Cell, *, by_calls: bool) -> None:
        self.counting = False
        self.spent_s = 0.0
        self.calls = 0
        self._cell = cell
        self._by_calls = by_calls

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cell, name)

    def on_frame(self, can_id: int, data: bytes, now_ms: int) -> None:
        """Take a frame."""
        self._timed(self._cell.on_frame, can_id, data, now_ms)

    def poll(self, now_ms: int) -> None:
        """Make a turn of the background loop."""
        self._timed(self._cell.poll, now_ms)

    def _timed(self, function: Callable[..., object], *arguments: object) -> None:
        if not self.counting:
            function(*arguments)
        elif self._by_calls:
            sys.setprofile(self._on_event)
            try:
                function(*arguments)
            finally:
                sys.setprofile(None)
        else:
            start_s = time.process_time()
            function(*arguments)
            self.spent_s += time.process_time() - start_s

    def _on_event(self, _frame: object, event: str, _argument: object) -> None:
        self.calls += event == "call"


def neighbourhoods() -> Iterator[dict[str, Any]]:
    """A row for each size of the table."""
    for columns, rows, *_ in TABLES:
        least_s = min(lap(columns, rows)[0].spent_s for _ in range(ROUNDS))
        watched, counted, memory_bytes = lap(columns, rows, by_calls=True)
        beats = round((END_S - BEGIN_S) / BEAT_S)
        middle = middle_of(columns, rows)
        yield {
            "name": f"a cell that steers, in the middle of {columns * rows}",
            "ours": 1e6 * least_s / beats,
            "peer": None,
            "ratio": None,
            "unit": "us/beat",
            "calls_a_beat": watched.calls / beats,
            "memory_bytes": memory_bytes,
            "sent_bytes_a_beat": counted.sent[middle] / beats,
            "received_bytes_a_beat": counted.received[middle] / beats,
        }


def middle_of(columns: int, rows: int) -> int:
    """The cell in the middle, from 0; of four the one at the lower left."""
    return (rows - 1) // 2 * columns + (columns - 1) // 2


def lap(columns: int, rows: int, *, by_calls: bool = False) -> tuple[Watched, Counted, int]:
    """One run: the middle cell's effort, the bytes of all cells, and the middle cell's memory."""
    middle = middle_of(columns, rows)
    x_m = (middle % columns - (columns - 1) / 2) * PITCH_M
    y_m = (middle // columns - (rows - 1) / 2) * PITCH_M
    box = Box((x_m - WAY_M, y_m, 0.0), (x_m + WAY_M, y_m, 0.0), SIZE_M, SIZE_M)
    scenario = scenario_of([box], columns, rows)
    layout = layout_of(scenario)
    node_ids = addresses_of(scenario).node_ids
    with closing(PythonBank(node_ids)) as bank:
        watched = Watched(bank._cells[middle], by_calls=by_calls)
        bank._cells[middle] = watched
        counted = Counted(bank, len(node_ids))
        simulation = Simulation(scenario, counted, [NeighbourHost(layout, [box])], recording=None)
        simulation.run_until(BEGIN_S)
        counted.sent[:] = counted.received[:] = [0] * len(node_ids)
        gc.collect()
        watched.counting = True
        simulation.run_until(END_S)
        return watched, counted, own_bytes(watched._cell)


def own_bytes(cell: Cell) -> int:
    """Size of a cell and of all objects that it refers to, without its code and its board."""
    seen = {id(cell._board)}
    waiting: list[Any] = [cell]
    total = 0
    while waiting:
        one = waiting.pop()
        if id(one) in seen or isinstance(one, _SHARED):
            continue
        seen.add(id(one))
        total += sys.getsizeof(one)
        waiting += gc.get_referents(one)
    return total
