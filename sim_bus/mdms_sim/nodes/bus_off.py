"""What boards do when their CAN controller goes bus off: report it, wait, start again."""

from collections.abc import Sequence
from typing import Protocol

from mdms_sim.bus.bus import Bus
from mdms_sim.bus.confinement import ErrorState
from mdms_sim.bus.controller import Controller
from mdms_sim.kernel import Kernel

#: As the boards have it (`BUS_OFF_MS` in firmware/boards/bus.py).
RESTART_NS = 100_000_000
PRIORITY = 5


class Boards(Protocol):
    """What has the controllers: a bank of cells, a gateway."""

    def set_bus_off(self, cell: int, off: bool) -> None:
        """That controller, numbered from 0, has gone bus off, or has come back."""


class BusOffWatch:
    """Looks after those of the controllers, numbered from 0, that are on this bus."""

    def __init__(
        self, kernel: Kernel, bus: Bus, controllers: Sequence[Controller], bank: Boards
    ) -> None:
        self._kernel = kernel
        self._bus = bus
        self._bank = bank
        self._cells = {controller: cell for cell, controller in enumerate(controllers)}
        self._off: set[int] = set()
        bus.observe_states(self._on_state)

    def _on_state(self, controller: Controller, now_ns: int) -> None:
        cell = self._cells.get(controller)
        if cell is None:
            return
        if controller.state is ErrorState.BUS_OFF:
            self._off.add(cell)
            self._bank.set_bus_off(cell, True)
            controller.drop_queue()
            self._kernel.at(now_ns + RESTART_NS, PRIORITY, lambda: self._restart(cell, controller))
        elif cell in self._off:
            self._off.remove(cell)
            self._bank.set_bus_off(cell, False)

    def _restart(self, cell: int, controller: Controller) -> None:
        if cell in self._off and controller.state is ErrorState.BUS_OFF:
            self._bus.recover(controller)
