"""Which firmware is to start: 84 bytes that mean the same to firmware of every version."""

import binascii
import struct

#: magic, confirmed slot, slot on trial, starts left, outcome, counter, counter on trial, digests
_LAYOUT = "<4sBBBBII32s32s"
_SIZE = 80
_MAGIC = b"MDM1"
_CRC_SIZE = 4
_NO_DIGEST = bytes(32)


class Record:
    """Slots count from 1; 0 stands for the firmware that USB has brought, and for none.

    The slot on `trial` may be started `starts` times more. `counter` is that of the newest bundle
    that was confirmed, `trial_counter` of the one on trial. `rolled_back` is 1 after a trial that
    led to nothing. `digests` are the SHA-256 of the slots' images.
    """

    def __init__(self, data=b""):
        self.confirmed = self.trial = self.starts = self.rolled_back = 0
        self.counter = self.trial_counter = 0
        self.digests = [_NO_DIGEST, _NO_DIGEST]
        if len(data) == _SIZE + _CRC_SIZE and data[:4] == _MAGIC and data[_SIZE:] == _crc(data):
            self._take(struct.unpack(_LAYOUT, data[:_SIZE]))

    def _take(self, fields):
        _, confirmed, trial, self.starts, self.rolled_back = fields[:5]
        self.confirmed, self.trial = confirmed % 3, trial % 3
        self.counter, self.trial_counter = fields[5:7]
        self.digests = list(fields[7:])

    def pack(self):
        """The record as bytes."""
        data = struct.pack(
            _LAYOUT,
            _MAGIC,
            self.confirmed,
            self.trial,
            self.starts,
            self.rolled_back,
            self.counter,
            self.trial_counter,
            self.digests[0],
            self.digests[1],
        )
        return data + _crc(data)


def _crc(data):
    return binascii.crc32(bytes(data[:_SIZE])).to_bytes(_CRC_SIZE, "little")
