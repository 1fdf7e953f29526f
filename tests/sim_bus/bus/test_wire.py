"""Lengths and bits against a second implementation, written from the text of the standard."""

from hypothesis import given
from hypothesis import strategies as st

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.identifier import EXTENDED, REMOTE, arbitration_field
from mdms_sim.bus.wire import TAIL_BITS, frame_bits, stuffed_bits

standard = st.builds(
    lambda i, remote: i | (REMOTE if remote else 0), st.integers(0, 0x7FF), st.booleans()
)
extended = st.builds(
    lambda i, remote: i | EXTENDED | (REMOTE if remote else 0),
    st.integers(0, 0x1FFF_FFFF),
    st.booleans(),
)
can_ids = standard | extended
frames = st.builds(Frame, can_ids, st.binary(max_size=8))


def field(value, width):
    return format(value, f"0{width}b") if width else ""


def arbitration_text(can_id):
    rtr = "1" if can_id & REMOTE else "0"
    if can_id & EXTENDED:
        identifier = field(can_id & 0x1FFF_FFFF, 29)
        return identifier[:11] + "1" + "1" + identifier[11:] + rtr
    return field(can_id & 0x7FF, 11) + rtr + "0"


def unstuffed_text(frame):
    """From start of frame to the end of the data."""
    reserved = "00" if frame.can_id & EXTENDED else "0"
    data = "" if frame.can_id & REMOTE else "".join(field(byte, 8) for byte in frame.data)
    control = arbitration_text(frame.can_id) + reserved + field(len(frame.data), 4)
    return "0" + control + data


def crc_by_long_division(text):
    remainder = int(text + 15 * "0", 2)
    divisor = 0b1100010110011001  # x15 + x14 + x10 + x8 + x7 + x4 + x3 + 1
    while remainder.bit_length() > 15:
        remainder ^= divisor << (remainder.bit_length() - 16)
    return field(remainder, 15)


def stuffed_text(text):
    sent = ""
    for bit in text:
        sent += bit
        if sent.endswith(5 * bit) and run_length(sent) == 5:
            sent += "0" if bit == "1" else "1"
    return sent


def run_length(text):
    return len(text) - len(text.rstrip(text[-1]))


def reference_bits(frame):
    text = unstuffed_text(frame)
    return stuffed_text(text + crc_by_long_division(text))


@given(frames)
def test_bits_equal_those_of_long_division_and_plain_stuffing(frame):
    assert "".join(map(str, stuffed_bits(frame))) == reference_bits(frame)


@given(frames)
def test_length_is_that_of_the_stuffed_bits_and_the_tail(frame):
    assert frame_bits(frame) == len(reference_bits(frame)) + TAIL_BITS


@given(frames)
def test_length_lies_between_no_stuffing_and_the_worst_case(frame):
    size = 0 if frame.can_id & REMOTE else len(frame.data)
    head = 54 if frame.can_id & EXTENDED else 34
    bare = head + 8 * size + 10
    assert bare <= frame_bits(frame) <= bare + (head + 8 * size - 1) // 4


def test_hand_made_frame_with_identifier_0_and_no_data():
    # 0 | 00000000000 | 0 | 0 | 0 | 0000 | CRC 0: 34 dominant bits, a stuff bit after the first
    # five and after every further four (the stuff bit counts in the next run only by ending it).
    bits = "".join(map(str, stuffed_bits(Frame(0, b""))))
    assert bits == 6 * "000001" + "0000"


def test_hand_made_frame_of_the_highest_identifier():
    # 0 11111 0 11111 0 1 0 0 0 0000: runs of five among the identifier's ones are broken by zeros.
    bits = "".join(map(str, stuffed_bits(Frame(0x7FF, b""))))
    assert bits.startswith("0" + "111110" + "111110" + "1" + "00000" + "1" + "00")


@given(can_ids, can_ids)
def test_arbitration_orders_as_the_bits_do(one, other):
    texts = arbitration_text(one), arbitration_text(other)
    first, second = (text.ljust(32, "0") for text in texts)
    assert (arbitration_field(one) < arbitration_field(other)) == (first < second)
