"""Frames that wait for a free mailbox of the CAN controller."""


class Outbox:
    """A queue in front of `machine.CAN.send`, used by the background loop only."""

    def __init__(self, size=32):
        self._identifiers = [0] * size
        self._data = [b""] * size
        self._size = size
        self._first = 0
        self._count = 0

    def push(self, can_id, data):
        """Queue a frame; False when there is no room."""
        if self._count == self._size:
            return False
        place = (self._first + self._count) % self._size
        self._identifiers[place] = can_id
        self._data[place] = bytes(data)
        self._count += 1
        return True

    def drain(self, send):
        """Hand over frames in their order, as many as the controller takes.

        It takes none while its mailboxes are full, while one with the same identifier waits, and
        while the bus is off, which it tells by raising OSError.
        """
        while self._count:
            try:
                taken = send(self._identifiers[self._first], self._data[self._first])
            except OSError:
                return
            if taken is None:
                return
            self._data[self._first] = b""  # what has gone is not to be kept
            self._first = (self._first + 1) % self._size
            self._count -= 1

    def clear(self):
        """Forget all that waits."""
        self._count = 0
