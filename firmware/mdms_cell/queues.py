"""Frames between the CAN controller and the background loop, in both directions."""

try:
    import micropython
except ImportError:
    from mdms_protocol.cpython import micropython, ptr8

REMOTE_OR_EXTENDED = 3  # CAN.FLAG_RTR and CAN.FLAG_EXT_ID of `machine.CAN`

# A frame in the ring: two bytes of its identifier, one each of length, flags and errors, the data
_LENGTH = 2
_FLAGS = 3
_ERRORS = 4
_DATA = 5
_SIZE = 13
_DATA_MAX = 8
#: What `machine.CAN.recv` may write, whatever the buffer's length: a DLC of 9 to 15 means 8 bytes
#: on a classic bus, but the port returns up to 15 (bxCAN, FlexCAN) or 64 (FDCAN).
_RECV_MAX = 64
#: CAN.RECV_ERR_OVERRUN: a frame was lost before this one. The other error, a full FIFO, lost none.
_OVERRUN = 2


@micropython.viper
def _copy(ring: ptr8, start: int, data: ptr8, length: int):
    place = 0
    while place < length:
        ring[start + place] = data[place]
        place += 1


class Inbox:
    """A ring that a hard interrupt fills and the background empties; taking allocates nothing.

    It holds one frame less than its size. At 1 Mbit/s a garbage collection of 11 ms can see 81
    frames of 8 bytes; the cell's filters let a fraction of them through.
    """

    def __init__(self, size=64):
        self._ring = bytearray(size * _SIZE)
        self._received = [0, memoryview(bytearray(_RECV_MAX)), 0, 0]
        self._head = 0  # moved by `take` only
        self._tail = 0  # moved by `pop` only
        self.lost = 0

    def take(self, can):
        """Take one frame that the controller has received, as `machine.CAN.recv` gives it.

        One at a time, for MicroPython's controller of an STM32F4 sleeps, in the interrupt, for up
        to a millisecond when it is asked for a frame that it does not have.
        """
        frame = self._received
        if can.recv(frame) is None:
            return
        following = self._after(self._head)
        if following == self._tail:
            self.lost += 1
        else:
            self._keep(self._head, frame)
            self._head = following
        if frame[3] & _OVERRUN:
            self.lost += 1

    def _keep(self, start, frame):
        ring = self._ring
        ring[start] = frame[0] & 0xFF
        ring[start + 1] = frame[0] >> 8 & 0xFF
        length = min(len(frame[1]), _DATA_MAX)
        ring[start + _LENGTH] = length
        ring[start + _FLAGS] = frame[2] & 0xFF
        ring[start + _ERRORS] = frame[3] & 0xFF
        # Viper takes any buffer; the stubs take bytes alone.
        _copy(ring, start + _DATA, frame[1], length)  # pyright: ignore[reportArgumentType]

    def _after(self, start):
        following = start + _SIZE
        return 0 if following == len(self._ring) else following

    def peek(self):
        """The oldest frame as (identifier, data, flags, errors), None if there is none."""
        ring = self._ring
        start = self._tail
        if start == self._head:
            return None
        data = bytes(ring[start + _DATA : start + _DATA + ring[start + _LENGTH]])
        can_id = ring[start] | ring[start + 1] << 8
        return can_id, data, ring[start + _FLAGS], ring[start + _ERRORS]

    def pop(self):
        """Give up the oldest frame."""
        self._tail = self._after(self._tail)


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

        It takes none while its mailboxes are full and, on an STM32, while one with the same
        identifier waits. In bus-off ports take frames as ever, though MicroPython's manual has them
        raise OSError: the board calls this only while the bus is not off.
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
