"""One cell as the host sees it: what its frames have told so far."""

from collections.abc import Mapping

from mdms_protocol import cia402, cob, nmt, pdo

_DRIVING = frozenset((cia402.OPERATION_ENABLED, cia402.QUICK_STOP_ACTIVE))
_NAMES: Mapping[int | None, str] = dict(cia402.NAMES.items())


class RemoteCell:
    """The last known state of the cell with this number (from 1) and node id.

    Everything is None until the cell has told it; `garbage` counts frames of its that made no
    sense and were dropped.
    """

    def __init__(self, number: int, node_id: int) -> None:
        self.number = number
        self.node_id = node_id
        self.heard_s: float | None = None
        self.nmt_state: int | None = None
        self.drive_states: tuple[int | None, ...] | None = None
        self.presence: int | None = None
        self.speeds_um_s: tuple[int, ...] | None = None
        self.emergency: int | None = None
        self.garbage = 0

    @property
    def name(self) -> str:
        """How messages call this cell."""
        return f"cell {self.number} (node {self.node_id})"

    def on_frame(self, can_id: int, data: bytes, now_s: float) -> None:
        """Take in a frame of this cell; one that makes no sense is counted and dropped."""
        base = can_id - self.node_id
        if base == cob.HEARTBEAT_BASE:
            self._on_heartbeat(data, now_s)
        elif base == pdo.STATUS.base:
            self._on_status(pdo.STATUS.decode(data))
        elif base == pdo.ACTUAL_VELOCITY.base:
            self._on_speeds(pdo.ACTUAL_VELOCITY.decode(data))
        elif base == cob.EMCY_BASE:
            self._on_emergency(data)

    @property
    def moving(self) -> bool:
        """Whether any axis may be driving its motor."""
        return not _DRIVING.isdisjoint(self.drive_states or ())

    @property
    def drive_text(self) -> str:
        """The states of the drives in words."""
        if self.drive_states is None:
            return "no statusword yet"
        return ", ".join(
            f"axis {axis} {_NAMES.get(state, 'in no known state')}"
            for axis, state in enumerate(self.drive_states, 1)
        )

    def _on_heartbeat(self, data: bytes, now_s: float) -> None:
        state = nmt.decode_heartbeat(data)
        if state is None:
            self.garbage += 1
            return
        self.heard_s, self.nmt_state = now_s, state

    def _on_status(self, values: tuple[int, ...] | None) -> None:
        if values is None:
            self.garbage += 1
            return
        *statuswords, self.presence = values
        self.drive_states = tuple(cia402.state(word) for word in statuswords)

    def _on_speeds(self, values: tuple[int, ...] | None) -> None:
        if values is None:
            self.garbage += 1
            return
        self.speeds_um_s = values

    def _on_emergency(self, data: bytes) -> None:
        if len(data) != 8:
            self.garbage += 1
            return
        self.emergency = int.from_bytes(data[:2], "little")
