"""The SDO server of a cell (CiA 301, 7.2.4): one client reads and writes the object dictionary."""

from mdms_cell import ticks
from mdms_cell.canopen.objects import find
from mdms_protocol.codecs import sdo

_SEGMENT = 7
#: A transfer in which the client is silent for so long is aborted.
TIMEOUT_MS = 1000
#: A block download that is ended amid a block, as by a reset: its segments may come for so long.
STRAY_MS = 500


def _begin_upload(objects, data, index, sub):
    """The transfer of an entry to the client, None where one frame does, and its first response."""
    return _answer(objects.read(index, sub), data, index, sub)


def _answer(value, data, index, sub):
    """The transfer of a value to the client, None where one frame does, and its first response."""
    size = len(value)
    if 1 <= size <= 4:
        command = sdo.UPLOAD_RESPONSE | (4 - size) << 2 | sdo.EXPEDITED | sdo.SIZE_TOLD
        return None, _head(command, data) + value + bytes(4 - size)
    command = sdo.UPLOAD_RESPONSE | sdo.SIZE_TOLD
    return SegmentedUpload(index, sub, value), _head(command, data) + size.to_bytes(4, "little")


def _begin_download(objects, data, index, sub):
    """The transfer that a request opens, None where one frame does, and its first response."""
    command = data[0]
    announced = command & sdo.SIZE_TOLD
    if not command & sdo.EXPEDITED:
        size = int.from_bytes(data[4:8], "little") if announced else None
        sink = objects.open(index, sub, size)
        transfer = SegmentedDownload(index, sub, sink, size)
        return transfer, _head(sdo.DOWNLOAD_RESPONSE, data) + bytes(4)
    # Where no size is given, the entry's own counts.
    size = 4 - (command >> 2 & 3) if announced else find(index, sub).size or 4
    sink = objects.open(index, sub, size)
    try:
        sink.write(data[4 : 4 + size])
        sink.finish()
    except sdo.AbortError:
        sink.cancel()
        raise
    return None, _head(sdo.DOWNLOAD_RESPONSE, data) + bytes(4)


def _head(command, data):
    """The first four bytes of a response: its command, and the entry that the request names."""
    return bytes((command,)) + data[1:4]


class _Transfer:
    """A transfer of more than four bytes, segmented or in blocks.

    `on_request(data)` returns the response or None. `takes(command)` is whether a request belongs
    to this transfer rather than opens another.
    """

    def __init__(self, index, sub):
        self.index = index
        self.sub = sub
        self.done = False

    def takes(self, command):
        """Segments belong to a segmented transfer."""
        return command & sdo.SPECIFIER in (sdo.UPLOAD_SEGMENT, sdo.DOWNLOAD_SEGMENT)

    def pump(self, _send):
        """Nothing is sent unasked."""

    def cancel(self):
        """Nothing is to be undone."""


class SegmentedUpload(_Transfer):
    """A value on its way to the client."""

    def __init__(self, index, sub, value):
        super().__init__(index, sub)
        self._value = value
        self._sent = 0
        self._toggle = 0

    def on_request(self, data):
        """The next segment; raises AbortError."""
        self._toggle = _check_toggle(data[0], sdo.UPLOAD_SEGMENT, self._toggle)
        piece = self._value[self._sent : self._sent + _SEGMENT]
        self._sent += len(piece)
        self.done = self._sent == len(self._value)
        unused = _SEGMENT - len(piece)
        command = sdo.UPLOAD_SEGMENT_RESPONSE | data[0] & sdo.TOGGLE | unused << 1
        return bytes((command | (sdo.LAST_SEGMENT if self.done else 0),)) + piece + bytes(unused)


class SegmentedDownload(_Transfer):
    """A value on its way from the client into `sink`; `size` is as announced, or None."""

    def __init__(self, index, sub, sink, size):
        super().__init__(index, sub)
        self._sink = sink
        self._size = size
        self._received = 0
        self._toggle = 0

    def on_request(self, data):
        """Take the next segment; raises AbortError."""
        command = data[0]
        self._toggle = _check_toggle(command, sdo.DOWNLOAD_SEGMENT, self._toggle)
        piece = data[1 : 8 - (command >> 1 & 7)]
        self._received += len(piece)
        last = command & sdo.LAST_SEGMENT
        _check_size(self._size, self._received, last)
        self._sink.write(piece)
        if last:
            self._sink.finish()
            self.done = True
        return bytes((sdo.DOWNLOAD_SEGMENT_RESPONSE | command & sdo.TOGGLE,)) + bytes(7)

    def cancel(self):
        """Discard the received bytes."""
        self._sink.cancel()


def _check_size(announced, received, last):
    """Compare the bytes received with the announced size, if there is one; raises AbortError."""
    if announced is None:
        return
    if received > announced:
        raise sdo.AbortError(sdo.TOO_LONG)
    if last and received < announced:
        raise sdo.AbortError(sdo.TOO_SHORT)


def _check_toggle(command, specifier, toggle):
    """The toggle bit to expect next; raises AbortError if this one is not as expected."""
    if command & sdo.SPECIFIER != specifier:
        raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
    if command & sdo.TOGGLE != toggle:
        raise sdo.AbortError(sdo.TOGGLE_NOT_ALTERNATED)
    return toggle ^ sdo.TOGGLE


def _begin_block_upload(objects, data, index, sub):
    """The transfer that a request opens, None where one frame does, and its response."""
    if data[0] & sdo.BLOCK_SUBCOMMAND != sdo.BLOCK_INITIATE:
        raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
    value = objects.read(index, sub)
    threshold = data[5]
    if threshold and len(value) <= threshold:
        # The client would rather have so few bytes without blocks.
        return _answer(value, data, index, sub)
    transfer = BlockUpload(index, sub, value, data[0], data[4])
    return transfer, _head(transfer.command, data) + transfer.size.to_bytes(4, "little")


def _begin_block_download(objects, data, index, sub):
    """The transfer that a request opens, and its response; raises AbortError."""
    command = data[0]
    if command & sdo.BLOCK_END:
        raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
    size = int.from_bytes(data[4:8], "little") if command & sdo.BLOCK_SIZE_TOLD else None
    sink = objects.open(index, sub, size)
    transfer = BlockDownload(index, sub, sink, command, size)
    return transfer, _head(transfer.command, data) + bytes((sdo.BLOCK_SEGMENTS, 0, 0, 0))


class BlockDownload(_Transfer):
    """A value on its way from the client into `sink`; `size` is the announced size, or None.

    The sink takes a block before the client gets the acknowledgement. So the client sends nothing
    while flash is written. The last block waits for the end of the transfer, which says how many of
    its bytes count.
    """

    def __init__(self, index, sub, sink, command, size):
        super().__init__(index, sub)
        self.command = sdo.BLOCK_DOWNLOAD_RESPONSE | sdo.BLOCK_CRC
        self._check_crc = command & sdo.BLOCK_CRC
        self._sink = sink
        self._size = size
        self._received = 0
        self._crc = 0
        self._block = bytearray()
        self._sequence = 0
        self._last = self._answer = None
        self.complete = False

    def takes(self, command):
        """All but an abort belong to a block."""
        return command != sdo.ABORT

    def on_request(self, data):
        """Take the next segment, or the end; raises AbortError.

        The last segment of a block comes again where its acknowledgement was lost.
        """
        if data == self._last and not self._sequence:
            return self._answer
        if self.complete:
            return self._end(data)
        sequence = data[0] & sdo.BLOCK_SEQUENCE
        if not 1 <= sequence <= sdo.BLOCK_SEGMENTS:
            raise sdo.AbortError(sdo.INVALID_SEQUENCE)
        if sequence == self._sequence + 1:
            self._take(data)
        if data[0] & sdo.BLOCK_LAST or sequence == sdo.BLOCK_SEGMENTS:
            self._last, self._answer = bytes(data), self._acknowledge()
            return self._answer
        return None

    def _take(self, data):
        self._sequence += 1
        self._block.extend(data[1:])
        self.complete = bool(data[0] & sdo.BLOCK_LAST)

    def _acknowledge(self):
        """Tell the last segment that came in order; the client repeats those after it."""
        sequence = self._sequence
        self._sequence = 0
        if not self.complete:
            self._flush(len(self._block))
        command = sdo.BLOCK_DOWNLOAD_RESPONSE | sdo.BLOCK_ACKNOWLEDGE
        return bytes((command, sequence, sdo.BLOCK_SEGMENTS, 0, 0, 0, 0, 0))

    def _end(self, data):
        command = data[0]
        if command & (sdo.SPECIFIER | sdo.BLOCK_END) != sdo.BLOCK_DOWNLOAD | sdo.BLOCK_END:
            raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
        self._flush(len(self._block) - (command >> 2 & 7))
        if self._check_crc and self._crc != data[1] | data[2] << 8:
            raise sdo.AbortError(sdo.CRC_ERROR)
        _check_size(self._size, self._received, last=True)
        self._sink.finish()
        self.done = True
        return bytes((sdo.BLOCK_DOWNLOAD_RESPONSE | sdo.BLOCK_END,)) + bytes(7)

    def _flush(self, size):
        piece = bytes(self._block[:size])
        self._block = bytearray()
        self._received += len(piece)
        _check_size(self._size, self._received, last=False)
        self._crc = sdo.crc16(piece, self._crc)
        self._sink.write(piece)

    def cancel(self):
        """Discard the received bytes."""
        self._sink.cancel()


class BlockUpload(_Transfer):
    """A value on its way to the client in blocks of at most `block_size` segments."""

    def __init__(self, index, sub, value, command, block_size):
        super().__init__(index, sub)
        self.size = len(value)
        self.command = sdo.BLOCK_UPLOAD_RESPONSE | sdo.BLOCK_CRC | sdo.BLOCK_SIZE_TOLD
        self._with_crc = command & sdo.BLOCK_CRC
        self._value = value
        self._acknowledged = 0
        self._sequence = 0
        self._running = False
        self._ended = False
        self._set_block_size(block_size)

    def takes(self, command):
        """All of block upload but another beginning."""
        initiates = command & sdo.BLOCK_SUBCOMMAND == sdo.BLOCK_INITIATE
        return command & sdo.SPECIFIER == sdo.BLOCK_UPLOAD and not initiates

    def on_request(self, data):
        """Begin, go on after an acknowledgement, or end; raises AbortError."""
        subcommand = data[0] & sdo.BLOCK_SUBCOMMAND
        if subcommand == sdo.BLOCK_START and not self._running:
            self._running = True
        elif subcommand == sdo.BLOCK_ACKNOWLEDGE and self._running and not self._ended:
            return self._on_acknowledge(data[1], data[2])
        elif subcommand == sdo.BLOCK_END and self._ended:
            self.done = True
        else:
            raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
        return None

    def _on_acknowledge(self, sequence, block_size):
        if sequence > self._sequence:
            raise sdo.AbortError(sdo.INVALID_SEQUENCE)
        self._acknowledged += sequence * _SEGMENT
        self._sequence = 0
        self._set_block_size(block_size)
        if self._acknowledged < max(self.size, 1):
            return None
        self._ended = True
        unused = self._acknowledged - self.size
        crc = sdo.crc16(self._value, 0) if self._with_crc else 0
        command = sdo.BLOCK_UPLOAD_RESPONSE | unused << 2 | sdo.BLOCK_END
        return bytes((command, crc & 0xFF, crc >> 8)) + bytes(5)

    def _set_block_size(self, block_size):
        if not 1 <= block_size <= sdo.BLOCK_SEQUENCE:
            raise sdo.AbortError(sdo.INVALID_BLOCK_SIZE)
        self._block_size = block_size

    def pump(self, send):
        """Send segments of the block as long as there is room."""
        while self._running and not self._ended and self._sequence < self._block_size:
            start = self._acknowledged + self._sequence * _SEGMENT
            if self._sequence and start >= self.size:
                return
            piece = self._value[start : start + _SEGMENT]
            last = start + _SEGMENT >= self.size
            command = self._sequence + 1 | (sdo.BLOCK_LAST if last else 0)
            if not send(bytes((command,)) + piece + bytes(_SEGMENT - len(piece))):
                return
            self._sequence += 1


#: Functions that open a transfer, by the command specifier of the request.
_OPENINGS = {
    sdo.UPLOAD: _begin_upload,
    sdo.DOWNLOAD: _begin_download,
    sdo.BLOCK_UPLOAD: _begin_block_upload,
    sdo.BLOCK_DOWNLOAD: _begin_block_download,
}


#: Codes by which a block download ends while its client sends on.
_AMID_A_BLOCK = (sdo.WRONG_STATE, sdo.TIMED_OUT, sdo.INVALID_SEQUENCE)


class SdoServer:
    """Answers requests through `respond(data)`, which returns False when there is no room."""

    def __init__(self, objects, respond):
        self._objects = objects
        self._respond = respond
        self._transfer = None
        self._received_ms = 0
        #: Whether segments of a block download may still come that was ended then.
        self._strays = False
        self._ended_ms = 0
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
        self._strays = self._strays and ticks.diff(now_ms, self._ended_ms) < STRAY_MS
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
        """Open a transfer by a request, and give up an open transfer."""
        begin = _OPENINGS.get(data[0] & sdo.SPECIFIER)
        if begin is None:
            raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
        if self._may_be_stray(data[0]):
            raise sdo.AbortError(sdo.WRONG_STATE)
        self._close()
        transfer, response = begin(self._objects, data, data[1] | data[2] << 8, data[3])
        self._transfer = transfer
        self._respond(response)

    def _may_be_stray(self, command):
        """Whether a request may be a segment of a block that was ended; any write may be."""
        if not (self._strays and 1 <= command & sdo.BLOCK_SEQUENCE <= sdo.BLOCK_SEGMENTS):
            return False
        return ticks.diff(self.now_ms, self._ended_ms) < STRAY_MS

    def _refuse(self, data, code):
        if self._transfer is not None:
            self._abort(self._transfer.index, self._transfer.sub, code)
        else:
            self._abort(data[1] | data[2] << 8, data[3], code)

    def _abort(self, index, sub, code):
        transfer = self._transfer
        amid = isinstance(transfer, BlockDownload) and not transfer.complete
        if amid and code in _AMID_A_BLOCK:
            self._strays, self._ended_ms = True, self.now_ms
        self._close()
        self._respond(sdo.abort(index, sub, code))

    def _close(self):
        if self._transfer is not None:
            self._transfer.cancel()
            self._transfer = None
