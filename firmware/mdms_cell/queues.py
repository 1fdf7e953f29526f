"""Frames between the CAN controller and the background loop, in both directions."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array
from struct import unpack_from

from mdms_cell.drive.speed_loop import TICKS
from mdms_cell.mailboxes import BOX_BITS, KNOWN, NO_BOX, STAMP
from mdms_protocol.compat import const, micropython, ptr8, ptr16, ptr32

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
#: Bytes that `machine.CAN.recv` may write into a buffer of any length. A DLC of 9 to 15 means 8
#: bytes on a classic bus, but the port returns up to 15 (bxCAN, FlexCAN) or 64 (FDCAN).
_RECV_MAX = const(64)
#: CAN.RECV_ERR_OVERRUN: a frame was lost before this one. The other error, a full FIFO, lost none.
_OVERRUN = const(2)


# Indices of `ends`: beginning and end of the ring, and the count of frames that did not fit
HEAD = const(0)  # moved by `take` only
TAIL = const(1)  # moved by `sort` and `pop` only
_END = const(2)
_LOST = const(3)


class Inbox:
    """A ring that a hard interrupt fills and the background empties; taking allocates nothing.

    A frame is dated by TICKS of the `registers`, where they are given. The ring holds one frame
    less than its size; it is empty while `ends[HEAD] == ends[TAIL]`. At 1 Mbit/s a garbage
    collection of 11 ms can see 81 frames of 8 bytes; the cell's filters let a fraction of them
    through.
    """

    def __init__(self, size=64, registers=None):
        self._ring = bytearray(size * _SIZE)
        self.ends = array("i", (0, 0, size * _SIZE, 0))
        registers = registers or array("i", [0] * (TICKS + 1))
        #: Takes one frame that a controller has received.
        self.take = _taking(self._ring, self.ends, registers)

    @property
    def lost(self):
        """How many frames have been lost, here or in the controller."""
        return self.ends[_LOST]

    def lose(self, count):
        """Count frames that are lost; not while `take` may interrupt it."""
        self.ends[_LOST] += count

    def sorter(self, boxes):
        """A function that puts the oldest frames into their boxes, up to the first that has none.

        It drops those that the cell does not take, and returns how many it has put into boxes.
        """
        return _sorting(self._ring, self.ends, boxes)

    @micropython.native
    def peek(self):
        """The oldest frame, None if there is none.

        A frame is (identifier, data, flags, errors, last byte of the tick in which it came).
        """
        ring = self._ring
        ends = self.ends
        start = ends[TAIL]
        if start == ends[HEAD]:
            return None
        return unpack_from(_LAYOUTS[ring[start + _LENGTH]], ring, start)

    @micropython.native
    def pop(self):
        """Give up the oldest frame."""
        ends = self.ends
        following = ends[TAIL] + _SIZE
        ends[TAIL] = 0 if following == ends[_END] else following


# Viper functions that hold their buffers, so that nothing is looked up. With more than five buffers
# and arguments together MicroPython would call them through the heap.


def _taking(ring, ends, registers):
    """Return a function that takes a frame, in an interrupt.

    It takes one frame at a time. If it asked for a frame too many, MicroPython's controller of an
    STM32F4 would sleep in the interrupt for up to a millisecond.
    """
    received = [0, memoryview(bytearray(_RECV_MAX)), 0, 0]

    @micropython.viper
    def take(can):
        if not can.recv(received):
            return
        can_id, data, flags, errors = received
        bounds = ptr32(ends)
        if int(errors) & _OVERRUN:
            bounds[_LOST] += 1
        start = bounds[HEAD]
        following = start + _SIZE
        if following == bounds[_END]:
            following = 0
        if following == bounds[TAIL]:
            bounds[_LOST] += 1
            return
        length = int(len(data))  # noqa: RUF046 - viper has an object
        length = length if length < _DATA_MAX else _DATA_MAX
        frame = ptr8(ring)
        frame[start] = int(can_id) & 0xFF
        frame[start + 1] = int(can_id) >> 8 & 0xFF
        frame[start + _LENGTH] = length
        frame[start + _FLAGS] = int(flags) & 0xFF
        frame[start + _ERRORS] = int(errors) & 0xFF
        frame[start + _CAME] = ptr32(registers)[int(TICKS)] & 0xFF
        start += _DATA
        came = ptr8(data)
        if length == _DATA_MAX:  # as nearly all have; a loop would take twice as long
            frame[start] = came[0]
            frame[start + 1] = came[1]
            frame[start + 2] = came[2]
            frame[start + 3] = came[3]
            frame[start + 4] = came[4]
            frame[start + 5] = came[5]
            frame[start + 6] = came[6]
            frame[start + 7] = came[7]
        else:
            for place in range(length):
                frame[start + place] = came[place]
        bounds[HEAD] = following

    return take


def _sorting(ring, ends, boxes):
    """Return a function that sorts frames into boxes; see `Inbox.sorter`."""
    parts = boxes.accepted, boxes.counts, boxes.frames, boxes.stamps, boxes.fresh

    @micropython.viper
    def sort() -> int:
        bounds = ptr32(ends)
        start = bounds[TAIL]
        if start == bounds[HEAD]:
            return 0
        accepted_, counts_, frames_, stamps_, fresh_ = parts
        frame = ptr8(ring)
        accepted = ptr16(accepted_)
        counts = ptr32(counts_)
        frames = ptr8(frames_)
        stamps = ptr32(stamps_)
        fresh = ptr8(fresh_)
        known = counts[int(KNOWN)]
        stamp = counts[int(STAMP)]
        box_bits = int(BOX_BITS)
        no_box = int(NO_BOX)
        filed = 0
        while start != bounds[HEAD] and frame[start + _FLAGS] == 0:
            wanted = (frame[start] | frame[start + 1] << 8) << box_bits
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
                if box == no_box or frame[start + _LENGTH] != _DATA_MAX:
                    break
                data = start + _DATA
                to = _DATA_MAX * box
                # A loop would take twice as long.
                frames[to] = frame[data]
                frames[to + 1] = frame[data + 1]
                frames[to + 2] = frame[data + 2]
                frames[to + 3] = frame[data + 3]
                frames[to + 4] = frame[data + 4]
                frames[to + 5] = frame[data + 5]
                frames[to + 6] = frame[data + 6]
                frames[to + 7] = frame[data + 7]
                stamps[box] = stamp
                fresh[box] = 1
                filed += 1
            start += _SIZE
            if start == bounds[_END]:
                start = 0
            bounds[TAIL] = start
        return filed

    return sort


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
        raise OSError: the board calls this only while the bus is not off. Returns the place of the
        oldest frame that waits, -1 without one.
        """
        while self._count:
            try:
                taken = send(self._identifiers[self._first], self._data[self._first])
            except OSError:
                taken = None
            if taken is None:
                return self._first
            self._data[self._first] = b""  # frees the data of the frame
            self._first = (self._first + 1) % self._size
            self._count -= 1
        return -1

    def clear(self):
        """Forget all that waits."""
        self._count = 0
