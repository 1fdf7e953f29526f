"""Process data of the default PDOs, encoded and decoded by the object table."""

import struct

from mdms_protocol.codecs import cob
from mdms_protocol.dictionary import ENTRIES, RPDO_MAPS, TPDO_MAPS
from mdms_protocol.entry import Entry, OutOfRangeError

#: Letters of `struct` by a signed type's size; unsigned ones are the capitals.
_LETTERS = {1: "b", 2: "h", 4: "i"}


class PdoMap:
    """An ordered set of objects that one frame carries."""

    def __init__(self, base: int, mapping: tuple[int, ...]) -> None:
        self.base = base
        self.entries = tuple(ENTRIES[item >> 16, item >> 8 & 0xFF] for item in mapping)
        self.format = "<" + "".join([_letter(entry) for entry in self.entries])
        self.length = struct.calcsize(self.format)

    def can_id(self, node_id: int) -> int:
        """The identifier that the predefined connection set gives this PDO at a node."""
        return self.base + node_id

    def encode(self, values: tuple[int, ...]) -> bytes:
        """The frame's data, from one integer an object; raises OutOfRangeError, or ValueError."""
        if len(values) != len(self.entries):
            raise ValueError("%d values for %d objects" % (len(values), len(self.entries)))
        for entry, value in zip(self.entries, values):  # noqa: B905
            check(entry, value)
        return struct.pack(self.format, *values)

    def decode(self, data: bytes) -> tuple[int, ...] | None:
        """A tuple of integers, one an object; None for a frame of another length."""
        if len(data) != self.length:
            return None
        return struct.unpack(self.format, data)


def check(entry: Entry, value: int) -> None:
    """Raises OutOfRangeError if a value may not be written to an object."""
    if not entry.low <= value <= entry.high:
        raise OutOfRangeError(
            "0x%04X:%d %s: %r is not in %d..%d"
            % (entry.index, entry.sub, entry.name, value, entry.low, entry.high)
        )


def _letter(entry: Entry) -> str:
    letter = _LETTERS[entry.type.size]
    return letter if entry.type.low else letter.upper()


TARGET_VELOCITY = PdoMap(cob.RPDO_BASES[0], RPDO_MAPS[0])
CONTROLWORD = PdoMap(cob.RPDO_BASES[1], RPDO_MAPS[1])
ACTUAL_VELOCITY = PdoMap(cob.TPDO_BASES[0], TPDO_MAPS[0])
STATUS = PdoMap(cob.TPDO_BASES[1], TPDO_MAPS[1])
