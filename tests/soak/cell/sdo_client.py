"""An SDO client of every transfer type, as generators that yield what to send, or None to wait.

The caller resumes them once a millisecond and puts the cell's answers in `Client.responses`.
"""

from mdms_protocol.codecs import sdo

_PATIENCE_MS = 200
_SEGMENT = 7


class Client:
    """Reads and writes objects; errors are told to `watch`."""

    def __init__(self, watch):
        self._watch = watch
        self.responses = []

    def ask(self, request):
        """Send a request; return the response."""
        self.responses.clear()
        yield request
        response = yield from self.next(_PATIENCE_MS)
        self._watch.expect(response is not None, f"no answer to {request}")
        return response or bytes(8)

    def next(self, patience_ms):
        """Wait for a response; None if there is none."""
        for _ in range(patience_ms):
            if self.responses:
                return self.responses.pop(0)
            yield None
        return None

    def write(self, index, sub, value):
        """Write 1 to 4 bytes at once."""
        response = yield from self.ask(sdo.write_request(index, sub, value))
        self._done(index, sub, response[0] == sdo.DOWNLOAD_RESPONSE)

    def refused(self, index, sub, value, code):
        """Write a value that is to be refused with this abort code."""
        response = yield from self.ask(sdo.write_request(index, sub, value))
        self._done(index, sub, response == sdo.abort(index, sub, code))

    def read(self, index, sub):
        """Read at once or in segments, as the server likes; return the bytes."""
        response = yield from self.ask(sdo.read_request(index, sub))
        if response[0] & sdo.EXPEDITED:
            return response[4 : 8 - (response[0] >> 2 & 3)]
        size = int.from_bytes(response[4:8], "little")
        value = b""
        command = sdo.UPLOAD_SEGMENT
        last = 0
        while not last and len(value) < size:
            response = yield from self.ask(bytes((command,)) + bytes(7))
            value += response[1 : 8 - (response[0] >> 1 & 7)]
            last = response[0] & sdo.LAST_SEGMENT
            command ^= sdo.TOGGLE
        self._done(index, sub, last and len(value) == size)
        return value

    def write_segments(self, index, sub, value, told=True):
        """Write in segments."""
        head = sdo.DOWNLOAD | (sdo.SIZE_TOLD if told else 0)
        size = (len(value) if told else 0).to_bytes(4, "little")
        response = yield from self.ask(_head(head, index, sub) + size)
        command = sdo.DOWNLOAD_SEGMENT
        for start in range(0, len(value), _SEGMENT):
            piece = value[start : start + _SEGMENT]
            unused = _SEGMENT - len(piece)
            last = sdo.LAST_SEGMENT if start + _SEGMENT >= len(value) else 0
            request = bytes((command | unused << 1 | last,)) + piece + bytes(unused)
            response = yield from self.ask(request)
            command ^= sdo.TOGGLE
        self._done(index, sub, response[0] & sdo.SPECIFIER == sdo.DOWNLOAD_SEGMENT_RESPONSE)

    def read_block(self, index, sub, block_size):
        """Read in blocks, with a check sum; return the bytes."""
        head = _head(sdo.BLOCK_UPLOAD | sdo.BLOCK_CRC, index, sub)
        response = yield from self.ask(head + bytes((block_size, 0, 0, 0)))
        size = int.from_bytes(response[4:8], "little")
        value = b""
        response = yield from self.ask(bytes((sdo.BLOCK_UPLOAD | sdo.BLOCK_START,)) + bytes(7))
        while True:
            value += response[1:]
            if response[0] & sdo.BLOCK_LAST or response[0] & sdo.BLOCK_SEQUENCE == block_size:
                sequence = response[0] & sdo.BLOCK_SEQUENCE
                head = bytes((sdo.BLOCK_UPLOAD | sdo.BLOCK_ACKNOWLEDGE, sequence, block_size))
                last = response[0] & sdo.BLOCK_LAST
                response = yield from self.ask(head + bytes(5))
                if last:
                    break
            else:
                response = (yield from self.next(_PATIENCE_MS)) or bytes(8)
        value = value[:size]
        crc = response[1] | response[2] << 8
        self._done(index, sub, crc == sdo.crc16(value, 0))
        yield bytes((sdo.BLOCK_UPLOAD | sdo.BLOCK_END,)) + bytes(7)
        return value

    def write_block(self, index, sub, value, lost=-1):
        """Write in blocks, with a check sum; segment `lost` gets lost the first time."""
        head = _head(sdo.BLOCK_DOWNLOAD | sdo.BLOCK_CRC | sdo.BLOCK_SIZE_TOLD, index, sub)
        response = yield from self.ask(head + len(value).to_bytes(4, "little"))
        block_size = response[4]
        sent = 0
        while sent < len(value):
            response = yield from self._write_some(value, sent, block_size, lost)
            sent += response[1] * _SEGMENT
            lost = -1
        unused = sent - len(value)
        crc = sdo.crc16(value, 0)
        end = sdo.BLOCK_DOWNLOAD | unused << 2 | sdo.BLOCK_END
        response = yield from self.ask(bytes((end, crc & 0xFF, crc >> 8)) + bytes(5))
        self._done(index, sub, response[0] == sdo.BLOCK_DOWNLOAD_RESPONSE | sdo.BLOCK_END)

    def _write_some(self, value, sent, block_size, lost):
        """Send a block; return its acknowledgement."""
        for place in range(block_size):
            start = sent + place * _SEGMENT
            last = start + _SEGMENT >= len(value)
            piece = value[start : start + _SEGMENT]
            command = place + 1 | (sdo.BLOCK_LAST if last else 0)
            segment = bytes((command,)) + piece + bytes(_SEGMENT - len(piece))
            if last or place + 1 == block_size:
                return (yield from self.ask(segment))
            yield None if start // _SEGMENT == lost else segment
        return None

    def _done(self, index, sub, holds):
        self._watch.expect(holds, f"SDO transfer of 0x{index:04X}:{sub}")


def _head(command, index, sub):
    return bytes((command, index & 0xFF, index >> 8, sub))
