"""Which cells take part in a run, and which are out of action and on their way back."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from mdms_host.coordination.care.comeback import Comeback
from mdms_host.coordination.cell_setup.bring_up import BringUpCell
from mdms_host.coordination.phase import Phase
from mdms_model.arrays import Bools


class Roster:
    """The cells of `axes` wheels each; a cell is `taking_part`, or `out` with its way back.

    `wheels_out` are the wheels of cells that are out, shape (W,). No reference moves them, and
    their reports show nothing of a parcel. The run does not wait for the cells in `given_up`.
    """

    def __init__(self, cells: Sequence[BringUpCell], axes: int) -> None:
        self.cells = cells
        self.taking_part: tuple[BringUpCell, ...] = tuple(cells)
        self.out: dict[BringUpCell, Comeback] = {}
        self.given_up: set[BringUpCell] = set()
        self.wheels_out: Bools = np.zeros(axes * len(cells), dtype=bool)
        self._axes = axes

    @property
    def awaited(self) -> list[Comeback]:
        """The ways back of the cells that the run waits for."""
        return [way for cell, way in self.out.items() if cell not in self.given_up]

    def phase_of(self, cell: BringUpCell, phase: Phase) -> Phase:
        """The phase of a cell in that of the run: its own while it is out."""
        way = self.out.get(cell)
        return phase if way is None else way.phase

    def lose(self, cell: BringUpCell, text: str, now_s: float) -> None:
        """A cell is out of action, for a reason in words; its way back begins."""
        self.out[cell] = Comeback(cell, text, now_s)
        self._sort()

    def give_up(self, cells: Iterable[BringUpCell]) -> None:
        """Wait no more for these cells; they may come back all the same."""
        self.given_up.update(cells)

    def await_since(self, since_s: float) -> None:
        """Wait again for cells that have been out since then only, and are not refused."""
        late = (
            cell for cell, way in self.out.items() if way.since_s >= since_s and not way.refused
        )
        self.given_up.difference_update(list(late))

    def step(
        self,
        now_s: float,
        silent: Callable[[BringUpCell], bool],
        ready: Callable[[BringUpCell], bool],
    ) -> list[BringUpCell]:
        """Take the cells that are out further; those that are back, and `ready`, take part again.

        `silent` is whether a cell has fallen silent.
        """
        for cell, way in self.out.items():
            way.step(now_s, silent(cell))
        back = [cell for cell, way in self.out.items() if way.back and ready(cell)]
        for cell in back:
            del self.out[cell]
            self.given_up.discard(cell)
        if back:
            self._sort()
        return back

    def _sort(self) -> None:
        self.taking_part = tuple(cell for cell in self.cells if cell not in self.out)
        self.wheels_out = np.repeat([cell in self.out for cell in self.cells], self._axes)
