"""The references last sent to the wheels, read off the bus for the record."""

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.buses import Addresses
from mdms_protocol import pdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.entry import steps_per_unit

UM_PER_M = steps_per_unit(pdo.TARGET_VELOCITY.entries[0].unit)
#: What the PDO holds: one for each axis [um/s].
REFERENCES = np.dtype("<i4")


class References:
    """Setpoints of cells at these addresses.

    `cells[bus]` has the cells of a bus (from 0) by the identifiers of their setpoints.
    """

    def __init__(self, addresses: Addresses, axes: int) -> None:
        self._axes = axes
        self.cells: list[dict[int, int]] = [{} for _ in range(addresses.bus_count)]
        places = zip(addresses.buses, addresses.node_ids, strict=True)
        for cell, (bus, node_id) in enumerate(places):
            self.cells[bus][pdo.TARGET_VELOCITY.can_id(node_id)] = cell
        self._sent = [bytes(pdo.TARGET_VELOCITY.length)] * len(addresses.buses)

    def on_frame(self, bus: int, frame: Frame, now_ns: int) -> None:
        """A frame whose `can_id` is in `cells[bus]` was on that bus."""
        can_id, data = frame
        if len(data) == pdo.TARGET_VELOCITY.length:
            self._sent[self.cells[bus][can_id]] = data

    @property
    def reference_m_s(self) -> Floats:
        """Of all wheels, by cell, then axis (W,)."""
        sent = np.frombuffer(b"".join(self._sent), REFERENCES).reshape(len(self._sent), -1)
        return sent[:, : self._axes].ravel() / UM_PER_M
