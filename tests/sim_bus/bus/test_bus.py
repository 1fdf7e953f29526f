from itertools import pairwise

import pytest
from tests.sim_bus.bus.ear import Ear

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.identifier import EXTENDED, REMOTE
from mdms_sim.bus.wire import frame_bits
from mdms_sim.kernel import Kernel


def bus_with_ear(bitrate=1_000_000):
    kernel = Kernel()
    bus = Bus(kernel, bitrate)
    ear = Ear()
    bus.attach(ear)
    return kernel, bus, ear


@pytest.mark.parametrize("bitrate", [10_000, 125_000, 500_000, 800_000, 1_000_000])
def test_frame_arrives_after_its_bits(bitrate):
    kernel, bus, ear = bus_with_ear(bitrate)
    frame = Frame(0x181, bytes(range(8)))
    bus.attach(Ear()).send(frame)
    kernel.run_until(1_000_000_000)
    assert ear.heard == [(frame, frame_bits(frame) * 1_000_000_000 // bitrate)]


def test_bit_rate_without_whole_nanoseconds_is_refused():
    with pytest.raises(ValueError, match="33333"):
        Bus(Kernel(), 33_333)


def test_lowest_arbitration_field_wins_among_all_that_wait():
    kernel, bus, ear = bus_with_ear()
    ids = [0x100 | EXTENDED, 0x7FF, 0x100, 0x100 | REMOTE, 0x100 << 18 | EXTENDED, 0x080]
    for can_id in ids:
        bus.attach(Ear()).send(Frame(can_id, b""))
    kernel.run_until(10_000_000)
    order = [frame.can_id for frame in ear.frames]
    low = 0x100 | EXTENDED  # base identifier 0
    assert order == [low, 0x080, 0x100, 0x100 | REMOTE, 0x100 << 18 | EXTENDED, 0x7FF]


def test_a_running_frame_is_not_interrupted_and_three_bits_lie_between():
    kernel, bus, ear = bus_with_ear()
    late, early = Frame(0x700, b"12345678"), Frame(0x001, b"")
    bus.attach(Ear()).send(late)
    urgent = bus.attach(Ear())
    kernel.at(50_000, 0, lambda: urgent.send(early))
    kernel.run_until(1_000_000)
    first_end = frame_bits(late) * 1000
    assert ear.heard == [(late, first_end), (early, first_end + (3 + frame_bits(early)) * 1000)]


def test_requests_within_one_bit_time_contend():
    kernel, bus, ear = bus_with_ear()
    first, second = bus.attach(Ear()), bus.attach(Ear())
    kernel.at(1001, 0, lambda: first.send(Frame(0x200, b"")))
    kernel.at(1999, 0, lambda: second.send(Frame(0x100, b"")))
    kernel.run_until(1_000_000)
    assert [frame.can_id for frame in ear.frames] == [0x100, 0x200]
    assert ear.heard[0][1] == 2000 + frame_bits(Frame(0x100, b"")) * 1000


def test_a_node_sends_the_lowest_of_three_mailboxes_and_keeps_the_order_of_equal_identifiers():
    kernel, bus, ear = bus_with_ear()
    node = bus.attach(Ear())
    for can_id, data in [(0x300, b"a"), (0x200, b"b"), (0x200, b"c"), (0x100, b"d"), (0x50, b"e")]:
        node.send(Frame(can_id, data))
    kernel.run_until(10_000_000)
    # 'c' waits for 'b', and holds up what stands behind it; 'e' waits for a free mailbox.
    sent = [(frame.can_id, frame.data) for frame in ear.frames]
    assert sent == [(0x200, b"b"), (0x100, b"d"), (0x50, b"e"), (0x200, b"c"), (0x300, b"a")]


def test_a_filter_passes_its_identifiers_and_a_node_never_hears_itself():
    kernel = Kernel()
    bus = Bus(kernel)
    ears = [Ear(), Ear(), Ear()]
    filters = [{0x100}, {0x200, 0x300}, None]
    nodes = [bus.attach(ear, accept) for ear, accept in zip(ears, filters, strict=True)]
    for can_id in (0x100, 0x200, 0x300, 0x400):
        nodes[2].send(Frame(can_id, b""))
    nodes[0].send(Frame(0x101, b""))
    kernel.run_until(10_000_000)
    heard = [[frame.can_id for frame in ear.frames] for ear in ears]
    assert heard == [[0x100], [0x200, 0x300], [0x101]]


def test_a_changed_filter_holds_from_the_next_frame_on():
    kernel = Kernel()
    bus = Bus(kernel)
    ear = Ear()
    listener, sender = bus.attach(ear, {0x100}), bus.attach(Ear())
    sender.send(Frame(0x100, b"1"))
    kernel.run_until(1_000_000)
    bus.set_filter(listener, {0x200})
    sender.send(Frame(0x100, b"2"))
    sender.send(Frame(0x200, b"3"))
    kernel.run_until(2_000_000)
    assert [frame.data for frame in ear.frames] == [b"1", b"3"]


def test_a_node_that_takes_no_frames_keeps_three_and_counts_the_rest():
    kernel = Kernel()
    bus = Bus(kernel)
    ear = Ear()
    deaf, sender = bus.attach(ear), bus.attach(Ear())
    deaf.hold()
    for number in range(5):
        sender.send(Frame(0x100, bytes([number])))
    kernel.run_until(10_000_000)
    assert (ear.frames, deaf.overruns) == ([], 2)
    deaf.release(kernel.now_ns)
    assert [frame.data[0] for frame in ear.frames] == [0, 1, 2]


def test_load_is_the_share_of_time_that_the_bus_is_not_idle():
    kernel, bus, _ = bus_with_ear()
    frame = Frame(0x100, b"1234")
    bus.attach(Ear()).send(frame)
    kernel.run_until(1_000_000)
    assert bus.load() == (frame_bits(frame) + 3) / 1000
    assert bus.frames == 1


def test_observers_see_every_frame_once_in_order():
    kernel, bus, ear = bus_with_ear()
    seen = []
    bus.observe(lambda frame, now_ns: seen.append((frame, now_ns)))
    sender = bus.attach(Ear())
    for number in range(20):
        sender.send(Frame(0x100 + number % 3, bytes([number])))
    kernel.run_until(100_000_000)
    assert seen == ear.heard
    assert all(before[1] < after[1] for before, after in pairwise(seen))
