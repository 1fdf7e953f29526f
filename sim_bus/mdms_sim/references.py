"""The references last told to the wheels, read off the bus for the record."""

import numpy as np

from mdms_protocol import pdo
from mdms_protocol.entry import steps_per_unit
from mdms_protocol.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.record import Floats

UM_PER_M = steps_per_unit(pdo.TARGET_VELOCITY.entries[0].unit)
#: What the PDO holds: one for each axis [um/s].
REFERENCES = np.dtype("<i4")


class References:
    """Listens to the setpoints of cells with node ids from 1."""

    def __init__(self, bus: Bus, cells: int, axes: int) -> None:
        self._axes = axes
        self._cells = {pdo.TARGET_VELOCITY.can_id(cell + 1): cell for cell in range(cells)}
        self._told = [bytes(pdo.TARGET_VELOCITY.length)] * cells
        bus.observe(self._on_frame, self._cells)

    def _on_frame(self, frame: Frame, now_ns: int) -> None:
        can_id, data = frame
        if len(data) == pdo.TARGET_VELOCITY.length:
            self._told[self._cells[can_id]] = data

    @property
    def reference_m_s(self) -> Floats:
        """Of all wheels, by cell, then axis (W,)."""
        told = np.frombuffer(b"".join(self._told), REFERENCES).reshape(len(self._told), -1)
        return told[:, : self._axes].ravel() / UM_PER_M
