"""The velocities of all wheels on the wire: one setpoint frame and one state frame a cell."""

from collections.abc import Sequence

import numpy as np

from mdms_model.arrays import Floats, Ints
from mdms_protocol import pdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.entry import steps_per_unit

_TARGET, _ACTUAL = pdo.TARGET_VELOCITY, pdo.ACTUAL_VELOCITY
#: All axes of a cell have the same type and limits.
_AXIS = _TARGET.entries[0]
_UM_PER_M = steps_per_unit(_AXIS.unit)
_WIRE = np.dtype(f"<i{_AXIS.type.size}")


class VelocityFrames:
    """Turns velocities of shape (W,), ordered by cell, then by axis, into frames and back.

    All cells at once: one by one would cost the coordinator most of its time. Raises ValueError
    for cells of more axes than the wire has.
    """

    def __init__(self, node_ids: Sequence[int], axes: int) -> None:
        if axes > len(_TARGET.entries):
            raise ValueError(
                f"a cell has {len(_TARGET.entries)} axes on the wire, the layout wants {axes}"
            )
        self._axes = axes
        self._can_ids = [_TARGET.can_id(node_id) for node_id in node_ids]
        self._targets_um_s = np.zeros((len(node_ids), len(_TARGET.entries)), _WIRE)

    def targets(self, references_m_s: Floats) -> list[Frame]:
        """Each cell's setpoints, zero for axes that are not used. Raises OutOfRangeError."""
        um_s = np.rint(references_m_s * _UM_PER_M).astype(np.int64).reshape(-1, self._axes)
        if not _AXIS.low <= um_s.min() <= um_s.max() <= _AXIS.high:
            _refuse(um_s)
        self._targets_um_s[:, : self._axes] = um_s
        data, size = self._targets_um_s.tobytes(), _TARGET.length
        cells = zip(self._can_ids, range(0, len(data), size), strict=True)
        return [Frame(can_id, data[start : start + size]) for can_id, start in cells]

    def actual_m_s(self, data: Sequence[bytes]) -> Floats:
        """The speeds in the state frames of all cells, shape (W,)."""
        um_s = np.frombuffer(b"".join(data), _WIRE).reshape(-1, len(_ACTUAL.entries))
        return um_s[:, : self._axes].ravel() / _UM_PER_M


def _refuse(um_s: Ints) -> None:
    """Raises OutOfRangeError for the first value that no drive takes."""
    for values in um_s.tolist():
        for entry, value in zip(_TARGET.entries, values, strict=False):
            pdo.check(entry, value)
