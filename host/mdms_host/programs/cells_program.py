"""A program of many parcels on cells that steer them by themselves."""

from collections.abc import Mapping, Sequence

from mdms_host.estimation.belief import Belief
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.programs.program import Main, Member, TableProgram
from mdms_host.programs.traffic.by_cells import CellsTraffic
from mdms_protocol.neighbours.messages import Estimate, Lost, Page


class CellsTableProgram(TableProgram):
    """The same as `TableProgram`, with goals for cells where that has references for wheels.

    See `motion.by_cells.steering.ByCells`.
    """

    def __init__(
        self,
        main: Main,
        half_m: tuple[float, float],
        members: Sequence[Member],
        traffic: CellsTraffic,
        cells: CellsProgram,
    ) -> None:
        super().__init__(main, half_m, members, (), traffic)
        self._by_cells = traffic
        self._cells = cells

    def on_estimate(self, cell: int, estimate: Estimate, now_s: float) -> None:
        """A cell (from 1) has sent its estimate."""
        self._cells.on_estimate(cell, estimate, now_s)

    def on_answer(self, cell: int, answer: Lost) -> None:
        """A cell (from 1) has answered a page about a lost cell."""
        self._cells.on_answer(cell, answer)

    def on_silence(self, silent_s: Mapping[int, float]) -> None:
        """For how long nothing has come of each cell (from 1) [s]."""
        self._cells.on_silence(silent_s)

    def step(self, beliefs: Mapping[str, Belief], now_s: float, step_s: float) -> list[Page]:
        """The pages to send now, given the beliefs; once a cycle."""
        self.references_m_s(beliefs, step_s)
        return self._cells.step(beliefs, now_s, step_s)

    def begin_again(self) -> None:
        """Plan and send every parcel's way anew, from where the parcel is."""
        self._by_cells.begin_again()

    def ends(self) -> list[Page]:
        """The pages that end all programs."""
        return self._cells.ends()
