"""Cells in this process on a bus that other programs reach."""

import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager

from mdms_model.scenario.file import load_scenario
from mdms_sim.nodes import CellBank
from mdms_sim.serve.server import Server
from mdms_sim.simulation import Simulation


@contextmanager
def serving(
    bank: CellBank, channel: str, scenario: str = "array18", *overrides: str
) -> Iterator[Simulation]:
    """Serves the bank of a scenario's cells in real time, and closes it at the end."""
    over = threading.Event()
    with closing(bank):
        simulation = Simulation(load_scenario(scenario, overrides), bank, recording=None)
        with Server(simulation, channel) as server:
            thread = threading.Thread(target=server.run, args=(over.is_set,))
            thread.start()
            try:
                yield simulation
            finally:
                over.set()
                thread.join()
