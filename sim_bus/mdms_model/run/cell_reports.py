"""What cells report of the parcels that they steer, read off the bus for the record."""

from array import array
from collections.abc import Sequence
from math import pi

import numpy as np

from mdms_model.arrays import Floats
from mdms_protocol import cob
from mdms_protocol import neighbours as wire
from mdms_protocol.frame import Frame

#: A cell at a parcel reports at every beat; one that has been silent for so long [s] is at none.
SILENT_S = 0.05
_NEVER_S = -np.inf
#: What `CellReports.sample` returns, by the names that it has in a `Record`.
REPORTED = ("identity", "state", "belief")


class CellReports:
    """Estimates of cells at these centres (C, 2); takes the frames whose `can_id` is in `cells`.

    Cell k (from 0) has node id k + 1, or that of `node_ids`.
    """

    def __init__(self, centres_m: Floats, node_ids: Sequence[int] = ()) -> None:
        ids = node_ids or range(1, len(centres_m) + 1)
        self.cells = {cob.ESTIMATE_BASE + node_id: cell for cell, node_id in enumerate(ids)}
        #: Whether any cell has reported yet.
        self.any = False
        self._centres_m = centres_m
        self._reported_s = np.full(len(centres_m), _NEVER_S)
        self._fields = array("i", bytes(4 * wire.ESTIMATE_FIELDS))
        self._last = np.zeros((len(centres_m), wire.ESTIMATE_FIELDS), np.int64)

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """A frame was on the bus; one that cannot be decoded changes nothing."""
        cell = self.cells[frame.can_id]
        if wire.unpack_estimate(frame.data, self._fields, 0):
            self.any = True
            self._reported_s[cell] = now_s
            self._last[cell] = self._fields

    def sample(self, now_s: float) -> dict[str, Floats]:
        """`identity` and `state` (C,), 0 where none, and `belief` (C, 3), NaN where none."""
        silent = now_s - self._reported_s > SILENT_S
        last = np.where(silent[:, None], 0, self._last)
        unknown = last[:, wire.CERTAINTY] == 0
        place_m = self._centres_m + last[:, [wire.X, wire.Y]] * (wire.STEP_UM * 1e-6)
        yaw_rad = last[:, [wire.YAW]] * (2 * pi / wire.TURN)
        belief = np.where(unknown[:, None], np.nan, np.hstack((place_m, yaw_rad)))
        return {
            "identity": last[:, wire.IDENTITY].astype(np.int8),
            "state": last[:, wire.STATE].astype(np.int8),
            "belief": belief,
        }


def without_reports(columns: dict[str, Floats]) -> dict[str, Floats]:
    """The columns of a record in which no cell has reported anything."""
    return {name: column for name, column in columns.items() if name not in REPORTED}
