"""A set of simulated cells: its interface, the condition and time of each cell, and bus off."""

from collections.abc import Container, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mdms_model.errors import Error
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Confinement, Controller, ErrorState
from mdms_sim.kernel import Kernel


class NodeError(Error):
    """The cells cannot run."""


class MicropythonMissing(NodeError):  # noqa: N818 - it says what is wrong
    """There is no MicroPython for this machine."""


class NodeDied(NodeError):  # noqa: N818 - it says what is wrong
    """The process of a cell has ended or reported an exception; `text` is its output."""

    def __init__(self, node_id: int, text: str) -> None:
        super().__init__(f"cell {node_id} has died: {text.strip() or 'it said nothing'}")
        self.node_id = node_id
        self.text = text


class NodeHangs(NodeError):  # noqa: N818 - it says what is wrong
    """The process of a cell gives no answer, and was ended; `text` is its output."""

    def __init__(self, node_id: int, limit_s: float, text: str) -> None:
        said = f": {text.strip()}" if text.strip() else ""
        super().__init__(
            f"cell {node_id} hangs: no answer for {limit_s:g} s; its process was ended{said}"
        )
        self.node_id = node_id
        self.text = text


class CellBank(Protocol):
    """Cells in lock step with the simulation, numbered from 0."""

    def accepts(self, cell: int) -> Container[int]:
        """The identifiers that the cell's acceptance filter lets through, now and later."""

    def deliver(self, cell: int, frame: Frame) -> None:
        """The frame has reached the cell."""

    def collect(self, cell: int) -> list[Frame]:
        """The frames that the cell has queued since the last collection."""

    def collect_all(self) -> list[tuple[int, list[Frame]]]:
        """The same of all cells that have something to send, in order."""

    def tick(
        self,
        counts: NDArray[np.int32],
        currents_ma: NDArray[np.int32],
        presence: NDArray[np.uint8],
    ) -> NDArray[np.int32]:
        """One control period of all cells, then their timers; the first call is time 0.

        `counts` are encoder counts and `currents_ma` motor currents, signed as the voltages, both
        of shape (n, 2), `presence` bits of shape (n,); returns the motor voltages [uV], shape
        (n, 2), which the caller may keep until the next tick.
        """

    @property
    def awake(self) -> NDArray[np.int32]:
        """Whether the bridges of each cell are awake (1) or sleep (0) since the last tick, (n,)."""

    @property
    def blinking(self) -> NDArray[np.bool_]:
        """Whether the LEDs of each cell show that this is the one meant, shape (n,)."""

    def set_supply(self, cell: int, supply_uv: int) -> None:
        """The motors' supply is so much from now on, as the cell measures it."""

    def set_place(self, cell: int, node_id: int) -> None:
        """The table tells the cell that it is where the node of this id belongs; 0: it is silent.

        A cell looks when it boots, and at each start.
        """

    def power_off(self, cell: int) -> None:
        """The cell stops at once, and its bridges sleep."""

    def hang(self, cell: int) -> None:
        """The cell's program stops, and its motors are left with the voltages of the last tick."""

    def restart(self, cell: int, node_id: int | None = None) -> None:
        """The cell starts anew with its saved settings, as `node_id` if that is given."""

    def set_bus_off(self, cell: int, off: bool) -> None:
        """The cell's CAN controller has gone bus off, or has come back."""

    def connect(self, cell: int, errors: Confinement) -> None:
        """The cell's CAN controller has these error counters, which the cell may report."""

    def set_drift(self, cell: int, drift_ppm: int) -> None:
        """The cell's clock and control periods run fast by so many parts in a million.

        In one step of 1 ms the cell then makes now and then two periods, which see the same counts,
        or, when it is slow, none: its voltages stay, and it looks after nothing.
        """

    def close(self) -> None:
        """Ends the cells."""


PPM = 1_000_000


class Conditions:
    """Cells start all well; those in `halted` do not run, and `frozen_uv` stays on their motors.

    The simulation goes in steps of 1 ms, of which `ticks` are over. A cell makes its control
    periods by its own clock, each in the first step that is not before it.
    """

    def __init__(self, cells: int) -> None:
        self.ticks = 0
        self.halted: dict[int, Sequence[int]] = {}
        #: The step from which on a clock runs as it does now, and the periods made before that.
        self._since = [0] * cells
        self._before = [0] * cells
        self._drift_ppm = [0] * cells
        self._special = False

    @property
    def plain(self) -> bool:
        """Whether all cells run, and make in every step the period of that number."""
        return not (self._special or self.halted)

    def turns(self) -> list[dict[int, int]]:
        """Which cells make a control period in this step, and the time their clocks show then [ms].

        The first item has those that make one at least, the second those that make another, and so
        on. A clock that is slow by 100 ppm leaves out one step in 10,000. A fast one makes two
        periods in one.
        """
        if self.plain:
            return [dict.fromkeys(range(len(self._since)), self.ticks)]
        turns: list[dict[int, int]] = []
        for cell in range(len(self._since)):
            if cell not in self.halted:
                made = range(self._made(cell, self.ticks - 1), self._made(cell, self.ticks))
                turns += [{} for _ in range(len(made) - len(turns))]
                for turn, time_ms in zip(turns, made, strict=False):
                    turn[cell] = time_ms
        return turns

    def _made(self, cell: int, step: int) -> int:
        """How many periods the cell has made when `step` is over; the first at once."""
        elapsed = step - self._since[cell]
        if elapsed < 0:
            return 0
        return self._before[cell] + 1 + elapsed + elapsed * self._drift_ppm[cell] // PPM

    def halt(self, cell: int, frozen_uv: Sequence[int]) -> None:
        """The cell runs no more; its motors are left with these voltages."""
        self.halted[cell] = frozen_uv

    def restart(self, cell: int) -> None:
        """The cell runs again, and its clock starts anew."""
        self.halted.pop(cell, None)
        self._since[cell] = self.ticks
        self._before[cell] = 0
        self._special = True

    def set_drift(self, cell: int, drift_ppm: int) -> None:
        """The cell's clock runs so much fast from now on."""
        if self._since[cell] < self.ticks:
            last = self.ticks - 1
            self._before[cell], self._since[cell] = self._made(cell, last) - 1, last
        self._drift_ppm[cell] = drift_ppm
        self._special = True


#: As the boards have it (`BUS_OFF_MS` in firmware/boards/bus.py).
RESTART_NS = 100_000_000
PRIORITY = 5


class Boards(Protocol):
    """The owner of the controllers: a bank of cells, a gateway."""

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
