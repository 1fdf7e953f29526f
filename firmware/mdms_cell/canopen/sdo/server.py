"""The SDO server (CiA 301, 7.2.4): lets one client read and write the object dictionary.

A transfer of more than four bytes is an object of its own (`segmented`, `block`) with
`on_request(data)`, which returns the response or None, `done`, and `pump(send)`.
"""

from mdms_cell import ticks
from mdms_cell.canopen.sdo import block, segmented
from mdms_protocol.codecs import sdo

#: A transfer in which the client is silent for so long is aborted.
TIMEOUT_MS = 1000

#: What opens a transfer, by the command specifier of the request.
_OPENINGS = {
    sdo.UPLOAD: segmented.begin_upload,
    sdo.DOWNLOAD: segmented.begin_download,
    sdo.BLOCK_UPLOAD: block.begin_upload,
    sdo.BLOCK_DOWNLOAD: block.begin_download,
}


class SdoServer:
    """Answers requests through `respond(data)`, which returns False when there is no room."""

    def __init__(self, objects, respond):
        self._objects = objects
        self._respond = respond
        self._transfer = None
        self._received_ms = 0
        self.now_ms = 0

    @property
    def busy(self):
        """Whether a transfer is under way."""
        return self._transfer is not None

    def give_up(self):
        """Abort a transfer that is under way: the node changes its state."""
        transfer = self._transfer
        if transfer is not None:
            self._abort(transfer.index, transfer.sub, sdo.WRONG_STATE)

    def poll(self, now_ms):
        """Go on sending a block, and give up on a silent client."""
        self.now_ms = now_ms
        transfer = self._transfer
        if transfer is None:
            return
        transfer.pump(self._respond)
        if ticks.diff(now_ms, self._received_ms) >= TIMEOUT_MS:
            self._abort(transfer.index, transfer.sub, sdo.TIMED_OUT)

    def on_request(self, data):
        """Serve one request; return False if it is none."""
        if len(data) != 8:
            return False
        self._received_ms = self.now_ms
        transfer = self._transfer
        try:
            if transfer is not None and transfer.takes(data[0]):
                self._go_on(transfer, data)
            elif data[0] == sdo.ABORT:
                self._close()
            else:
                self._begin(data)
        except sdo.AbortError as refusal:
            self._refuse(data, refusal.code)
        return True

    def _go_on(self, transfer, data):
        response = transfer.on_request(data)
        if response is not None:
            self._respond(response)
        if transfer.done:
            self._transfer = None
        else:
            transfer.pump(self._respond)

    def _begin(self, data):
        """A request that opens a transfer; one that was under way is given up."""
        begin = _OPENINGS.get(data[0] & sdo.SPECIFIER)
        if begin is None:
            raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
        self._close()
        transfer, response = begin(self._objects, data, data[1] | data[2] << 8, data[3])
        self._transfer = transfer
        self._respond(response)

    def _refuse(self, data, code):
        if self._transfer is not None:
            self._abort(self._transfer.index, self._transfer.sub, code)
        else:
            self._abort(data[1] | data[2] << 8, data[3], code)

    def _abort(self, index, sub, code):
        self._close()
        self._respond(sdo.abort(index, sub, code))

    def _close(self):
        if self._transfer is not None:
            self._transfer.cancel()
            self._transfer = None
