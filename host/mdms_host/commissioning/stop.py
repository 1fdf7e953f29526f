"""Everything off: every drive on the bus is disabled at once, whoever enabled it."""

from dataclasses import dataclass

from mdms_host.can_link.link import AnyLink, drive
from mdms_host.can_link.remote_cell import BROKEN_OFF, CUT
from mdms_host.clock import Clock
from mdms_model.log import LOG
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame

#: The command is repeated, since a broadcast is not confirmed.
_REPEATS = 3
_REPEAT_S = 0.05


@dataclass(frozen=True, slots=True)
class StopReport:
    """Node ids of the cells that sent a heartbeat, and of those among them not seen to be off."""

    heard: tuple[int, ...]
    not_off: tuple[int, ...]


class NetworkStop:
    """A participant that takes all nodes out of 'operational', where no motor may run.

    It then checks their heartbeats; `listen_s` should span some of them.
    """

    def __init__(self, listen_s: float = 0.4) -> None:
        self._listen_s = listen_s
        self._sent = 0
        self._states: dict[int, int] = {}
        self.wake_s = 0.0

    @property
    def over(self) -> bool:
        """Whether it has listened long enough."""
        return self.wake_s == float("inf")

    @property
    def report(self) -> StopReport:
        """The outcome as the heartbeats reported it."""
        still = (node for node, state in self._states.items() if state == nmt.OPERATIONAL)
        return StopReport(tuple(sorted(self._states)), tuple(sorted(still)))

    def poll(self, now_s: float) -> list[Frame]:
        """The command while it is to be sent, then nothing."""
        if self._sent < _REPEATS:
            self._sent += 1
            self.wake_s = now_s + (_REPEAT_S if self._sent < _REPEATS else self._listen_s)
            return [nmt.command(nmt.ENTER_PRE_OPERATIONAL)]
        self.wake_s = float("inf")
        return []

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Record the state of a heartbeat."""
        node = frame.can_id - cob.HEARTBEAT_BASE
        state = nmt.decode_heartbeat(frame.data)
        if cob.NODE_MIN <= node < cob.NODE_MAX and state is not None:
            self._states[node] = state


def stop_all(link: AnyLink, clock: Clock) -> StopReport:
    """Turn off every drive on the bus of a link; raises DeviceGoneError."""
    stopping = NetworkStop()
    try:
        drive(stopping, link, clock, lambda: stopping.over)
    except KeyboardInterrupt:
        LOG.warning(BROKEN_OFF)
        raise
    return stopping.report


def not_off_text(report: StopReport, bus: str = "") -> str:
    """Which cells are not seen to be off, and what to do."""
    nodes = ", ".join(map(str, report.not_off))
    where = f"{bus}, " if bus else ""
    return f"not off: {where}node {nodes}; {CUT}"
