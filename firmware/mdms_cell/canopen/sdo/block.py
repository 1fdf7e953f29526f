"""Block SDO transfers (CiA 301, 7.2.4.2.9 to 7.2.4.2.16): many segments to one answer."""

from mdms_cell.canopen.sdo.segmented import answer, check_size, head
from mdms_protocol.codecs import sdo

_SEGMENT = 7


def begin_upload(objects, data, index, sub):
    """The transfer that a request opens, None where one frame does, and its response."""
    if data[0] & sdo.BLOCK_SUBCOMMAND != sdo.BLOCK_INITIATE:
        raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
    value = objects.read(index, sub)
    threshold = data[5]
    if threshold and len(value) <= threshold:
        # The client would rather have so few bytes without blocks.
        return answer(value, data, index, sub)
    transfer = BlockUpload(index, sub, value, data[0], data[4])
    return transfer, head(transfer.command, data) + transfer.size.to_bytes(4, "little")


def begin_download(objects, data, index, sub):
    """The transfer that a request opens, and its response; raises AbortError."""
    command = data[0]
    if command & sdo.BLOCK_END:
        raise sdo.AbortError(sdo.UNKNOWN_COMMAND)
    size = int.from_bytes(data[4:8], "little") if command & sdo.BLOCK_SIZE_TOLD else None
    sink = objects.open(index, sub, size)
    transfer = BlockDownload(index, sub, sink, command, size)
    return transfer, head(transfer.command, data) + bytes((sdo.BLOCK_SEGMENTS, 0, 0, 0))


class BlockDownload:
    """A value on its way from the client into `sink`; `size` is what the client announced, or None.

    The sink has a block before the client gets the acknowledgement, and so sends nothing while
    flash is written; the last block waits for the end, which gives how many of its bytes count.
    """

    def __init__(self, index, sub, sink, command, size):
        self.index = index
        self.sub = sub
        self.done = False
        self.command = sdo.BLOCK_DOWNLOAD_RESPONSE | sdo.BLOCK_CRC
        self._check_crc = command & sdo.BLOCK_CRC
        self._sink = sink
        self._size = size
        self._received = 0
        self._crc = 0
        self._block = bytearray()
        self._sequence = 0
        self._complete = False

    def takes(self, command):
        """Whether a request belongs to this transfer; in a block, all but an abort do."""
        return command != sdo.ABORT

    def on_request(self, data):
        """Take the next segment, or the end; raises AbortError."""
        if self._complete:
            return self._end(data)
        sequence = data[0] & sdo.BLOCK_SEQUENCE
        if not 1 <= sequence <= sdo.BLOCK_SEGMENTS:
            raise sdo.AbortError(sdo.INVALID_SEQUENCE)
        if sequence == self._sequence + 1:
            self._take(data)
        if data[0] & sdo.BLOCK_LAST or sequence == sdo.BLOCK_SEGMENTS:
            return self._acknowledge()
        return None

    def _take(self, data):
        self._sequence += 1
        self._block.extend(data[1:])
        self._complete = bool(data[0] & sdo.BLOCK_LAST)

    def _acknowledge(self):
        """Tell the last segment that came in order; the client repeats those after it."""
        sequence = self._sequence
        self._sequence = 0
        if not self._complete:
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
        check_size(self._size, self._received, last=True)
        self._sink.finish()
        self.done = True
        return bytes((sdo.BLOCK_DOWNLOAD_RESPONSE | sdo.BLOCK_END,)) + bytes(7)

    def _flush(self, size):
        piece = bytes(self._block[:size])
        self._block = bytearray()
        self._received += len(piece)
        check_size(self._size, self._received, last=False)
        self._crc = sdo.crc16(piece, self._crc)
        self._sink.write(piece)

    def pump(self, _send):
        """Nothing is sent unasked."""

    def cancel(self):
        """Throw away what has come."""
        self._sink.cancel()


class BlockUpload:
    """A value on its way to the client in blocks of at most `block_size` segments."""

    def __init__(self, index, sub, value, command, block_size):
        self.index = index
        self.sub = sub
        self.done = False
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
        """Whether a request belongs to this transfer rather than opens another."""
        return (
            command & sdo.SPECIFIER == sdo.BLOCK_UPLOAD
            and command & sdo.BLOCK_SUBCOMMAND != sdo.BLOCK_INITIATE
        )

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

    def cancel(self):
        """Nothing is to be undone."""
