"""The cell's object dictionary: packed records, one buffer of values, and hooks of live entries."""

import struct
from collections import namedtuple

from mdms_protocol import packed, record
from mdms_protocol.codecs import sdo

_COUNT = len(packed.RECORDS) // record.RECORD_SIZE - 1
#: Stands for all entries of an object; CiA 301 (7.4.3) gives this sub-index to no value.
WHOLE = 0xFF
_FORMATS = {0x02: "<b", 0x03: "<h", 0x04: "<i", 0x05: "<B", 0x06: "<H", 0x07: "<I"}


class Record:
    """One entry of the record at a position of the table.

    `past` is how far the sub-index lies behind the last of the record; above 0 there is no entry.
    """

    def __init__(self, position, sub):
        self.index, first, kind, self.flags, self._limits, place = _record(position)
        size = _place(position + 1) - place
        self.sub = sub
        self.past = sub - first - (kind >> record.COUNT_SHIFT)
        self.type = kind & record.TYPE
        self.size = size // ((kind >> record.COUNT_SHIFT) + 1)
        self.place = place + (sub - first) * self.size

    @property
    def format(self):
        """The entry's format for `struct`; only a number has one."""
        return _FORMATS[self.type]

    def check_bytes(self, value):
        """Raises AbortError if the number that these bytes make is out of the entry's limits."""
        self.check(struct.unpack(self.format, value)[0])

    def check(self, number):
        """Raises AbortError if the number is out of the entry's limits."""
        if not self._limits:
            return
        at = (self._limits - 1) * record.LIMITS_SIZE
        low, high = struct.unpack_from(record.LIMITS, packed.LIMITS, at)
        if number > high:
            raise sdo.AbortError(sdo.TOO_HIGH)
        if number < low:
            raise sdo.AbortError(sdo.TOO_LOW)


def find(index, sub):
    """The record of an entry; raises AbortError if there is none."""
    found = Record(_position(index, sub), sub)
    if found.index != index:
        raise sdo.AbortError(sdo.NO_SUCH_OBJECT)
    if found.past > 0:
        raise sdo.AbortError(sdo.NO_SUCH_SUB_INDEX)
    return found


def _position(index, sub):
    """Of the last record that does not begin behind (index, sub)."""
    wanted = index << 8 | sub
    low = 0
    high = _COUNT
    while high - low > 1:
        middle = (low + high) // 2
        start = middle * record.RECORD_SIZE
        row = packed.RECORDS
        if (row[start + 1] << 16 | row[start] << 8 | row[start + 2]) <= wanted:
            low = middle
        else:
            high = middle
    return low


class Collected:
    """The value that a client writes to an entry of a few bytes, in one piece or several."""

    def __init__(self, objects, entry):
        self._objects = objects
        self._entry = entry
        self._value = b""

    def write(self, piece):
        """Take some bytes; raises AbortError if they are too many."""
        if len(self._value) + len(piece) > self._entry.size:
            raise sdo.AbortError(sdo.TOO_LONG)
        self._value += piece

    def finish(self):
        """Write the collected value; raises AbortError."""
        self._objects.write(self._entry, self._value)

    def cancel(self):
        """Leave the entry as it is."""


#: The functions of one entry, or of a whole object; each is None where the entry has none.
#: `read()` returns the value, and `write(number)` takes it. `sink(size)` returns the sink of a
#: value of any length (see `Objects.open`). `stored(index, sub)` follows a write that was stored.
#: Of a whole object `read(sub)` comes before each reading, which it refuses by raising AbortError.
Hook = namedtuple("Hook", ("read", "write", "sink", "stored"))
_UNTIED = Hook(None, None, None, None)


class Objects:
    """The values of all entries, and the hooks of those whose values are alive."""

    def __init__(self):
        self.data = bytearray(packed.DEFAULTS)
        self._node_id = 0
        self._hooks = {}

    def tie(self, index, sub, read=None, write=None, sink=None):
        """Give an entry these functions of a hook; it keeps its others."""
        had = self._hook(index, sub)
        hook = Hook(read or had.read, write or had.write, sink or had.sink, None)
        self._hooks[index << 8 | sub] = hook

    def watch(self, watcher, *indices):
        """Call `watcher(index, sub)` when an entry of these objects has been written and stored.

        It refuses the value by raising AbortError.
        """
        hook = Hook(None, None, None, watcher)
        for index in indices:
            self._hooks[index << 8 | WHOLE] = hook

    def _hook(self, index, sub):
        return self._hooks.get(index << 8 | sub, _UNTIED)

    def read(self, index, sub):
        """An entry's value as bytes, as a client may read it; raises AbortError."""
        entry = find(index, sub)
        if not entry.flags & record.READABLE:
            raise sdo.AbortError(sdo.WRITE_ONLY)
        check = self._hook(index, WHOLE).read
        if check is not None:
            check(sub)
        read = self._hook(index, sub).read
        if read is not None:
            return struct.pack(entry.format, read())
        return bytes(self.data[entry.place : entry.place + entry.size])

    def open(self, index, sub, size):
        """A sink with `write`, `finish` and `cancel` for `size` bytes; None: the client gives none.

        Raises AbortError if the entry cannot be written, or not with so many bytes.
        """
        entry = find(index, sub)
        if not entry.flags & record.WRITABLE:
            raise sdo.AbortError(sdo.READ_ONLY)
        sink = self._hook(index, sub).sink
        if sink is not None:
            return sink(size)
        if size is not None:
            check_length(entry, size)
        return Collected(self, entry)

    def write(self, entry, value):
        """Write an entry from bytes, as a client may; raises AbortError."""
        check_length(entry, len(value))
        number = struct.unpack(entry.format, value)[0]
        entry.check(number)
        take = self._hook(entry.index, entry.sub).write
        if take is not None:
            take(number)
        else:
            self._store(entry, value)

    def _store(self, entry, value):
        start = entry.place
        end = start + entry.size
        before = bytes(self.data[start:end])
        self.data[start:end] = value
        watcher = self._hook(entry.index, WHOLE).stored
        if watcher is None:
            return
        try:
            watcher(entry.index, entry.sub)
        except sdo.AbortError:
            self.data[start:end] = before
            raise

    def reader(self, index, sub):
        """A function that returns an entry's number, and its format."""
        entry = find(index, sub)
        read = self._hook(index, sub).read
        if read is None:
            return lambda: struct.unpack_from(entry.format, self.data, entry.place)[0], entry.format
        return read, entry.format

    def stored(self, entries):
        """The bytes of entries, as they are at any time; None if they do not lie in a row.

        Nor does one whose hook reads it. Entries begin with index and sub-index.
        """
        start = end = 0
        for index, sub, *_ in entries:
            entry = find(index, sub)
            if self._hook(index, sub).read is not None or (end and entry.place != end):
                return None
            start = start if end else entry.place
            end = entry.place + entry.size
        return memoryview(self.data)[start:end]

    def writer(self, index, sub):
        """A function that takes an entry's number, and its format."""
        entry = find(index, sub)
        take = self._hook(index, sub).write
        return take or (lambda number: self._take(entry, number)), entry.format

    def _take(self, entry, number):
        """Store a number that nothing is tied to, unless it is out of the entry's limits."""
        try:
            self.write(entry, struct.pack(entry.format, number))
        except sdo.AbortError:
            return

    def number(self, index, sub=0):
        """The stored number of an entry."""
        entry = find(index, sub)
        return struct.unpack_from(entry.format, self.data, entry.place)[0]

    def put(self, index, sub, number):
        """Store a number in an entry, also in one that clients may only read."""
        entry = find(index, sub)
        struct.pack_into(entry.format, self.data, entry.place, number)

    def reset(self, node_id, flags):
        """Give the entries that have one of these flags the defaults that they have at a node."""
        self._node_id = node_id
        for position in _positions(flags):
            start, end = _place(position), _place(position + 1)
            self.data[start:end] = packed.DEFAULTS[start:end]
        for entry in entries(record.FROM_NODE):
            if entry.flags & flags:
                self.data[entry.place : entry.place + entry.size] = default(entry, node_id)

    def restore_default(self, index):
        """Give the entries of a stored object their defaults."""
        for entry in entries(record.STORED_COMMUNICATION | record.STORED_APPLICATION):
            if entry.index == index:
                self.data[entry.place : entry.place + entry.size] = default(entry, self._node_id)

    def changed(self, flags):
        """Yield the entries that differ from their defaults, as (index, sub-index, type, bytes)."""
        for entry in entries(flags):
            value = bytes(self.data[entry.place : entry.place + entry.size])
            if value != default(entry, self._node_id):
                yield entry.index, entry.sub, entry.type, value


def entries(flags):
    """The entries that have one of these flags."""
    for position in _positions(flags):
        _, first, kind, _, _, _ = _record(position)
        for sub in range(first, first + (kind >> record.COUNT_SHIFT) + 1):
            yield Record(position, sub)


def _positions(flags):
    """The records whose entries have one of these flags."""
    for position in range(_COUNT):
        if packed.RECORDS[position * record.RECORD_SIZE + record.FLAGS_AT] & flags:
            yield position


def _record(position):
    return struct.unpack_from(record.RECORD, packed.RECORDS, position * record.RECORD_SIZE)


def _place(position):
    """Where the entries of a record begin, or where those of the one before end."""
    end = (position + 1) * record.RECORD_SIZE
    return packed.RECORDS[end - 2] | packed.RECORDS[end - 1] << 8


def default(entry, node_id):
    """The default that an entry has at a node, as bytes."""
    value = packed.DEFAULTS[entry.place : entry.place + entry.size]
    if entry.flags & record.FROM_NODE:
        return (int.from_bytes(value, "little") + node_id).to_bytes(entry.size, "little")
    return value


def check_length(entry, size):
    """Raises AbortError if a value of so many bytes does not fit the entry."""
    if size != entry.size:
        raise sdo.AbortError(sdo.TOO_LONG if size > entry.size else sdo.TOO_SHORT)
