"""The reactions of nodes to errors: counters, flags, retransmission, bus off and the way back."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.controller import ErrorState
from mdms_sim.bus.exchange import Disturbance
from mdms_sim.bus.wire import frame_bits

FRAME = Frame(0x123, b"\x55\xaa\x55\xaa")
LENGTH = frame_bits(FRAME)
GAP = 3
DELIMITER = 8
FLAG = 6


def test_a_bit_that_all_see_wrong_destroys_the_frame_and_it_is_sent_again(bench_of):
    bench = bench_of(3)
    bench.disturb_first(1, bit=30)
    bench.nodes[0].send(FRAME)
    bench.run_us(1000)
    # The sender's flag starts after bit 30; the others answer at the latest six bits on.
    (error_end_us,) = bench.error_ends_us
    assert 31 + FLAG + DELIMITER <= error_end_us <= 31 + 2 * FLAG + DELIMITER
    assert bench.ears[1].heard == [(FRAME, (error_end_us + GAP + LENGTH) * 1000)]
    assert bench.ears[2].heard == bench.ears[1].heard
    assert bench.counters() == [(7, 0), (0, 0), (0, 0)]
    assert (bench.bus.frames, bench.bus.errors) == (1, 1)


def test_a_receiver_that_alone_sees_a_wrong_bit_destroys_the_frame_for_all_and_pays_more(bench_of):
    bench = bench_of(3)
    bench.disturb_first(1, bit=30, seen_by=[bench.nodes[1]])
    bench.nodes[0].send(FRAME)
    bench.run_us(1000)
    assert bench.bus.errors == 1
    assert bench.counters() == [(7, 0), (0, 8), (0, 0)]
    assert [len(ear.heard) for ear in bench.ears] == [0, 1, 1]


def test_a_wrong_crc_is_told_only_after_the_acknowledge_delimiter(bench_of):
    bench = bench_of(3)
    crc_bit = LENGTH - 11
    bench.disturb_first(1, bit=crc_bit, seen_by=[bench.nodes[1]])
    bench.nodes[0].send(FRAME)
    bench.run_us(1000)
    # Flag from the first bit of end of frame; all others see a form error there and answer.
    assert bench.error_ends_us == [LENGTH - 7 + 1 + FLAG + DELIMITER]


def test_a_passive_receiver_loses_the_frame_and_disturbs_nobody(bench_of):
    bench = bench_of(3)
    bench.nodes[1].errors.receive = 130
    bench.disturb_first(1, bit=30, seen_by=[bench.nodes[1]])
    bench.nodes[0].send(FRAME)
    bench.run_us(1000)
    assert bench.bus.errors == 0
    assert [len(ear.heard) for ear in bench.ears] == [0, 0, 1]
    assert bench.counters() == [(0, 0), (0, 131), (0, 0)]


def test_counters_fall_by_one_with_every_good_frame_and_passive_receivers_return_to_119(bench_of):
    bench = bench_of(2)
    bench.nodes[0].errors.transmit = 5
    bench.nodes[1].errors.receive = 140
    bench.bus.disturb(None)
    for number in range(4):
        bench.nodes[0].send(Frame(0x100 + number, b""))
    bench.run_us(1000)
    assert bench.counters() == [(1, 0), (0, 119 - 3)]
    assert bench.states == [(1, ErrorState.ACTIVE)]


def test_a_lone_sender_repeats_until_it_is_passive_but_never_goes_bus_off(bench_of):
    bench = bench_of(1)
    bench.nodes[0].send(FRAME)
    bench.run_us(100_000)
    assert bench.nodes[0].errors.transmit == 128
    assert bench.states == [(0, ErrorState.PASSIVE)]
    # It finds nobody in the acknowledge slot: flag, delimiter and gap, then from the start.
    attempt_us = LENGTH - 9 + 1 + FLAG + DELIMITER
    ends = bench.error_ends_us
    assert ends[0] == attempt_us
    assert {b - a for a, b in pairwise(ends[:16])} == {attempt_us + GAP}
    assert ends[20] - ends[19] == attempt_us + GAP + 8
    bench.attach()
    bench.run_us(101_000)
    assert [frame for frame, _ in bench.ears[1].heard] == [FRAME]
    assert bench.nodes[0].errors.transmit == 127


def test_a_sender_that_is_always_disturbed_goes_passive_then_bus_off_and_is_silent(bench_of):
    bench = bench_of(3)
    bench.bus.disturb(
        lambda sender, frame: Disturbance(bit=30) if sender is bench.nodes[0] else None
    )
    bench.nodes[0].send(FRAME)
    bench.run_us(50_000)
    assert bench.bus.errors == 32
    assert bench.nodes[0].state is ErrorState.BUS_OFF
    assert bench.states == [(0, ErrorState.PASSIVE), (0, ErrorState.BUS_OFF)]
    bench.nodes[0].send(Frame(0x001, b""))
    bench.nodes[1].send(Frame(0x200, b""))
    bench.run_us(60_000)
    assert [frame.can_id for frame, _ in bench.ears[2].heard] == [0x200]
    assert bench.ears[0].heard == []


def off_bench(bench_of):
    """Node 0 is bus off, with its frame still waiting, and nothing is disturbed any more."""
    bench = bench_of(3)
    bench.bus.disturb(lambda sender, frame: Disturbance(bit=30))
    bench.nodes[0].send(FRAME)
    bench.run_us(10_000)
    assert bench.nodes[0].state is ErrorState.BUS_OFF
    bench.bus.disturb(None)
    return bench


def test_bus_off_ends_after_128_times_11_bits_of_an_idle_bus(bench_of):
    bench = off_bench(bench_of)
    bench.bus.recover(bench.nodes[0])
    start_us = 10_000
    bench.run_us(start_us + 128 * 11 - 1)
    assert bench.nodes[0].state is ErrorState.BUS_OFF
    bench.run_us(start_us + 2000)
    assert bench.counters()[0] == (0, 0)
    assert bench.ears[1].heard == [(FRAME, (start_us + 128 * 11 + LENGTH) * 1000)]


def test_frames_of_others_count_as_one_sequence_each_on_the_way_back(bench_of):
    bench = off_bench(bench_of)
    bench.bus.recover(bench.nodes[0])
    for _ in range(200):
        bench.nodes[1].send(Frame(0x300, b""))
    back_at = []
    bench.bus.observe_states(lambda node, now_ns: back_at.append(bench.bus.frames))
    bench.run_us(60_000)
    assert back_at == [128]


def test_without_recovery_a_node_stays_off(bench_of):
    bench = off_bench(bench_of)
    bench.run_us(1_000_000)
    assert bench.nodes[0].state is ErrorState.BUS_OFF
    assert bench.ears[1].heard == []


def test_two_nodes_that_send_the_same_bits_at_once_both_succeed(bench_of):
    bench = bench_of(3)
    bench.nodes[0].send(FRAME)
    bench.nodes[1].send(FRAME)
    bench.run_us(1000)
    assert bench.ears[2].heard == [(FRAME, LENGTH * 1000)]
    assert (bench.nodes[0].sent, bench.nodes[1].sent, bench.bus.errors) == (1, 1, 0)


def test_one_identifier_with_two_contents_is_an_error_until_a_sender_is_passive(bench_of):
    bench = bench_of(3)
    low, high = Frame(0x123, b"\x00"), Frame(0x123, b"\xff")
    bench.nodes[0].send(high)
    bench.nodes[1].send(low)
    bench.run_us(20_000)
    # Both count 8 each time, so both are passive after 16; then the one that sends recessive in
    # the bit that differs gives in without being seen, and sends its own frame afterwards.
    assert bench.bus.errors == 16
    assert [frame for frame, _ in bench.ears[2].heard] == [low, high]
    assert bench.counters() == [(16 * 8 + 8 - 1, 0), (16 * 8 - 1, 0), (0, 14)]


def test_remote_and_data_frame_of_one_identifier_do_not_clash(bench_of):
    from mdms_sim.bus.identifier import REMOTE

    bench = bench_of(3)
    bench.nodes[0].send(Frame(0x123 | REMOTE, bytes(2)))
    bench.nodes[1].send(Frame(0x123, b"ab"))
    bench.run_us(1000)
    assert bench.bus.errors == 0
    assert [frame.can_id for frame, _ in bench.ears[2].heard] == [0x123, 0x123 | REMOTE]


def test_a_passive_sender_lets_others_go_first_for_eight_bits(bench_of):
    bench = bench_of(3)
    bench.nodes[0].errors.transmit = 140
    bench.bus.disturb(None)
    bench.nodes[0].send(Frame(0x100, b"1"))
    bench.nodes[0].send(Frame(0x101, b"2"))
    first = frame_bits(Frame(0x100, b"1"))
    bench.kernel.at((first + GAP + 5) * 1000, 0, lambda: bench.nodes[1].send(Frame(0x700, b"")))
    bench.run_us(1000)
    assert [frame.can_id for frame, _ in bench.ears[2].heard] == [0x100, 0x700, 0x101]


def test_a_lost_frame_is_missed_by_its_victims_only_and_no_counter_moves(bench_of):
    bench = bench_of(3)
    bench.disturb_first(1, lost_by=[bench.nodes[1]])
    bench.nodes[0].send(FRAME)
    bench.run_us(1000)
    assert [len(ear.heard) for ear in bench.ears] == [0, 0, 1]
    assert bench.counters() == [(0, 0)] * 3


def test_a_cut_bus_works_in_each_piece_and_heals(bench_of):
    bench = bench_of(4)
    piece = bench.bus.cut(bench.nodes[2:])
    bench.nodes[0].send(Frame(0x100, b"\x01"))
    bench.nodes[2].send(Frame(0x100, b"\x02"))
    bench.run_us(1000)
    assert [[frame.data for frame, _ in ear.heard] for ear in bench.ears] == [
        [],
        [b"\x01"],
        [],
        [b"\x02"],
    ]
    bench.bus.heal(piece)
    bench.nodes[0].send(Frame(0x100, b"\x03"))
    bench.run_us(2000)
    assert [ear.heard[-1][0].data for ear in bench.ears[1:]] == [b"\x03"] * 3
    assert bench.bus.errors == 0


def test_a_frame_on_the_wire_is_destroyed_by_the_cut_and_sent_again_in_its_piece(bench_of):
    bench = bench_of(3)
    bench.nodes[0].send(FRAME)
    bench.kernel.at(20_000, 0, lambda: bench.bus.cut([bench.nodes[2]]))
    bench.run_us(1000)
    assert bench.bus.errors == 1
    assert [len(ear.heard) for ear in bench.ears] == [0, 1, 0]


def test_a_node_that_loses_power_while_it_sends_leaves_an_error_and_no_frame(bench_of):
    bench = bench_of(3)
    bench.nodes[0].send(FRAME)
    bench.kernel.at(20_000, 0, lambda: bench.bus.switch_off(bench.nodes[0]))
    bench.run_us(1000)
    assert (bench.bus.frames, bench.bus.errors) == (0, 1)
    bench.bus.switch_on(bench.nodes[0])
    bench.nodes[0].send(FRAME)
    bench.run_us(2000)
    assert [len(ear.heard) for ear in bench.ears] == [0, 1, 1]


def bus_off_of(bench, node):
    """Has the node go bus off; gives the time [us]."""
    bench.bus.disturb(lambda sender, frame: Disturbance(bit=30) if sender is node else None)
    node.send(FRAME)
    bench.run_us(10_000)
    assert node.state is ErrorState.BUS_OFF
    bench.bus.disturb(None)
    return 10_000


def test_a_node_without_power_does_not_come_back_from_bus_off(bench_of):
    bench = bench_of(2)
    now_us = bus_off_of(bench, bench.nodes[0])
    bench.bus.recover(bench.nodes[0])
    bench.run_us(now_us + 500)
    told = []
    bench.bus.observe_states(lambda node, _now_ns: told.append((node, node.state)))
    bench.bus.switch_off(bench.nodes[0])
    assert told == [(bench.nodes[0], ErrorState.ACTIVE)]
    bench.run_us(now_us + 10_000)
    bench.nodes[1].send(FRAME)
    bench.run_us(now_us + 20_000)
    # Nobody is left to acknowledge the frame.
    assert bench.bus.frames == 0
    assert bench.nodes[1].state is ErrorState.PASSIVE
    bench.bus.switch_on(bench.nodes[0])
    bench.run_us(now_us + 30_000)
    assert bench.ears[0].frames == [FRAME]


def test_a_node_comes_back_from_bus_off_though_the_wire_is_cut_and_healed_meanwhile(bench_of):
    bench = bench_of(3)
    now_us = bus_off_of(bench, bench.nodes[0])
    bench.bus.recover(bench.nodes[0])
    bench.run_us(now_us + 500)
    piece = bench.bus.cut(bench.nodes[:2])
    bench.run_us(now_us + 1000)
    bench.bus.heal(piece)
    bench.run_us(now_us + 3000)
    assert bench.states[-1] == (0, ErrorState.ACTIVE)
    assert bench.ears[1].frames == [FRAME]


@given(st.lists(st.tuples(st.integers(0, 70), st.integers(0, 15)), max_size=40))
def test_every_frame_arrives_and_twice_only_after_a_wrong_end(bench_of, script):
    bench = bench_of(4)
    left = list(script)
    torn = set()

    def disturb(sender, frame):
        if not left:
            return None
        bit, victims = left.pop()
        if bit >= frame_bits(frame) - 2:
            torn.add(frame.can_id)
        seen_by = [node for index, node in enumerate(bench.nodes) if victims >> index & 1]
        return Disturbance(bit=bit, seen_by=seen_by)

    bench.bus.disturb(disturb)
    for number in range(20):
        bench.nodes[number % 4].send(Frame(0x100 + number, bytes(number % 9)))
    bench.run_us(1_000_000)
    for index, ear in enumerate(bench.ears):
        seen = [frame.can_id for frame, _ in ear.heard]
        assert all((can_id - 0x100) % 4 != index for can_id in seen)
        assert {can_id for can_id in seen if seen.count(can_id) > 1} <= torn
    sent = sum(node.sent for node in bench.nodes)
    waiting = sum(node.pending for node in bench.nodes)
    assert sent + waiting == 20
    assert sent <= bench.bus.frames
    assert waiting == 0 or any(node.state is ErrorState.BUS_OFF for node in bench.nodes)
