"""The presence bits that cells reported last, read off the bus for the record."""

import numpy as np
from numpy.typing import NDArray

from mdms_model.buses import Addresses
from mdms_protocol import pdo
from mdms_protocol.codecs.frame import Frame


class Presence:
    """Status frames of cells at these addresses.

    `cells[bus]` has the cells of a bus (from 0) by the identifiers of their status.
    """

    def __init__(self, addresses: Addresses) -> None:
        self.cells: list[dict[int, int]] = [{} for _ in range(addresses.bus_count)]
        places = zip(addresses.buses, addresses.node_ids, strict=True)
        for cell, (bus, node_id) in enumerate(places):
            self.cells[bus][pdo.STATUS.can_id(node_id)] = cell
        self._bits: NDArray[np.uint8] = np.zeros(len(addresses.buses), np.uint8)

    def on_frame(self, bus: int, frame: Frame, now_ns: int) -> None:
        """Take in a frame whose `can_id` is in `cells[bus]`; an invalid one changes nothing."""
        can_id, data = frame
        if len(data) == pdo.STATUS.length:
            # The last object of the frame is one byte.
            self._bits[self.cells[bus][can_id]] = data[-1]

    @property
    def bits(self) -> NDArray[np.uint8]:
        """By cell, a bit for each sensor from 0 on, 0 before the first report; (C,)."""
        return self._bits.copy()
