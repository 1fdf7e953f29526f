"""What the simulation asks of a set of cells, whatever they run on."""

from collections.abc import Container
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mdms_model.errors import Error
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.confinement import Confinement


class NodeError(Error):
    """The cells cannot run."""


class MicropythonMissing(NodeError):  # noqa: N818 - it says what is wrong
    """There is no MicroPython for this machine."""


class NodeDied(NodeError):  # noqa: N818 - it says what is wrong
    """The process of a cell has ended or reported an exception; `text` is what it said."""

    def __init__(self, node_id: int, text: str) -> None:
        super().__init__(f"cell {node_id} has died: {text.strip() or 'it said nothing'}")
        self.node_id = node_id
        self.text = text


class NodeHangs(NodeError):  # noqa: N818 - it says what is wrong
    """The process of a cell gives no answer, and was ended; `text` is what it said."""

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
        """What the cell has queued to send since the last collection."""

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
