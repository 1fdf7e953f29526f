"""A gateway between two buses: frames that its tables list, each under another identifier.

It carries states, of which only the newest counts. So one frame of an identifier waits at most, and
none longer than the time limit: what a bus does not take in time is dropped and counted.
"""

from mdms_cell import ticks

_DATA_MAX = 8
#: One SYNC: then the next state of the same sender is due.
LIMIT_MS = 10


class Way:
    """One direction: `table` maps the identifiers that come in to those that leave.

    `forwarded` counts frames that the other bus has taken, `replaced` those that a newer one of
    their identifier has overtaken, `overdue` those that waited for too long. Memory is allocated
    here, once.
    """

    def __init__(self, table, limit_ms=LIMIT_MS):
        self.identifiers = tuple(table)
        self.forwarded = 0
        self.replaced = 0
        self.overdue = 0
        self._limit_ms = limit_ms
        size = len(self.identifiers)
        self._places = {can_id: place for place, can_id in enumerate(self.identifiers)}
        self._leaving = [table[can_id] for can_id in self.identifiers]
        self._data = bytearray(size * _DATA_MAX)
        self._lengths = bytearray(size)
        self._since_ms = [0] * size
        self._waiting = bytearray(size)
        # Places that wait, the oldest first; each is in it once, so it never runs over.
        self._order = [0] * size
        self._first = 0
        self._count = 0

    @property
    def waiting(self):
        """How many frames wait for the other bus."""
        return self._count

    @property
    def dropped(self):
        """How many frames were listed and have not been forwarded."""
        return self.replaced + self.overdue

    def take(self, can_id, data, now_ms):
        """Take in a frame; one that is not listed, or too long for a classic bus, does nothing."""
        place = self._places.get(can_id)
        if place is None or len(data) > _DATA_MAX:
            return
        if self._waiting[place]:
            # It keeps its turn: one that comes often does not stay behind for that.
            self.replaced += 1
        else:
            self._order[(self._first + self._count) % len(self._order)] = place
            self._count += 1
            self._waiting[place] = 1
        start = place * _DATA_MAX
        self._data[start : start + len(data)] = data
        self._lengths[place] = len(data)
        self._since_ms[place] = now_ms

    def drain(self, send, now_ms):
        """Hand over what waits, oldest first, as `send(can_id, data)` takes it (None: no room)."""
        while self._count:
            place = self._order[self._first]
            if ticks.diff(now_ms, self._since_ms[place]) > self._limit_ms:
                self.overdue += 1
            elif send(self._leaving[place], self._frame_data(place)) is None:
                return
            else:
                self.forwarded += 1
            self._waiting[place] = 0
            self._first = (self._first + 1) % len(self._order)
            self._count -= 1

    def _frame_data(self, place):
        start = place * _DATA_MAX
        return bytes(self._data[start : start + self._lengths[place]])


class Gateway:
    """Two ways: `ways[0]` from the first bus to the second, `ways[1]` back.

    Raises ValueError for tables by which a frame would come back, or two become one: what leaves on
    a bus must not be among what comes in there, nor be listed twice.
    """

    def __init__(self, there, back, limit_ms=LIMIT_MS):
        for table, other in ((there, back), (back, there)):
            leaving = set(table.values())
            if len(leaving) != len(table):
                raise ValueError("two identifiers would leave as one")
            if leaving & set(other):
                raise ValueError("identifier 0x%X would come back" % min(leaving & set(other)))
        self.ways = (Way(there, limit_ms), Way(back, limit_ms))
