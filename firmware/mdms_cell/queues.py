"""Frames between the CAN controller and the background loop, in both directions."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr8

from struct import unpack_from

REMOTE_OR_EXTENDED = 3  # CAN.FLAG_RTR and CAN.FLAG_EXT_ID of `machine.CAN`

# A frame in the ring: two bytes of its identifier, its length, eight of data, flags, errors
_LENGTH = const(2)
_DATA = const(3)
_FLAGS = const(11)
_ERRORS = const(12)
_SIZE = const(13)
_DATA_MAX = const(8)
#: How `struct` reads one, by its length.
_LAYOUTS = tuple("<Hx%ds%dxBB" % (length, _DATA_MAX - length) for length in range(_DATA_MAX + 1))
#: What `machine.CAN.recv` may write, whatever the buffer's length: a DLC of 9 to 15 means 8 bytes
#: on a classic bus, but the port returns up to 15 (bxCAN, FlexCAN) or 64 (FDCAN).
_RECV_MAX = const(64)
#: CAN.RECV_ERR_OVERRUN: a frame was lost before this one. The other error, a full FIFO, lost none.
_OVERRUN = const(2)


@micropython.viper
def _write(  # noqa: PLR0917 - viper takes words
    ring: ptr8, start: int, can_id: int, data: ptr8, length: int, flags: int, errors: int
):
    length = length if length < _DATA_MAX else _DATA_MAX
    ring[start] = can_id & 0xFF
    ring[start + 1] = can_id >> 8 & 0xFF
    ring[start + _LENGTH] = length
    ring[start + _FLAGS] = flags & 0xFF
    ring[start + _ERRORS] = errors & 0xFF
    for place in range(length):
        ring[start + _DATA + place] = data[place]


class Inbox:
    """A ring that a hard interrupt fills and the background empties; taking allocates nothing.

    It holds one frame less than its size. At 1 Mbit/s a garbage collection of 11 ms can see 81
    frames of 8 bytes; the cell's filters let a fraction of them through.
    """

    def __init__(self, size=64):
        self._end = size * _SIZE
        self._ring = bytearray(self._end)
        self._received = [0, memoryview(bytearray(_RECV_MAX)), 0, 0]
        self._head = 0  # moved by `take` only
        self._tail = 0  # moved by `pop` only
        self.lost = 0

    @micropython.native
    def take(self, can):
        """Take one frame that the controller has received, as `machine.CAN.recv` gives it.

        One at a time, for MicroPython's controller of an STM32F4 sleeps, in the interrupt, for up
        to a millisecond when it is asked for a frame that it does not have.
        """
        frame = self._received
        if can.recv(frame) is None:
            return
        start = self._head
        following = start + _SIZE
        if following == self._end:
            following = 0
        errors = frame[3]
        if following == self._tail:
            self.lost += 1
        else:
            data = frame[1]
            _write(self._ring, start, frame[0], data, len(data), frame[2], errors)
            self._head = following
        if errors & _OVERRUN:
            self.lost += 1

    @micropython.native
    def peek(self):
        """The oldest frame as (identifier, data, flags, errors), None if there is none."""
        ring = self._ring
        start = self._tail
        if start == self._head:
            return None
        return unpack_from(_LAYOUTS[ring[start + _LENGTH]], ring, start)

    @micropython.native
    def pop(self):
        """Give up the oldest frame."""
        following = self._tail + _SIZE
        self._tail = 0 if following == self._end else following


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
