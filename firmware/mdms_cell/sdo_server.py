"""The SDO server (CiA 301, 7.2.4): lets one client read and write the object dictionary.

A transfer of more than four bytes is an object of its own (`sdo_segmented`, `sdo_block`) with
`on_request(data)`, which returns the response or None, `done`, and `pump(send)`. Its module is
loaded when one begins.
"""

from mdms_cell import ticks
from mdms_cell.objects import find
from mdms_protocol import sdo

#: A transfer in which the client is silent for so long is aborted.
TIMEOUT_MS = 1000


class SdoServer:
    """Answers requests through `respond(data)`, which returns False when there is no room."""

    def __init__(self, objects, respond):
        self._objects = objects
        self._respond = respond
        self._transfer = None
        self._heard_ms = 0
        self.now_ms = 0

    @property
    def busy(self):
        """Whether a transfer is under way."""
        return self._transfer is not None

    def reset(self):
        """Forget a transfer that is under way."""
        self._close()

    def poll(self, now_ms):
        """Go on sending a block, and give up on a silent client."""
        self.now_ms = now_ms
        transfer = self._transfer
        if transfer is None:
            return
        transfer.pump(self._respond)
        if ticks.diff(now_ms, self._heard_ms) >= TIMEOUT_MS:
            self._abort(transfer.index, transfer.sub, sdo.TIMED_OUT)

    def on_request(self, data):
        """Serve one request; return False if it is none."""
        if len(data) != 8:
            return False
        self._heard_ms = self.now_ms
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
        begin = _opening(data[0] & sdo.SPECIFIER)
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


def _opening(specifier):
    """What opens a transfer; raises AbortError if nothing does."""
    if specifier == sdo.UPLOAD:
        return _upload
    if specifier == sdo.DOWNLOAD:
        return _download
    if specifier == sdo.BLOCK_UPLOAD:
        from mdms_cell.sdo_block import begin_upload

        return begin_upload
    if specifier == sdo.BLOCK_DOWNLOAD:
        from mdms_cell.sdo_block import begin_download

        return begin_download
    raise sdo.AbortError(sdo.UNKNOWN_COMMAND)


def _upload(objects, data, index, sub):
    return answer(objects.read(index, sub), data, index, sub)


def answer(value, data, index, sub):
    """The transfer of a value to the client, None where one frame does, and its first response."""
    size = len(value)
    if 1 <= size <= 4:
        command = sdo.UPLOAD_RESPONSE | (4 - size) << 2 | sdo.EXPEDITED | sdo.SIZE_TOLD
        return None, head(command, data) + value + bytes(4 - size)
    from mdms_cell.sdo_segmented import SegmentedUpload

    command = sdo.UPLOAD_RESPONSE | sdo.SIZE_TOLD
    return SegmentedUpload(index, sub, value), head(command, data) + size.to_bytes(4, "little")


def _download(objects, data, index, sub):
    command = data[0]
    told = command & sdo.SIZE_TOLD
    if not command & sdo.EXPEDITED:
        size = int.from_bytes(data[4:8], "little") if told else None
        sink = objects.open(index, sub, size)
        from mdms_cell.sdo_segmented import SegmentedDownload

        transfer = SegmentedDownload(index, sub, sink, size)
        return transfer, head(sdo.DOWNLOAD_RESPONSE, data) + bytes(4)
    # Where no size is told, the entry's own counts.
    size = 4 - (command >> 2 & 3) if told else find(index, sub).size or 4
    sink = objects.open(index, sub, size)
    sink.write(data[4 : 4 + size])
    sink.finish()
    return None, head(sdo.DOWNLOAD_RESPONSE, data) + bytes(4)


def head(command, data):
    """The first four bytes of a response: its command, and the entry that the request names."""
    return bytes((command,)) + data[1:4]
