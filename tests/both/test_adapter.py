"""A board as an SLCAN adapter: lines of the protocol, and frames that do not fit."""

from adapter_main import (
    BUS_OFF,
    FRAMES_PER_TURN,
    OVERRUN,
    PENDING_MAX,
    RECEIVE_FULL,
    SEND_FULL,
    Adapter,
)


class Bus:
    """A bus with so much room; received frames wait in `frames`."""

    def __init__(self):
        self.inbox = self
        self.lost = 0
        self.off = False
        self.room = 100
        self.sent = []
        self.frames = []

    def service(self, now_ms):
        pass

    def send(self, can_id, data):
        if not self.room:
            return False
        self.room -= 1
        self.sent.append((can_id, bytes(data)))
        return True

    def peek(self):
        return self.frames[0] if self.frames else None

    def pop(self):
        self.frames.pop(0)


class Port:
    """A line on which the host types, and takes so many bytes."""

    def __init__(self):
        self.typed = b""
        self.read_by_host = b""
        self.room = 1 << 20

    def read(self, most):
        data, self.typed = self.typed[:most], self.typed[most:]
        return data

    def write(self, data):
        taken = bytes(data[: self.room])
        self.room -= len(taken)
        self.read_by_host += taken
        return len(taken)


def made(commands=b""):
    bus, port = Bus(), Port()
    adapter = Adapter(bus, port, 0x1234ABCD)
    assert said(adapter, port, commands) == b"\r" * commands.count(b"\r")
    return adapter, bus, port


def said(adapter, port, typed=b"", turns=1, now_ms=0):
    port.typed += typed
    for _ in range(turns):
        adapter.turn(now_ms)
    data, port.read_by_host = port.read_by_host, b""
    return data


def test_host_opens_sends_and_receives():
    adapter, bus, port = made(b"\rC\rS8\rO\r")
    assert said(adapter, port, b"t6052AB01\r") == b"z\r"
    assert bus.sent == [(0x605, b"\xab\x01")]
    bus.frames = [(0x585, b"\x43\xff", 0, 0), (0x080, b"", 0, 0), (0x123, b"\0\0", 1, 0)]
    assert said(adapter, port) == b"t585243FF\rt0800\rr1232\r"


def test_lines_may_come_in_pieces_and_many_at_once():
    adapter, bus, port = made(b"O\r")
    assert said(adapter, port, b"t00") == b""
    assert said(adapter, port, b"1100\rt00211") == b"z\r"
    assert said(adapter, port, b"1\rt0030\r") == b"z\rz\r"
    assert bus.sent == [(1, b"\x00"), (2, b"\x11"), (3, b"")]


def test_a_closed_channel_carries_nothing_either_way():
    adapter, bus, port = made()
    assert said(adapter, port, b"t0010\r") == b"\x07"
    bus.frames = [(0x585, b"", 0, 0)]
    assert said(adapter, port, b"O\r") == b"\r"
    assert said(adapter, port) == b""
    assert bus.sent == []


def test_one_that_listens_only_sends_nothing():
    adapter, bus, port = made(b"L\r")
    assert said(adapter, port, b"t0010\r") == b"\x07"
    bus.frames = [(0x585, b"", 0, 0)]
    assert said(adapter, port) == b"t5850\r"


def test_a_bad_line_or_another_speed_is_refused():
    adapter, bus, port = made(b"O\r")
    for line in (b"t8000", b"t0019", b"t00120", b"tXYZ0", b"t001", b"T000000010", b"r0010", b"S8"):
        assert said(adapter, port, line + b"\r") == b"\x07", line
    for line in (b"t-01100", b"t+01100", b"t 1 100", b"t0_1100"):
        assert said(adapter, port, line + b"\r") == b"\x07", line
    assert said(adapter, port, b"t001" + b"0" * 40 + b"\r") == b"\x07"
    assert said(adapter, port, b"C\rS6\r") == b"\r\x07"
    assert bus.sent == []


def test_questions_are_answered():
    adapter, _, port = made()
    assert said(adapter, port, b"V\rN\rF\r") == b"V0100\rNABCD\rF00\r"
    assert said(adapter, port, b"M00000000\rmFFFFFFFF\r") == b"\r\r"


def test_frames_are_stamped_when_that_is_asked_for():
    adapter, bus, port = made(b"Z1\rO\r")
    bus.frames = [(0x001, b"", 0, 0)]
    assert said(adapter, port, now_ms=61_000) == b"t001003E8\r"


def test_a_frame_that_the_bus_does_not_take_is_refused_and_reported():
    adapter, bus, port = made(b"O\r")
    bus.room = 1
    assert said(adapter, port, b"t0010\rt0020\r") == b"z\r\x07"
    assert said(adapter, port, b"F\rF\r") == b"F%02X\rF00\r" % SEND_FULL


def test_frames_that_the_host_does_not_read_are_counted_in_their_place():
    adapter, bus, port = made(b"O\r")
    port.room = 0
    frames = 200
    bus.frames = [(number, b"\x55" * 8, 0, 0) for number in range(frames)]
    said(adapter, port, turns=frames // FRAMES_PER_TURN + 2)
    port.room = 1 << 20
    lines = said(adapter, port, turns=3).split(b"\r")
    kept = PENDING_MAX // 22
    assert lines[:kept] == [b"t%03X85555555555555555" % number for number in range(kept)]
    assert lines[kept] == b"x%04X" % (frames - kept)
    assert adapter.lost == frames - kept
    bus.frames = [(0x7FF, b"", 0, 0)]
    assert said(adapter, port, b"F\r", turns=2) == b"t7FF0\rF%02X\r" % OVERRUN


def test_frames_that_the_controller_lost_are_reported_too():
    adapter, bus, port = made(b"O\r")
    bus.lost = 3
    assert said(adapter, port, b"F\r") == b"x0003\rF%02X\r" % (RECEIVE_FULL | OVERRUN)


def test_frames_that_come_with_a_loss_go_out_behind_its_report():
    adapter, bus, port = made(b"O\r")
    bus.lost = 2
    bus.frames = [(0x001, b"", 0, 0), (0x002, b"", 0, 0)]
    assert said(adapter, port) == b"x0002\rt0010\rt0020\r"
    assert adapter.lost == 2


def test_bus_off_is_reported_once_and_in_the_status():
    adapter, bus, port = made(b"O\r")
    bus.off = True
    assert said(adapter, port, turns=3) == b"y\r"
    bus.off = False
    assert said(adapter, port, b"F\rF\r") == b"F%02X\rF00\r" % BUS_OFF
    bus.off = True
    assert said(adapter, port) == b"y\r"


def test_frames_for_a_bus_that_is_off_are_refused():
    adapter, bus, port = made(b"O\r")
    bus.off = True
    assert said(adapter, port, b"t0010\r") == b"y\r\x07"
    assert said(adapter, port, b"F\r") == b"F%02X\r" % (BUS_OFF | SEND_FULL)
    assert bus.sent == []


def test_bus_off_of_a_closed_channel_is_in_the_status_alone():
    adapter, bus, port = made()
    bus.off = True
    assert said(adapter, port, b"F\r") == b"F%02X\r" % BUS_OFF


def test_frames_of_29_bits_are_left_out():
    adapter, bus, port = made(b"O\r")
    bus.frames = [(0x123, b"", 2, 0)]
    assert said(adapter, port) == b""


def test_leds_show_whether_the_channel_is_open():
    adapter, _, port = made()
    assert adapter.state == 127
    said(adapter, port, b"O\r")
    assert adapter.state == 5
