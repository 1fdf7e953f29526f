"""Frames between interrupt and background."""

try:
    from micropython import heap_lock, heap_unlock
except ImportError:

    def heap_lock():
        """On CPython every integer is an object, so there is nothing to show."""

    def heap_unlock():
        """See `heap_lock`."""


from array import array

from mdms_cell.drive import speed_loop
from mdms_cell.queues import Inbox


class Can:
    """A controller that has received some frames."""

    def __init__(self):
        self.fifo = []

    def recv(self, into):
        if not self.fifo:
            return None
        can_id, data, flags, errors = self.fifo.pop(0)
        into[0] = can_id
        into[1] = memoryview(bytearray(data))  # the real one resizes the given view
        into[2] = flags
        into[3] = errors
        return into


def filled(inbox, *identifiers):
    can = Can()
    can.fifo = [(can_id, b"", 0, 0) for can_id in identifiers]
    while can.fifo:
        inbox.take(can)
    return inbox


def emptied(inbox):
    identifiers = []
    frame = inbox.peek()
    while frame is not None:
        identifiers.append(frame[0])
        inbox.pop()
        frame = inbox.peek()
    return identifiers


def test_frames_come_out_in_their_order_round_and_round():
    inbox = Inbox(8)
    for start in range(0, 100, 5):
        numbers = list(range(start, start + 5))
        assert emptied(filled(inbox, *numbers)) == numbers
    assert inbox.lost == 0


def test_frame_comes_out_as_it_was_received():
    frames = [
        (0x7E5, b"\x01\x02\x03\x04\x05\x06\x07\x08", 0, 0),
        (0x000, b"", 1, 0),
        (0x205, b"\xff\x80", 2, 1),
    ]
    inbox = Inbox(4)
    can = Can()
    can.fifo = list(frames)
    while can.fifo:
        inbox.take(can)
    for frame in frames:
        assert inbox.peek()[:4] == frame
        inbox.pop()
    assert inbox.peek() is None


def test_frame_is_dated_by_the_tick_in_which_it_came():
    registers = array("i", [0] * speed_loop.REGISTERS)
    inbox = Inbox(registers=registers)
    for tick in (3, 254, 258):
        registers[speed_loop.TICKS] = tick
        filled(inbox, 5)
    for tick in (3, 254, 2):
        assert inbox.peek()[4] == tick
        inbox.pop()


def test_full_inbox_keeps_the_oldest_and_counts_the_rest():
    inbox = Inbox(8)
    assert emptied(filled(inbox, *range(12))) == list(range(7))
    assert inbox.lost == 5


def test_frame_may_arrive_between_a_look_and_the_taking():
    inbox = filled(Inbox(4), 1)
    assert inbox.peek()[0] == 1
    filled(inbox, 2)
    inbox.pop()
    assert emptied(inbox) == [2]


def test_controller_without_a_frame_leaves_the_inbox_as_it_is():
    inbox = Inbox(4)
    inbox.take(Can())
    assert inbox.peek() is None
    assert inbox.lost == 0


def test_overrun_of_the_controller_is_counted():
    inbox = Inbox(4)
    can = Can()
    can.fifo = [(1, b"", 0, 2)]
    inbox.take(can)
    assert inbox.lost == 1


def test_taking_allocates_nothing():
    inbox = Inbox(4)
    can = Still()
    inbox.take(can)
    inbox.pop()
    heap_lock()
    try:
        for _ in range(10):
            inbox.take(can)
            inbox.take(can)
            inbox.pop()
            inbox.pop()
    finally:
        heap_unlock()
    assert inbox.lost == 0


class Still:
    """A controller that receives the same frame again, and allocates nothing."""

    def recv(self, into):
        into[0] = 0x205
        into[1][0] = 7
        into[2] = 0
        into[3] = 0
        return into
