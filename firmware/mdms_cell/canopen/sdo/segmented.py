"""Expedited and segmented SDO transfers (CiA 301, 7.2.4.2.2 to 7.2.4.2.8)."""

from mdms_cell.canopen.objects import find
from mdms_protocol.codecs import sdo

_SEGMENT = 7


def begin_upload(objects, data, index, sub):
    """The transfer of an entry to the client, None where one frame does, and its first response."""
    return answer(objects.read(index, sub), data, index, sub)


def answer(value, data, index, sub):
    """The transfer of a value to the client, None where one frame does, and its first response."""
    size = len(value)
    if 1 <= size <= 4:
        command = sdo.UPLOAD_RESPONSE | (4 - size) << 2 | sdo.EXPEDITED | sdo.SIZE_TOLD
        return None, head(command, data) + value + bytes(4 - size)
    command = sdo.UPLOAD_RESPONSE | sdo.SIZE_TOLD
    return SegmentedUpload(index, sub, value), head(command, data) + size.to_bytes(4, "little")


def begin_download(objects, data, index, sub):
    """The transfer that a request opens, None where one frame does, and its first response."""
    command = data[0]
    announced = command & sdo.SIZE_TOLD
    if not command & sdo.EXPEDITED:
        size = int.from_bytes(data[4:8], "little") if announced else None
        sink = objects.open(index, sub, size)
        transfer = SegmentedDownload(index, sub, sink, size)
        return transfer, head(sdo.DOWNLOAD_RESPONSE, data) + bytes(4)
    # Where no size is given, the entry's own counts.
    size = 4 - (command >> 2 & 3) if announced else find(index, sub).size or 4
    sink = objects.open(index, sub, size)
    try:
        sink.write(data[4 : 4 + size])
        sink.finish()
    except sdo.AbortError:
        sink.cancel()
        raise
    return None, head(sdo.DOWNLOAD_RESPONSE, data) + bytes(4)


def head(command, data):
    """The first four bytes of a response: its command, and the entry that the request names."""
    return bytes((command,)) + data[1:4]


class SegmentedUpload:
    """A value on its way to the client."""

    def __init__(self, index, sub, value):
        self.index = index
        self.sub = sub
        self.done = False
        self._value = value
        self._sent = 0
        self._toggle = 0

    def takes(self, command):
        """Whether a request belongs to this transfer rather than opens another."""
        return command & sdo.SPECIFIER in (sdo.UPLOAD_SEGMENT, sdo.DOWNLOAD_SEGMENT)

    def on_request(self, data):
        """The next segment; raises AbortError."""
        self._toggle = _check(data[0], sdo.UPLOAD_SEGMENT, self._toggle)
        piece = self._value[self._sent : self._sent + _SEGMENT]
        self._sent += len(piece)
        self.done = self._sent == len(self._value)
        unused = _SEGMENT - len(piece)
        command = sdo.UPLOAD_SEGMENT_RESPONSE | data[0] & sdo.TOGGLE | unused << 1
        return bytes((command | (sdo.LAST_SEGMENT if self.done else 0),)) + piece + bytes(unused)

    def pump(self, _send):
        """Nothing is sent unasked."""

    def cancel(self):
        """Nothing is to be undone."""


class SegmentedDownload:
    """A value on its way from the client into `sink`; `size` is as announced, or None."""

    def __init__(self, index, sub, sink, size):
        self.index = index
        self.sub = sub
        self.done = False
        self._sink = sink
        self._size = size
        self._received = 0
        self._toggle = 0

    def takes(self, command):
        """Whether a request belongs to this transfer rather than opens another."""
        return command & sdo.SPECIFIER in (sdo.UPLOAD_SEGMENT, sdo.DOWNLOAD_SEGMENT)

    def on_request(self, data):
        """Take the next segment; raises AbortError."""
        command = data[0]
        self._toggle = _check(command, sdo.DOWNLOAD_SEGMENT, self._toggle)
        piece = data[1 : 8 - (command >> 1 & 7)]
        self._received += len(piece)
        last = command & sdo.LAST_SEGMENT
        check_size(self._size, self._received, last)
        self._sink.write(piece)
        if last:
            self._sink.finish()
            self.done = True
        return bytes((sdo.DOWNLOAD_SEGMENT_RESPONSE | command & sdo.TOGGLE,)) + bytes(7)

    def pump(self, _send):
        """Nothing is sent unasked."""

    def cancel(self):
        """Throw away what has come."""
        self._sink.cancel()


def check_size(announced, received, last):
    """Compare the bytes received with what was announced, if it was; raises AbortError."""
    if announced is None:
        return
    if received > announced:
        raise sdo.AbortError(sdo.TOO_LONG)
    if last and received < announced:
        raise sdo.AbortError(sdo.TOO_SHORT)


def _check(command, specifier, toggle):
    """The toggle bit to expect next; raises AbortError if this one is not as expected."""
    if command & sdo.SPECIFIER != specifier:
        raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
    if command & sdo.TOGGLE != toggle:
        raise sdo.AbortError(sdo.TOGGLE_NOT_ALTERNATED)
    return toggle ^ sdo.TOGGLE
