"""NMT commands of other hosts that end motion: what a link receives is never this host's own."""

from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame

_NAMES = {
    nmt.STOP: "'stop'",
    nmt.ENTER_PRE_OPERATIONAL: "'enter pre-operational', as mdms stop does",
    nmt.RESET_NODE: "'reset node'",
    nmt.RESET_COMMUNICATION: "'reset communication'",
}


class ForeignStops:
    """Notes them as they come in, by the node that they are for."""

    def __init__(self) -> None:
        self._codes: dict[int, int] = {}

    def on_frame(self, frame: Frame) -> None:
        """Note a command; any other frame is left alone."""
        if frame.can_id == cob.NMT and len(frame.data) == 2 and frame.data[0] in _NAMES:
            self._codes[frame.data[1]] = frame.data[0]

    def reason(self, node_id: int) -> str | None:
        """Which command another host has sent to a node, or to all; None if it has sent none."""
        for node in (node_id, nmt.ALL_NODES):
            if node in self._codes:
                return f"another host has sent {_NAMES[self._codes[node]]}"
        return None
