"""One host at a time: whether another one speaks on the bus, by its heartbeat.

A run breaks an update of cells off, too, so it does not begin while one goes on.
"""

from collections.abc import Iterable
from math import inf

from mdms_host.can_link.link import AnyLink, drive
from mdms_host.can_link.remote_cell import UPDATE_RUNS, UPDATE_S, takes_firmware
from mdms_host.clock import Clock
from mdms_host.coordination.supervision import OTHER_HOST
from mdms_model.errors import Error
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame

#: A host sends a heartbeat every 0.1 s.
_LISTEN_S = 0.35
HEARTBEAT = cob.HEARTBEAT_BASE + cob.NODE_MAX


class OtherHostError(Error):
    """Another host runs on the bus, or has cells take new firmware."""


class OtherHost:
    """Why no run may begin now, by frames that somebody else has sent."""

    def __init__(self) -> None:
        self._last_s = self._updated_s = -inf

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Note a host's heartbeat, and a cell that takes firmware."""
        if frame.can_id == HEARTBEAT and nmt.decode_heartbeat(frame.data) is not None:
            self._last_s = now_s
        elif takes_firmware(frame):
            self._updated_s = now_s

    def speaks(self, now_s: float) -> bool:
        """Whether a host is there; a host that has missed three heartbeats is gone."""
        return now_s - self._last_s < _LISTEN_S

    def reason(self, now_s: float) -> str | None:
        """Another host, or an update that goes on, in words; None without one."""
        if self.speaks(now_s):
            return OTHER_HOST
        if now_s - self._updated_s < UPDATE_S:
            return f"{UPDATE_RUNS}; let mdms flash --bus come to its end first"
        return None


class _Listening:
    """A participant that sends nothing, and notes why no run may begin."""

    wake_s = inf

    def __init__(self) -> None:
        self._other = OtherHost()
        self.found: str | None = None

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """Note somebody else's frame."""
        self._other.on_frame(frame, now_s)
        self.found = self.found or self._other.reason(now_s)

    def poll(self, now_s: float) -> Iterable[Frame]:
        """Nothing."""
        return ()

    def poll_buses(self, now_s: float) -> Iterable[tuple[int, Frame]]:
        """Nothing on any bus."""
        return ()


def refuse_other_host(link: AnyLink, clock: Clock) -> None:
    """Listen for a while before anything is sent. Raises OtherHostError, DeviceGoneError."""
    listening, end_s = _Listening(), clock.now_s() + _LISTEN_S
    drive(listening, link, clock, lambda: bool(listening.found) or clock.now_s() >= end_s)
    if listening.found:
        raise OtherHostError(listening.found)
