"""Frames between interrupt and background."""

from mdms_cell.inbox import Inbox


class Can:
    """A controller that has received some frames."""

    def __init__(self):
        self.fifo = []

    def recv(self, into):
        if not self.fifo:
            return None
        can_id, data, flags, errors = self.fifo.pop(0)
        into[0] = can_id
        into[1] = memoryview(bytearray(data))
        into[2] = flags
        into[3] = errors
        return into


def filled(inbox, *identifiers):
    can = Can()
    can.fifo = [(can_id, b"", 0, 0) for can_id in identifiers]
    inbox.fill(can)
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


def test_overrun_of_the_controller_is_counted():
    inbox = Inbox(4)
    can = Can()
    can.fifo = [(1, b"", 0, 2)]
    inbox.fill(can)
    assert inbox.lost == 1
