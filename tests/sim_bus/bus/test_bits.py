"""Wrong bits at every place of a frame, cuts and power losses, worked out by hand (ISO 11898-1).

A bit is a microsecond, and a frame begins at 0. FRAME is, stuff bits included,

    bit  0         1         2         3         4         5         6         7
         0123456789012345678901234567890123456789012345678901234567890123456789012345
         0001001000110000100010101011010101001010101101010100100100010101111a1EEEEEEE

with the delimiter of the CRC at 66, the acknowledge slot `a` at 67, its delimiter at 68 and the end
of frame from 69 to 75. The inter-frame space is 76 to 78, and whatever follows begins at 79. After
any flag there are eight recessive bits of delimiter and three of space.
"""

import pytest

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.wire import frame_bits, stuffed_bits

FRAME = Frame(0x123, b"\x55\xaa\x55\xaa")
BITS = "000100100011000010001010101101010100101010110101010010010001010111"
LENGTH = 76
ACKNOWLEDGE = 67
LAST = 75


def test_the_frame_is_as_it_is_drawn():
    assert "".join(map(str, stuffed_bits(FRAME))) == BITS
    assert frame_bits(FRAME) == LENGTH


def disturbed(bench_of, bit, victims, count=3):
    """Node 0 sends FRAME, and these nodes see one bit of it wrong; what follows is well."""
    bench = bench_of(count)
    bench.disturb_first(1, bit=bit, seen_by=[bench.nodes[each] for each in victims])
    bench.nodes[0].send(FRAME)
    return bench


# The end of a frame ------------------------------------------------------------------------------


def test_a_receiver_that_sees_the_last_bit_wrong_has_the_frame_and_sends_an_overload_frame(
    bench_of,
):
    bench = disturbed(bench_of, LAST, [1])
    bench.nodes[0].send(Frame(0x200, b""))
    bench.run_us(1000)
    # Node 1 flags 76 to 81, the others answer 77 to 82; delimiter to 90, space to 93.
    next_end_us = 94 + frame_bits(Frame(0x200, b""))
    assert bench.heard_us() == [[], [LENGTH, next_end_us], [LENGTH, next_end_us]]
    assert bench.counters() == [(0, 0)] * 3
    assert bench.bus.errors == 0


def test_a_sender_that_sees_the_last_bit_wrong_sends_a_frame_that_all_have_had_once_more(bench_of):
    bench = disturbed(bench_of, LAST, [0])
    bench.run_us(93)
    assert bench.counters() == [(8, 0), (0, 0), (0, 0)]
    bench.run_us(1000)
    # It flags 76 to 81; for the others that is overload, 77 to 82; delimiter to 90, space to 93.
    assert bench.error_ends_us == [91]
    assert bench.heard_us() == [[], [LENGTH, 94 + LENGTH], [LENGTH, 94 + LENGTH]]
    assert (bench.bus.frames, bench.nodes[0].sent) == (2, 1)


def test_a_receiver_that_sees_the_last_bit_but_one_wrong_makes_all_others_have_the_frame_twice(
    bench_of,
):
    bench = disturbed(bench_of, LAST - 1, [1])
    bench.run_us(92)
    # Node 1 flags 75 to 80. The sender finds an error at 75 and flags 76 to 81, node 2 takes it for
    # overload. So node 1 sees others go on after its flag, which counts 8 more.
    assert bench.counters() == [(8, 0), (0, 9), (0, 0)]
    bench.run_us(1000)
    assert bench.error_ends_us == [90]
    assert bench.heard_us() == [[], [93 + LENGTH], [LENGTH, 93 + LENGTH]]


def test_the_first_bit_of_the_space_is_an_overload_condition(bench_of):
    bench = disturbed(bench_of, LAST + 1, [1])
    bench.nodes[0].send(Frame(0x200, b""))
    bench.run_us(1000)
    # Node 1 flags 77 to 82, the others 78 to 83; delimiter to 91, space to 94.
    assert bench.heard_us()[2] == [LENGTH, 95 + frame_bits(Frame(0x200, b""))]
    assert bench.counters() == [(0, 0)] * 3


def test_an_overload_flag_that_begins_with_the_third_bit_of_the_space_is_an_error_to_others(
    bench_of,
):
    bench = disturbed(bench_of, LAST + 2, [1])
    bench.run_us(100)
    # Node 1 flags 78 to 83. To the others 78 is a start of frame, and 83 the sixth equal bit; they
    # flag 84 to 89; delimiter to 97.
    assert bench.heard_us() == [[], [LENGTH], [LENGTH]]
    assert bench.error_ends_us == [98]
    assert bench.counters() == [(0, 1), (0, 0), (0, 1)]


# The arbitration field ---------------------------------------------------------------------------


def test_a_sender_that_sees_its_dominant_identifier_bit_recessive_finds_a_bit_error(bench_of):
    bench = disturbed(bench_of, 4, [0])
    bench.run_us(26)
    # It flags 5 to 10; bits 4 to 9 are six dominant ones to the others, who flag 10 to 15.
    assert bench.error_ends_us == [24]
    assert bench.counters() == [(8, 0), (0, 1), (0, 1)]
    bench.run_us(1000)
    assert bench.heard_us() == [[], [27 + LENGTH], [27 + LENGTH]]


def test_a_sender_that_sees_its_recessive_identifier_bit_dominant_gives_in_and_nobody_sends(
    bench_of,
):
    bench = disturbed(bench_of, 3, [0])
    bench.run_us(31)
    # Bits 3 to 8 are six recessive ones to the receivers, who flag 9 to 14. Node 0 saw five, from 4
    # on, so for it 9 is a stuff bit and 14 the sixth dominant one: it flags 15 to 20, and they see
    # that as an answer.
    assert bench.error_ends_us == [29]
    assert bench.counters() == [(0, 1), (0, 9), (0, 9)]
    bench.run_us(1000)
    assert bench.heard_us() == [[], [32 + LENGTH], [32 + LENGTH]]


def test_a_node_put_out_of_arbitration_by_an_error_flag_is_not_to_blame(bench_of):
    bench = disturbed(bench_of, 3, [0])
    bench.nodes[1].send(Frame(0x127, b""))
    bench.run_us(26)
    # Node 0 gives in at 3, and finds a stuff error in bits 0 to 5: it flags 6 to 11. Node 1, whose
    # identifier has a one at 6, gives in there. Bits 4 to 9 are six dominant ones to it and to
    # node 2; they flag 10 to 15.
    assert bench.error_ends_us == [24]
    assert bench.counters() == [(0, 9), (0, 1), (0, 1)]
    bench.run_us(1000)
    first, second = 27 + LENGTH, 27 + LENGTH + 3 + frame_bits(Frame(0x127, b""))
    assert bench.heard_us() == [[second], [first], [first, second]]


def test_a_recessive_stuff_bit_of_the_arbitration_field_that_turns_dominant_does_not_count(
    bench_of,
):
    bench = bench_of(3)
    bench.disturb_first(1, bit=5, seen_by=[bench.nodes[0]])
    bench.nodes[0].send(Frame(0x000, b""))
    bench.run_us(28)
    # Five dominant bits, then the stuff bit at 5. The sender flags 6 to 11, the sixth is a stuff
    # error to the others, who flag 12 to 17.
    assert bench.error_ends_us == [26]
    assert bench.counters() == [(0, 0), (0, 1), (0, 1)]


# Acknowledgement ---------------------------------------------------------------------------------


def test_a_sender_that_misses_the_acknowledgement_sends_again(bench_of):
    bench = disturbed(bench_of, ACKNOWLEDGE, [0])
    bench.run_us(85)
    # It flags 68 to 73, which is no delimiter to the others, who flag 69 to 74.
    assert bench.error_ends_us == [83]
    assert bench.counters() == [(8, 0), (0, 1), (0, 1)]
    bench.run_us(1000)
    assert bench.heard_us() == [[], [86 + LENGTH], [86 + LENGTH]]


# Power and cuts ----------------------------------------------------------------------------------


def test_a_sender_that_loses_power_leaves_recessive_bits_and_the_others_an_error_frame(bench_of):
    bench = bench_of(3)
    bench.nodes[0].send(FRAME)
    bench.at_us(20, lambda: bench.bus.switch_off(bench.nodes[0]))
    bench.at_us(22, lambda: bench.nodes[1].send(FRAME))
    bench.run_us(1000)
    # Bit 19 is dominant, so 25 is the sixth recessive one; flag 26 to 31, delimiter to 39.
    assert bench.error_ends_us == [40]
    assert bench.heard_us() == [[], [], [43 + LENGTH]]
    assert bench.counters()[1:] == [(0, 1), (0, 0)]
    assert bench.bus.busy_ns == (43 + LENGTH + 3) * 1000


def test_a_sender_that_loses_power_in_the_end_of_frame_has_been_heard(bench_of):
    bench = bench_of(3)
    bench.nodes[0].send(FRAME)
    bench.at_us(70, lambda: bench.bus.switch_off(bench.nodes[0]))
    bench.run_us(1000)
    assert bench.heard_us() == [[], [LENGTH], [LENGTH]]
    assert bench.error_ends_us == []


def test_the_only_receiver_that_loses_power_leaves_a_sender_without_acknowledgement(bench_of):
    bench = bench_of(2)
    bench.nodes[0].send(FRAME)
    bench.at_us(60, lambda: bench.bus.switch_off(bench.nodes[1]))
    bench.run_us(84)
    assert bench.error_ends_us == [ACKNOWLEDGE + 1 + 6 + 8]
    assert bench.counters()[0] == (8, 0)


def test_a_cut_behind_the_sender_is_nothing_to_its_side_and_an_error_to_the_other(bench_of):
    bench = bench_of(4)
    bench.nodes[0].send(FRAME)
    bench.at_us(20, lambda: bench.bus.cut(bench.nodes[2:]))
    bench.run_us(1000)
    assert bench.heard_us() == [[], [LENGTH], [], []]
    assert bench.error_ends_us == [40]
    assert bench.counters() == [(0, 0), (0, 0), (0, 1), (0, 1)]


def test_a_sender_that_is_cut_off_alone_goes_on_and_finds_nobody_to_answer(bench_of):
    bench = bench_of(3)
    bench.nodes[0].send(FRAME)
    pieces = []
    bench.at_us(20, lambda: pieces.append(bench.bus.cut(bench.nodes[:1])))
    bench.run_us(84)
    assert bench.error_ends_us == [40, 82]
    assert bench.counters() == [(8, 0), (0, 1), (0, 1)]
    bench.at_us(84, lambda: bench.bus.heal(pieces[0]))
    bench.run_us(1000)
    # It begins again at 85, as it would have done alone.
    assert bench.heard_us() == [[], [85 + LENGTH], [85 + LENGTH]]


def test_nodes_that_are_joined_to_a_wire_in_the_midst_of_a_frame_destroy_it(bench_of):
    bench = bench_of(3)
    piece = bench.bus.cut(bench.nodes[2:])
    bench.nodes[0].send(FRAME)
    # Bit 30 is the first dominant one, so node 2, which was idle, takes it for a start of frame.
    # Bit 43, the 14th from there, makes it an extended one, and 65 to 68 a data length of 13, that
    # is 8 bytes: it expects more than is left, and 68 to 73 are six recessive bits.
    bench.at_us(29, lambda: bench.bus.heal(piece))
    bench.run_us(1000)
    # It flags 74 to 79: the sender finds an error at 74 and flags 75 to 80, node 1 with it.
    assert bench.error_ends_us == [89]
    assert bench.heard_us() == [[], [92 + LENGTH], [92 + LENGTH]]
    assert bench.counters() == [(7, 0), (0, 0), (0, 8)]


def test_two_pieces_that_both_send_are_joined_and_both_frames_come_through(bench_of):
    bench = bench_of(4)
    piece = bench.bus.cut(bench.nodes[2:])
    other = Frame(0x345, b"other")
    bench.nodes[0].send(FRAME)
    bench.at_us(10, lambda: bench.nodes[2].send(other))
    bench.at_us(30, lambda: bench.bus.heal(piece))
    bench.run_us(2000)
    assert bench.bus.errors >= 1
    assert [frame for frame, _ in bench.ears[1].heard] == [FRAME, other]
    assert [frame for frame, _ in bench.ears[3].heard] == [FRAME, other]


def test_a_node_that_comes_amid_a_frame_hears_the_next(bench_of):
    bench = bench_of(2)
    bench.nodes[0].send(FRAME)
    bench.nodes[0].send(FRAME)
    bench.at_us(30, bench.attach)
    bench.run_us(1000)
    assert bench.heard_us() == [[], [LENGTH, 79 + LENGTH], [79 + LENGTH]]


# Overload frames on purpose ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("busy", "count", "next_us"),
    # One node flags 76 to 81 and the others answer until 82; delimiter to 90, space to 93.
    # All at once flag 76 to 81 only. A second one takes 15 bits more, and there is no third.
    [([1], 1, 94), ([1], 2, 109), ([0, 1, 2], 1, 93), ([0], 1, 94), ([1], 3, 109)],
)
def test_an_overload_frame_holds_up_the_next_frame(bench_of, busy, count, next_us):
    bench = bench_of(3)
    bench.disturb_first(1, overloads={bench.nodes[each]: count for each in busy})
    bench.nodes[0].send(FRAME)
    bench.nodes[0].send(FRAME)
    bench.run_us(1000)
    assert bench.heard_us() == [[], *[[LENGTH, next_us + LENGTH]] * 2]
    assert bench.counters() == [(0, 0)] * 3
    assert bench.bus.errors == 0
