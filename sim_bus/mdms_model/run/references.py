"""The references last sent to the wheels, read off the bus for the record."""

import numpy as np

from mdms_model.arrays import Floats
from mdms_protocol import pdo
from mdms_protocol.entry import steps_per_unit
from mdms_protocol.frame import Frame

UM_PER_M = steps_per_unit(pdo.TARGET_VELOCITY.entries[0].unit)
#: What the PDO holds: one for each axis [um/s].
REFERENCES = np.dtype("<i4")


class References:
    """Setpoints of cells with node ids from 1; takes the frames whose `can_id` is in `cells`."""

    def __init__(self, cells: int, axes: int) -> None:
        self._axes = axes
        self.cells = {pdo.TARGET_VELOCITY.can_id(cell + 1): cell for cell in range(cells)}
        self._sent = [bytes(pdo.TARGET_VELOCITY.length)] * cells

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """A frame was on the bus."""
        can_id, data = frame
        if len(data) == pdo.TARGET_VELOCITY.length:
            self._sent[self.cells[can_id]] = data

    @property
    def reference_m_s(self) -> Floats:
        """Of all wheels, by cell, then axis (W,)."""
        sent = np.frombuffer(b"".join(self._sent), REFERENCES).reshape(len(self._sent), -1)
        return sent[:, : self._axes].ravel() / UM_PER_M
