from hypothesis import given
from hypothesis import strategies as st

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.identifier import EXTENDED, REMOTE
from mdms_sim.serve.slcan import VirtualAdapter

FRAMES = st.builds(
    Frame,
    st.one_of(
        st.integers(0, 0x7FF),
        st.integers(0, 0x1FFF_FFFF).map(lambda can_id: can_id | EXTENDED),
    ),
    st.binary(max_size=8),
)


def adapter(takes=True):
    sent = []

    def send(frame):
        sent.append(frame)
        return takes

    return VirtualAdapter(send), sent


def opened():
    slcan, sent = adapter()
    assert slcan.feed(b"C\rS8\rO\r") == b"\r\r\r"
    return slcan, sent


def test_session_as_python_can_has_it():
    slcan, sent = adapter()
    assert slcan.feed(b"\r\r") == b"\r\r"
    assert slcan.feed(b"V\rN\r") == b"V1013\rNMDMS\r"
    assert slcan.feed(b"C\rS8\rO\r") == b"\r\r\r"
    assert slcan.feed(b"t2013010203\r") == b"z\r"
    assert slcan.feed(b"T1ABCDEF00\r") == b"Z\r"
    assert slcan.feed(b"r7014\r") == b"z\r"
    assert sent == [
        Frame(0x201, b"\1\2\3"),
        Frame(0x1ABCDEF0 | EXTENDED, b""),
        Frame(0x701 | REMOTE, bytes(4)),
    ]
    assert slcan.feed(b"C\r") == b"\r"
    assert slcan.feed(b"t0000\r") == b"\x07"


def test_lines_for_the_client():
    slcan, _ = opened()
    assert slcan.encode(Frame(0x181, b"\x00\xff"), 0) == b"t181200FF\r"
    assert slcan.encode(Frame(0x181 | EXTENDED, b""), 0) == b"T000001810\r"
    assert slcan.encode(Frame(0x701 | REMOTE, bytes(1)), 0) == b"r7011\r"


def test_channel_at_another_bit_rate_than_the_bus_hears_and_sends_nothing_until_it_is_closed():
    slcan, sent = adapter()
    assert slcan.feed(b"C\rS6\rO\rt7010\r") == b"\r\r\r\x07"
    assert (slcan.encode(Frame(0x181, b""), 0), sent) == (b"", [])
    assert slcan.feed(b"C\rO\rt7010\r") == b"\r\rz\r"
    assert (slcan.encode(Frame(0x181, b""), 0), sent) == (b"t1810\r", [Frame(0x701, b"")])


def test_timing_registers_have_a_bit_rate_too():
    slcan, _ = adapter()
    # 1 Mbit/s and 500 kbit/s; eight digits are the registers of another adapter.
    for registers, heard in ((b"s0014", True), (b"s001C", False), (b"s00140000", True)):
        assert slcan.feed(b"C\r" + registers + b"\rO\r") == b"\r\r\r"
        assert bool(slcan.encode(Frame(0x181, b""), 0)) == heard, registers


def test_closed_channel_is_silent():
    slcan, _ = adapter()
    assert slcan.encode(Frame(0x181, b""), 0) == b""


def test_time_stamps_count_milliseconds_of_a_minute():
    slcan, _ = adapter()
    slcan.feed(b"Z1\rO\r")
    assert slcan.encode(Frame(1, b""), 61_234_000_000) == b"t001004D2\r"


def test_garbage_is_answered_and_counted_and_nothing_is_sent():
    slcan, sent = opened()
    bad = (
        b"x",
        b"t2",
        b"t20190102",
        b"t2012 1 2",
        b"t2011zz",
        b"t8000",
        b"t+010",
        b"T200000000",
        b"t20120102" + b"0" * 40,
        b"\xff\xfe",
        b"S8",
    )
    for line in bad:
        assert slcan.feed(line + b"\r") == b"\x07", line
    assert slcan.garbage == len(bad)
    assert sent == []
    assert slcan.feed(b"t2010\r") == b"z\r"


def test_listener_may_not_send():
    slcan, sent = adapter()
    assert slcan.feed(b"L\rt2010\r") == b"\r\x07"
    assert sent == []


def test_full_bus_is_told_by_the_error_byte():
    slcan, _ = adapter(takes=False)
    assert slcan.feed(b"O\rt2010\r") == b"\r\x07"


@given(FRAMES)
def test_one_adapter_understands_another(frame):
    teller, _ = opened()
    hearer, heard = opened()
    hearer.feed(teller.encode(frame, 0))
    assert heard == [frame]


@given(st.lists(st.binary(max_size=40)))
def test_no_bytes_do_harm(chunks):
    slcan, sent = opened()
    for chunk in chunks:
        slcan.feed(chunk)
    slcan.feed(b"\r\rO\r")
    before = len(sent)
    slcan.feed(b"t2010\r")
    assert len(sent) == before + 1
