"""Segmented SDO transfers (CiA 301, 7.2.4.2.5 and 7.2.4.2.8): seven bytes a request."""

from mdms_protocol import sdo

_SEGMENT = 7


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
    """A value on its way from the client into `sink`; `size` is what was told, or None."""

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


def check_size(told, received, last):
    """Compare the bytes received with what was told, if it was; raises AbortError."""
    if told is None:
        return
    if received > told:
        raise sdo.AbortError(sdo.TOO_LONG)
    if last and received < told:
        raise sdo.AbortError(sdo.TOO_SHORT)


def _check(command, specifier, toggle):
    """The toggle bit to expect next; raises AbortError if this one is not as expected."""
    if command & sdo.SPECIFIER != specifier:
        raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
    if command & sdo.TOGGLE != toggle:
        raise sdo.AbortError(sdo.TOGGLE_NOT_ALTERNATED)
    return toggle ^ sdo.TOGGLE
