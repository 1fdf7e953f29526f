"""Draws seeded frames for a cell: services in their order, some frames lost, doubled or spoilt.

Among them are frames from anywhere, settings of any value, and readings of every object.
"""

from fuzz_services import SEQUENCES, SERVER, head

from mdms_protocol import packed, record
from mdms_protocol.codecs import sdo

#: Flags of `machine.CAN`: remote, extended.
_FLAGS = 4
#: The registers that `Frames` writes of an axis: all its settings and its target.
_SETTINGS = tuple(
    [index for index in range(0x2000, 0x2009) if index != 0x2003]
    + [0x606D, 0x606E, 0x6073, 0x6075, 0x607E, 0x6083, 0x6084, 0x6085, 0x60F8, 0x60FF]
)


class Chance:
    """Pseudo-random numbers that need no more than 31 bits (Lehmer, modulus 65537, two streams)."""

    def __init__(self, seed):
        self._first = seed % 65536 + 1
        self._second = seed // 65536 % 65536 + 7

    def below(self, limit):
        """A number from 0 to limit - 1, limit at most 2048."""
        self._first = self._first * 75 % 65537
        self._second = self._second * 74 % 65537
        return ((self._first ^ self._second) >> 3) % limit


class Frames:
    """An endless stream; `draw` gives the next frame as (identifier, data, flags), or an event."""

    def __init__(self, chance):
        self._chance = chance
        self._sequence = ()
        self._place = 0

    def draw(self):
        """The next frame as (identifier, data, flags), or an event."""
        below = self._chance.below
        kind = below(64)
        if kind < 3:
            return self._from_anywhere(below(2048))
        if kind < 6:
            return self._from_anywhere(self._own())
        if kind < 9:
            return self._setting()
        if kind < 11:
            return self._reading()
        frame = self._next()
        if frame[0] < 0:
            return frame[0], frame[1], 0
        return self._spoil(frame, below(48))

    def _next(self):
        """The next frame of the sequence, or the first of another."""
        if self._place >= len(self._sequence):
            self._sequence = SEQUENCES[self._chance.below(len(SEQUENCES))]
            self._place = 0
        frame = self._sequence[self._place]
        # Now and then one is lost, or comes twice.
        luck = self._chance.below(64)
        self._place += 2 if luck == 0 else 0 if luck == 1 else 1
        return frame

    def _spoil(self, frame, how):
        can_id, data = frame
        if how == 0:
            return can_id, data[: self._chance.below(9)], 0
        if how == 1 and data:
            changed = bytearray(data)
            changed[self._chance.below(len(data))] = self._chance.below(256)
            return can_id, bytes(changed), 0
        return can_id, data, self._chance.below(_FLAGS) if how == 2 else 0

    def _own(self):
        """An identifier that means something to the cell."""
        sequence = SEQUENCES[self._chance.below(len(SEQUENCES))]
        can_id = sequence[self._chance.below(len(sequence))][0]
        return can_id if can_id >= 0 else SERVER

    def _from_anywhere(self, can_id):
        below = self._chance.below
        return can_id, bytes([below(256) for _ in range(below(9))]), 0

    def _setting(self):
        """Write a setting of an axis: any number of its size, small ones most of the time."""
        below = self._chance.below
        index = _SETTINGS[below(len(_SETTINGS))] + 0x800 * below(2)
        number = bytes([below(256) if below(3) == 0 else 0 for _ in range(4)])
        # Where no size is told, the server takes the entry's own.
        return SERVER, head(sdo.DOWNLOAD | sdo.EXPEDITED, index, 0) + number, 0

    def _reading(self):
        """Read any entry of the dictionary, or one that its object lacks."""
        row = self._chance.below(len(packed.RECORDS) // record.RECORD_SIZE) * record.RECORD_SIZE
        rows = packed.RECORDS
        sub = (rows[row + 2] + self._chance.below(record.RUN_MAX)) & 0xFF
        return SERVER, sdo.read_request(rows[row] | rows[row + 1] << 8, sub), 0
