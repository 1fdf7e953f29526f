"""Frames between the CAN controller and the background loop, in both directions."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr8, ptr16, ptr32

from array import array
from struct import unpack_from

from mdms_cell.drive.speed_loop import TICKS
from mdms_cell.mailboxes import BOX_BITS, KNOWN, NO_BOX, STAMP

REMOTE_OR_EXTENDED = 3  # CAN.FLAG_RTR and CAN.FLAG_EXT_ID of `machine.CAN`

# A frame in the ring: two bytes of its identifier, its length, eight of data, flags, errors, and
# the last byte of the tick in which it came
_LENGTH = const(2)
_DATA = const(3)
_FLAGS = const(11)
_ERRORS = const(12)
_CAME = const(13)
_SIZE = const(14)
_DATA_MAX = const(8)
#: How `struct` reads one, by its length.
_LAYOUTS = tuple("<Hx%ds%dxBBB" % (length, _DATA_MAX - length) for length in range(_DATA_MAX + 1))
#: What `machine.CAN.recv` may write, whatever the buffer's length: a DLC of 9 to 15 means 8 bytes
#: on a classic bus, but the port returns up to 15 (bxCAN, FlexCAN) or 64 (FDCAN).
_RECV_MAX = const(64)
_TICKS = const(102)
assert _TICKS == TICKS
#: CAN.RECV_ERR_OVERRUN: a frame was lost before this one. The other error, a full FIFO, lost none.
_OVERRUN = const(2)


# Where the ring begins and ends
_HEAD = const(0)  # moved by `take` only
_TAIL = const(1)  # moved by `sort` and `pop` only
_END = const(2)


@micropython.viper
def _put(  # noqa: PLR0917 - viper takes words
    ring: ptr8,
    ends: ptr32,
    registers: ptr32,
    can_id: int,
    data: ptr8,
    length: int,
    flags: int,
    errors: int,
) -> int:
    """Write a frame into the ring; returns how many are lost.

    That is this one, where there is no room, and one before it, where the controller says so.
    """
    lost = 1 if errors & _OVERRUN else 0
    start = ends[_HEAD]
    following = start + _SIZE
    if following == ends[_END]:
        following = 0
    if following == ends[_TAIL]:
        return lost + 1
    length = length if length < _DATA_MAX else _DATA_MAX
    ring[start] = can_id & 0xFF
    ring[start + 1] = can_id >> 8 & 0xFF
    ring[start + _LENGTH] = length
    ring[start + _FLAGS] = flags & 0xFF
    ring[start + _ERRORS] = errors & 0xFF
    ring[start + _CAME] = registers[_TICKS] & 0xFF
    start += _DATA
    for place in range(length):
        ring[start + place] = data[place]
    ends[_HEAD] = following
    return lost


@micropython.viper
def _sort(  # noqa: PLR0917 - viper takes words
    ring: ptr8,
    ends: ptr32,
    accepted: ptr16,
    counts: ptr32,
    frames: ptr8,
    stamps: ptr32,
    fresh: ptr8,
) -> int:
    """Take frames until one is for the cell itself; see `Inbox.sort`."""
    box_bits = int(BOX_BITS)
    no_box = int(NO_BOX)
    known = counts[int(KNOWN)]
    stamp = counts[int(STAMP)]
    filed = 0
    start = ends[_TAIL]
    while start != ends[_HEAD] and ring[start + _FLAGS] == 0:
        wanted = (ring[start] | ring[start + 1] << 8) << box_bits
        first = 0
        past = known
        while first < past:
            middle = first + past >> 1
            if accepted[middle] < wanted:
                first = middle + 1
            else:
                past = middle
        box = accepted[first] - wanted if first < known else no_box + 1
        if box <= no_box:
            if box == no_box or ring[start + _LENGTH] != _DATA_MAX:
                break
            data = start + _DATA
            to = _DATA_MAX * box
            for place in range(_DATA_MAX):
                frames[to + place] = ring[data + place]
            stamps[box] = stamp
            fresh[box] = 1
            filed += 1
        start += _SIZE
        if start == ends[_END]:
            start = 0
        ends[_TAIL] = start
    return filed


class Inbox:
    """A ring that a hard interrupt fills and the background empties; taking allocates nothing.

    A frame is dated by TICKS of the `registers`, where they are given. The ring holds one frame
    less than its size. At 1 Mbit/s a garbage collection of 11 ms can see 81 frames of 8 bytes; the
    cell's filters let a fraction of them through.
    """

    def __init__(self, size=64, registers=None):
        self._ring = bytearray(size * _SIZE)
        self._ends = array("i", (0, 0, size * _SIZE))
        self.lost = 0
        registers = registers or array("i", [0] * (TICKS + 1))
        #: Takes one frame that a controller has received.
        self.take = _taking(self, self._ring, self._ends, registers)

    @micropython.native
    def is_empty(self):
        """Whether no frame waits."""
        ends = self._ends
        return ends[_HEAD] == ends[_TAIL]

    @micropython.native
    def sort(self, boxes):
        """Put the oldest frames into their boxes, up to the first that is for the cell itself.

        Drops those that the cell does not take; returns how many it does.
        """
        return _sort(
            self._ring,
            self._ends,
            boxes.accepted,
            boxes.counts,
            boxes.frames,
            boxes.stamps,
            boxes.fresh,
        )

    @micropython.native
    def peek(self):
        """The oldest frame, None if there is none.

        As (identifier, data, flags, errors, last byte of the tick in which it came).
        """
        ring = self._ring
        ends = self._ends
        start = ends[_TAIL]
        if start == ends[_HEAD]:
            return None
        return unpack_from(_LAYOUTS[ring[start + _LENGTH]], ring, start)

    @micropython.native
    def pop(self):
        """Give up the oldest frame."""
        ends = self._ends
        following = ends[_TAIL] + _SIZE
        ends[_TAIL] = 0 if following == ends[_END] else following


def _taking(inbox, ring, ends, registers):
    """What takes a frame, in an interrupt, with nothing to be looked up.

    One at a time, for MicroPython's controller of an STM32F4 sleeps, in the interrupt, for up to a
    millisecond when it is asked for a frame that it does not have.
    """
    received = [0, memoryview(bytearray(_RECV_MAX)), 0, 0]

    @micropython.native
    def take(  # noqa: PLR0917 - all is at hand
        can,
        inbox=inbox,
        frame=received,
        put=_put,
        ring=ring,
        ends=ends,
        registers=registers,
        size=len,
    ):
        if can.recv(frame) is not None:
            data = frame[1]
            lost = put(ring, ends, registers, frame[0], data, size(data), frame[2], frame[3])
            if lost:
                inbox.lost += lost

    return take


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
