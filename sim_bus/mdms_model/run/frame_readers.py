"""Readers of frames for the record: reports of cells, references, presence bits."""

from math import pi

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.buses import Addresses
from mdms_protocol import pdo
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.entry import steps_per_unit
from mdms_protocol.neighbours import frames as wire

#: A cell at a parcel reports at every beat; after so long a silence it is at none [s].
SILENT_S = 0.05
_NEVER_S = -np.inf
#: What `CellReports.sample` returns, by the names that it has in a `Record`.
REPORTED = ("identity", "state", "belief")


class CellReports:
    """Estimates of cells at these centres (C, 2) and addresses.

    `cells[bus]` has the cells of a bus (from 0) by the identifiers of their estimates.
    """

    def __init__(self, centres_m: Floats, addresses: Addresses) -> None:
        self.cells: list[dict[int, int]] = [{} for _ in range(addresses.bus_count)]
        places = zip(addresses.buses, addresses.node_ids, strict=True)
        for cell, (bus, node_id) in enumerate(places):
            self.cells[bus][cob.ESTIMATE_BASE + node_id] = cell
        #: Whether any cell has reported yet.
        self.any = False
        self._centres_m = centres_m
        self._reported_s = np.full(len(centres_m), _NEVER_S)
        self._fresh = bytearray(1)
        self._last = np.zeros((len(centres_m), wire.ESTIMATE_FIELDS), np.int16)
        #: The sample of a run in which no cell has reported.
        self._nothing = self._sampled(0.0)

    def on_frame(self, bus: int, frame: Frame, now_s: float) -> None:
        """Take in a frame whose `can_id` is in `cells[bus]`; an invalid one changes nothing."""
        cell, data = self.cells[bus][frame.can_id], frame.data
        self._fresh[0] = 1
        if len(data) != wire.LENGTH or wire.read_estimates(data, self._fresh, self._last[cell], 1):
            return
        self.any = True
        self._reported_s[cell] = now_s

    def sample(self, now_s: float) -> dict[str, Floats]:
        """`identity` and `state` (C,), 0 where none, and `belief` (C, 3), NaN where none."""
        return self._sampled(now_s) if self.any else self._nothing

    def _sampled(self, now_s: float) -> dict[str, Floats]:
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


class PresenceReader:
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
