"""Received frames between the CAN interrupt and the background loop."""

REMOTE_OR_EXTENDED = 3  # CAN.FLAG_RTR and CAN.FLAG_EXT_ID of `machine.CAN`


def _slot():
    return [0, memoryview(bytearray(8)), 0, 0]


class Inbox:
    """A ring that a hard interrupt fills and the background empties; it allocates when made only.

    It holds one frame less than its size. At 1 Mbit/s a garbage collection of 11 ms can see 81
    frames of 8 bytes; the cell's filters let a fraction of them through.
    """

    def __init__(self, size=64):
        self._slots = [_slot() for _ in range(size)]
        self._spare = _slot()
        self._size = size
        self._head = 0  # moved by `fill` only
        self._tail = 0  # moved by `pop` only
        self.lost = 0

    def fill(self, can):
        """Take all that the controller has received, as `machine.CAN.recv` gives it."""
        while True:
            following = self._head + 1
            if following == self._size:
                following = 0
            full = following == self._tail
            slot = self._spare if full else self._slots[self._head]
            if can.recv(slot) is None:
                return
            if full:
                self.lost += 1
            else:
                self._head = following
            if slot[3]:
                self.lost += 1

    def peek(self):
        """The oldest frame as [identifier, data, flags, errors], None if there is none."""
        if self._tail == self._head:
            return None
        return self._slots[self._tail]

    def pop(self):
        """Free the slot of the oldest frame."""
        following = self._tail + 1
        self._tail = 0 if following == self._size else following
