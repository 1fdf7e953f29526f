"""Two slots for firmware that comes over the bus, beside the one that USB has brought.

A slot has the image of a read-only file system, compressed. A new image is started once, on trial,
and stays only if it is confirmed. Otherwise the next start brings back the one before. A slot that
is not whole is never started. The record of 84 bytes says which firmware is to start. It means the
same to firmware of every version.
"""

import binascii
import hashlib
import struct

#: magic, confirmed slot, slot on trial, starts left, outcome, counter, counter on trial, digests
_LAYOUT = "<4sBBBBII32s32s"
_SIZE = 80
_MAGIC = b"MDM1"
_CRC_SIZE = 4
_NO_DIGEST = bytes(32)
RECORD = "mdms_slots/record"
_SLOTS = ("mdms_slots/1", "mdms_slots/2")
#: Of no slot, and of no firmware that USB has brought: it stays when USB brings other firmware.
KEY = "update.key"
#: A new slot is started so often before it has to be confirmed.
TRIAL_STARTS = 1


class SlotRecord:
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


class Slots:
    """The slots in `files`, see `mdms_boot.files`.

    `running` is the slot that was started, 0 for none, and `on_trial` whether it is to be
    confirmed. `may_write()` is asked before anything is written; it is the board's to say.
    """

    def __init__(self, files):
        self._files = files
        self.running = 0
        self.on_trial = False
        self.may_write = _always
        self.record = SlotRecord(self._content(RECORD))

    def start(self):
        """The image to start, None for the firmware that USB has brought; once, at power-up."""
        record = self.record
        if record.trial:
            image = self._try(record)
            if image is not None:
                return image
            record.trial, record.rolled_back = 0, 1
            self._keep_if_possible()
        if record.confirmed:
            image = self._image(record.confirmed)
            if image is not None:
                self.running = record.confirmed
        else:
            image = None
        return image

    def _try(self, record):
        """The image on trial; None if it has had its starts, or is not whole."""
        if not record.starts:
            return None
        record.starts -= 1
        if not self._keep_if_possible():
            return None  # it could be started for ever
        image = self._image(record.trial)
        if image is not None:
            self.running, self.on_trial = record.trial, True
        return image

    def _image(self, slot):
        """The image in a slot; None if it is not whole, or finds no room in memory."""
        try:
            whole = self._hash(slot)[1] == self.record.digests[slot - 1]
            return self._files.unpack(_SLOTS[slot - 1]) if whole else None
        except (OSError, MemoryError, EOFError):
            # A stream that ends too soon is an EOFError.
            return None

    # Called by the firmware

    @property
    def identification(self):
        """A number that stands for the firmware that runs; 0 for the one that USB has brought."""
        if not self.running:
            return 0
        return int.from_bytes(self.record.digests[self.running - 1][:4], "little")

    @property
    def spare(self):
        """The slot that is not confirmed; it may be written, except while it is on trial."""
        return 2 if self.record.confirmed == 1 else 1

    def key(self):
        """The array's key, empty if there is none."""
        return self._content(KEY)

    def keep_key(self, key):
        """Keep the array's key; raises OSError."""
        self._check()
        self._files.replace(KEY, key)

    def clear(self):
        """Make the spare slot empty, and end the record of a trial; raises OSError."""
        self._check()
        record = self.record
        record.trial = record.starts = record.rolled_back = 0
        self._keep()
        self._files.remove(_SLOTS[self.spare - 1])

    def create(self):
        """The spare slot, open to be written a piece at a time; raises OSError."""
        self._check()
        return self._files.create(_SLOTS[self.spare - 1])

    def remove(self):
        """Remove the contents of the spare slot."""
        self._files.remove(_SLOTS[self.spare - 1])

    def digest(self):
        """Bytes in the spare slot, and their SHA-256, as flash has them; raises OSError."""
        return self._hash(self.spare)

    def arm(self, digest, counter):
        """Have the spare slot started on trial at the next start; raises OSError."""
        self._check()
        record = self.record
        record.digests[self.spare - 1] = digest
        record.trial, record.starts, record.trial_counter = self.spare, TRIAL_STARTS, counter
        self._keep()

    def confirm(self):
        """The slot on trial stays; raises OSError."""
        self._check()
        record = self.record
        record.confirmed, record.counter = self.running, record.trial_counter
        record.trial = record.starts = 0
        self._keep()
        self.on_trial = False

    def _hash(self, slot):
        hash_ = hashlib.sha256()
        path = _SLOTS[slot - 1]
        self._files.check(path, hash_)
        return self._files.size(path), hash_.digest()

    def _content(self, path):
        try:
            return self._files.read(path)
        except OSError:
            return b""

    def _check(self):
        if not self.may_write():
            raise OSError("flash is written only while both bridges sleep")

    def _keep(self):
        self._files.replace(RECORD, self.record.pack())

    def _keep_if_possible(self):
        try:
            self._keep()
        except OSError:
            return False
        return True


def _always():
    return True
