"""The cell's object dictionary: packed records, one buffer of values, and ties to what is alive."""

import struct

from mdms_protocol import packed, record, sdo

_RECORD_SIZE = struct.calcsize(record.RECORD)
_COUNT = len(packed.RECORDS) // _RECORD_SIZE
_FORMATS = {0x02: "<b", 0x03: "<h", 0x04: "<i", 0x05: "<B", 0x06: "<H", 0x07: "<I"}


class Record:
    """What the table says about one entry."""

    def __init__(self, position):
        (
            self.index,
            self.sub,
            self.type,
            self.flags,
            self.size,
            self.place,
            self.low,
            self.high,
        ) = struct.unpack_from(record.RECORD, packed.RECORDS, position * _RECORD_SIZE)

    @property
    def format(self):
        """The entry's format for `struct`; None if it is no number."""
        return _FORMATS.get(self.type)


def find(index, sub):
    """The record of an entry; raises AbortError if there is none."""
    position = _position(index, sub)
    if position < _COUNT:
        found = Record(position)
        if found.index == index and found.sub == sub:
            return found
    first = _position(index, 0)
    if first < _COUNT and Record(first).index == index:
        raise sdo.AbortError(sdo.NO_SUCH_SUB_INDEX)
    raise sdo.AbortError(sdo.NO_SUCH_OBJECT)


def _position(index, sub):
    """Of the first record that is not before (index, sub)."""
    wanted = index << 8 | sub
    low = 0
    high = _COUNT
    while low < high:
        middle = (low + high) // 2
        start = middle * _RECORD_SIZE
        row = packed.RECORDS
        if (row[start + 1] << 16 | row[start] << 8 | row[start + 2]) < wanted:
            low = middle + 1
        else:
            high = middle
    return low


class Objects:
    """The values of all entries.

    An entry may be tied to what is alive: `reads` gives functions that return its value, `writes`
    functions that take it, both by `key`. `watchers` are told, by index, of entries that were
    written and stored, and may refuse by raising AbortError.
    """

    def __init__(self):
        self.data = bytearray(packed.DEFAULTS)
        self.reads = {}
        self.writes = {}
        self.watchers = {}

    def read(self, index, sub):
        """An entry's value as bytes, as a client may read it; raises AbortError."""
        entry = find(index, sub)
        if not entry.flags & record.READABLE:
            raise sdo.AbortError(sdo.WRITE_ONLY)
        live = self.reads.get(key(index, sub))
        if live is not None:
            return struct.pack(entry.format, live())
        return bytes(self.data[entry.place : entry.place + entry.size])

    def write(self, index, sub, value):
        """Write an entry from bytes, as a client may; raises AbortError."""
        entry = find(index, sub)
        if not entry.flags & record.WRITABLE:
            raise sdo.AbortError(sdo.READ_ONLY)
        if len(value) != entry.size:
            raise sdo.AbortError(sdo.TOO_LONG if len(value) > entry.size else sdo.TOO_SHORT)
        number = struct.unpack(entry.format, value)[0]
        if entry.flags & record.LIMITED:
            if number > entry.high:
                raise sdo.AbortError(sdo.TOO_HIGH)
            if number < entry.low:
                raise sdo.AbortError(sdo.TOO_LOW)
        take = self.writes.get(key(index, sub))
        if take is not None:
            take(number)
        else:
            self._store(entry, value)

    def _store(self, entry, value):
        start = entry.place
        end = start + entry.size
        before = bytes(self.data[start:end])
        self.data[start:end] = value
        watcher = self.watchers.get(entry.index)
        if watcher is None:
            return
        try:
            watcher(entry.index, entry.sub)
        except sdo.AbortError:
            self.data[start:end] = before
            raise

    def number(self, index, sub=0):
        """The stored number of an entry."""
        entry = find(index, sub)
        return struct.unpack_from(entry.format, self.data, entry.place)[0]

    def put(self, index, sub, number):
        """Store a number in an entry, whoever may write it."""
        entry = find(index, sub)
        struct.pack_into(entry.format, self.data, entry.place, number)

    def reset(self, node_id, flags):
        """Give the entries that have one of these flags their defaults again."""
        for position in range(_COUNT):
            entry = Record(position)
            if entry.flags & flags:
                end = entry.place + entry.size
                self.data[entry.place : end] = packed.DEFAULTS[entry.place : end]
                if entry.flags & record.FROM_NODE:
                    default = struct.unpack_from("<I", packed.DEFAULTS, entry.place)[0]
                    struct.pack_into("<I", self.data, entry.place, default + node_id)


def key(index, sub):
    """What `reads` and `writes` know an entry by."""
    return index << 8 | sub
