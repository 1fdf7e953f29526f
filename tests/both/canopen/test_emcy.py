"""Emergency messages, the error register and the history."""

from refusal import code_of

from mdms_cell.canopen.emcy import Emcy
from mdms_cell.canopen.objects import Objects, find
from mdms_protocol import record
from mdms_protocol.codecs import sdo


class Bench:
    """The emergencies of a node 5."""

    def __init__(self):
        self.objects = Objects()
        self.objects.reset(5, record.FROM_NODE)
        self.sent = []
        self.emcy = Emcy(self.objects, self.send)

    def send(self, can_id, data):
        self.sent.append((can_id, data))
        return True

    def polled(self, now_ms=0):
        self.emcy.poll(now_ms)
        sent, self.sent = self.sent, []
        return sent


def test_error_and_its_end_are_sent():
    bench = Bench()
    bench.emcy.report(1, 0x2310)
    assert bench.polled() == [(0x085, b"\x10\x23\x03\x01\0\0\0\0")]
    bench.emcy.clear(1)
    assert bench.polled() == [(0x085, b"\x00\x00\x00\x01\0\0\0\0")]


def test_error_register_tells_of_all_errors_that_last():
    bench = Bench()
    bench.emcy.report(1, 0x2310)
    bench.emcy.report(3, 0x8130)
    assert bench.objects.read(0x1001, 0) == b"\x13"
    bench.emcy.clear(1)
    assert bench.objects.read(0x1001, 0) == b"\x11"


def test_same_error_is_told_once():
    bench = Bench()
    bench.emcy.report(1, 0x2310)
    bench.emcy.report(1, 0x2310)
    bench.emcy.clear(2)
    assert len(bench.polled()) == 1


def test_history_begins_with_the_newest_and_keeps_eight():
    bench = Bench()
    for number in range(10):
        bench.emcy.report(1, 0x8100 + number)
    assert bench.objects.number(0x1003, 0) == 8
    assert bench.objects.number(0x1003, 1) == 0x00018109
    assert bench.objects.number(0x1003, 8) == 0x00018102
    bench.objects.write(find(0x1003, 0), b"\0")
    assert [bench.objects.number(0x1003, sub) for sub in range(9)] == [0] * 9


def test_history_is_cleared_by_0_alone():
    bench = Bench()
    bench.emcy.report(1, 0x2310)
    for number in (1, 2, 255):
        assert code_of(bench.objects.write, find(0x1003, 0), bytes((number,))) == sdo.INVALID_VALUE
    assert bench.objects.read(0x1003, 0) == b"\1"


def test_places_of_the_history_without_an_error_cannot_be_read():
    bench = Bench()
    for sub in range(1, 9):
        assert code_of(bench.objects.read, 0x1003, sub) == sdo.NO_DATA
    bench.emcy.report(1, 0x2310)
    assert bench.objects.read(0x1003, 1) == b"\x10\x23\x01\x00"
    assert code_of(bench.objects.read, 0x1003, 2) == sdo.NO_DATA
    bench.objects.write(find(0x1003, 0), b"\0")
    assert code_of(bench.objects.read, 0x1003, 1) == sdo.NO_DATA
    assert bench.objects.read(0x1003, 0) == b"\0"


def test_inhibit_time_keeps_messages_apart():
    bench = Bench()
    bench.objects.write(find(0x1015, 0), b"\x64\x00")
    bench.emcy.report(1, 0x2310)
    bench.emcy.report(2, 0x2310)
    times = [now_ms for now_ms in range(100, 130) if bench.polled(now_ms)]
    assert times == [100, 110]


def test_no_message_without_an_identifier():
    bench = Bench()
    bench.objects.write(find(0x1014, 0), b"\x85\x00\x00\x80")
    bench.emcy.report(1, 0x2310)
    assert bench.polled() == []
    assert bench.objects.number(0x1003, 0) == 1
