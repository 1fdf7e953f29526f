"""Makes sure at boot that no other node has the node id (beyond CiA 301, with its means).

Before its boot-up message the cell reads the serial number of the node with its own id, as an SDO
client would. Any device with that id answers. Another cell may ask the same at that time. It is
recognised by its serial number, which lies in the four free bytes of the request.

A cell that is stopped or in an SDO transfer answers with a heartbeat instead. The transfer's client
has not sent the claim, and would take another response for its own.
"""

from mdms_cell import ticks
from mdms_protocol import indices
from mdms_protocol.codecs import cob, sdo

#: Any node answers an SDO request within this time.
LISTEN_MS = 50

_SERIAL_NUMBER = (indices.IDENTITY, 4)
_REQUEST = sdo.read_request(*_SERIAL_NUMBER)[:4]


def is_claim(data):
    """Whether an SDO request claims a node id; a client leaves the last four bytes zero."""
    return len(data) == 8 and data[:4] == _REQUEST and data[4:] != bytes(4)


class Claim:
    """The claim of a node id by the cell with this serial number."""

    def __init__(self, serial):
        self._request = _REQUEST + serial.to_bytes(4, "little")
        self._asked_ms = None
        self.refused = False

    def receivers(self, node_id):
        """Pairs of an identifier and what takes its frames."""
        return (
            (cob.SDO_REQUEST_BASE + node_id, self.on_request),
            (cob.SDO_RESPONSE_BASE + node_id, self.on_other),
            (cob.HEARTBEAT_BASE + node_id, self.on_other),
        )

    def poll(self, now_ms, node_id, send):
        """Ask first, then return True once nobody has answered in time."""
        if self._asked_ms is None:
            if send(cob.SDO_REQUEST_BASE + node_id, self._request):
                self._asked_ms = now_ms
            return False
        return not self.refused and ticks.diff(now_ms, self._asked_ms) >= LISTEN_MS

    def ask_again(self):
        """The request, or an answer to it, may have been lost."""
        self._asked_ms = None

    def on_request(self, data):
        """Another asks for this id while this cell is claiming it."""
        self.refused |= is_claim(data) and data != self._request
        return True

    def on_other(self, _data):
        """A frame that only the node of this id sends."""
        self.refused = True
        return True
