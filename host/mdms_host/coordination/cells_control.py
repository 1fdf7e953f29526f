"""Control by the cells: their programs as frames, their estimates, and which wheels they drive."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from mdms_host.coordination.cell_setup.bring_up import BringUpCell
from mdms_host.estimation.belief import Belief
from mdms_host.motion.by_cells.steering import ByCells
from mdms_model.arrays import Floats
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.neighbours.messages import Page, decode_estimate, encode_page


class CellsControl:
    """Between a program for cells that steer and the bus; nothing here sets a wheel's speed."""

    def __init__(self, cells: Sequence[BringUpCell], program: ByCells) -> None:
        self._cells = cells
        self._program = program

    @property
    def references_m_s(self) -> Floats:
        """The wheels' references, shape (W,): 0 where a drive is off, NaN where a cell drives."""
        driven = np.array([driven for cell in self._cells for driven in cell.driven])
        return np.where(driven, np.nan, 0.0)

    def on_estimate(self, cell: BringUpCell, data: bytes, now_s: float) -> None:
        """The third TPDO of a cell; one that cannot be decoded is counted and dropped."""
        estimate = decode_estimate(data)
        if estimate is None:
            cell.garbage += 1
        else:
            self._program.on_estimate(cell.number, estimate, now_s)

    def frames(self, beliefs: Mapping[str, Belief], now_s: float, step_s: float) -> Iterator[Frame]:
        """Frames to send in this cycle, given the beliefs."""
        return map(_frame, self._program.step(beliefs, now_s, step_s))

    def begin_again(self) -> None:
        """All programs have ended, and the parcels lie still: each gets its program anew."""
        self._program.begin_again()

    def ends(self) -> Iterator[Frame]:
        """Frames that end all programs."""
        return map(_frame, self._program.ends())


def _frame(page: Page) -> Frame:
    return Frame(cob.PROGRAM, encode_page(page))
