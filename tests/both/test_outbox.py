"""Frames that wait for a mailbox."""

from mdms_cell.queues import Outbox


class Can:
    """Three mailboxes."""

    def __init__(self):
        self.waiting = []
        self.off = False

    def send(self, can_id, data):
        if self.off:
            raise OSError(5)
        if len(self.waiting) == 3 or any(each[0] == can_id for each in self.waiting):
            return None
        self.waiting.append((can_id, data))
        return len(self.waiting) - 1

    def take(self):
        taken, self.waiting = self.waiting, []
        return taken


def test_drains_as_the_controller_has_room():
    outbox, can = Outbox(), Can()
    for number in range(5):
        assert outbox.push(0x100 + number, bytes((number,)))
    outbox.drain(can.send)
    assert can.take() == [(0x100, b"\x00"), (0x101, b"\x01"), (0x102, b"\x02")]
    outbox.drain(can.send)
    assert can.take() == [(0x103, b"\x03"), (0x104, b"\x04")]


def test_frames_of_one_identifier_keep_their_order():
    outbox, can = Outbox(), Can()
    outbox.push(0x100, b"a")
    outbox.push(0x100, b"b")
    outbox.push(0x101, b"c")
    sent = []
    for _ in range(4):
        outbox.drain(can.send)
        sent += can.take()
    assert sent == [(0x100, b"a"), (0x100, b"b"), (0x101, b"c")]


def test_full_outbox_refuses():
    outbox = Outbox(2)
    assert outbox.push(1, b"")
    assert outbox.push(2, b"")
    assert not outbox.push(3, b"")


def test_keeps_everything_while_the_bus_is_off():
    outbox, can = Outbox(), Can()
    can.off = True
    outbox.push(1, b"x")
    outbox.drain(can.send)
    can.off = False
    outbox.drain(can.send)
    assert can.take() == [(1, b"x")]


def test_queued_data_does_not_follow_the_sender_buffer():
    outbox, can = Outbox(), Can()
    buffer = bytearray(b"old")
    outbox.push(1, buffer)
    buffer[:] = b"new"
    outbox.drain(can.send)
    assert can.take() == [(1, b"old")]
