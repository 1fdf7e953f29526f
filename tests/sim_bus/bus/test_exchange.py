"""Frames that are followed bit by bit, and the facts that are known without that."""

from hypothesis import given
from hypothesis import strategies as st

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.exchange import Disturbance, Exchange, parties
from mdms_sim.bus.identifier import EXTENDED, REMOTE
from mdms_sim.bus.wire import INTERFRAME_BITS, frame_bits
from mdms_sim.kernel import Kernel

identifiers = st.integers(0, 0x7FF) | st.integers(0, 0x1FFF_FFFF).map(lambda each: each | EXTENDED)
data_frames = st.builds(Frame, identifiers, st.binary(max_size=8))
remote_frames = st.builds(
    lambda can_id, size: Frame(can_id | REMOTE, bytes(size)), identifiers, st.integers(0, 8)
)
frames = data_frames | remote_frames
counters = st.integers(0, 255)


class Deaf:
    def on_frame(self, frame, now_ns):
        pass


def nodes(counts):
    bus = Bus(Kernel())
    controllers = [bus.attach(Deaf()) for _ in counts]
    for controller, (transmit, receive) in zip(controllers, counts, strict=True):
        controller.errors.transmit, controller.errors.receive = transmit, receive
    return controllers


def figures(outcome):
    errors = [(each.transmit, each.receive) for _, each in outcome.errors]
    ends = outcome.frame, outcome.frame_bits, outcome.free_bits
    return *ends, outcome.sent, outcome.heard, outcome.tried, outcome.error, errors


@given(frames, st.lists(st.tuples(counters, counters), min_size=2, max_size=4))
def test_a_good_frame_has_exactly_the_bits_of_its_length(frame, counts):
    sender, *others = nodes(counts)
    plain = Exchange(0, parties([(sender, frame)], others)).outcome()
    # A bit that nobody sees wrong has it followed all the same.
    nobody = Disturbance(bit=0, seen_by=())
    followed = Exchange(0, parties([(sender, frame)], others, nobody), nobody.bit).outcome()
    assert figures(followed) == figures(plain)
    assert plain.frame == frame
    assert plain.frame_bits == frame_bits(frame)
    assert plain.free_bits == frame_bits(frame) + INTERFRAME_BITS


@given(frames, st.data())
def test_a_receiver_never_takes_a_frame_of_which_it_saw_a_bit_wrong(frame, draw):
    sender, victim, other = nodes([(0, 0)] * 3)
    wrong = draw.draw(st.integers(0, frame_bits(frame) - 2))
    seen = Disturbance(bit=wrong, seen_by=(victim,))
    outcome = Exchange(0, parties([(sender, frame)], [victim, other], seen), wrong).outcome()
    assert victim not in outcome.heard
    assert outcome.sent == []
    assert dict(outcome.errors)[victim].receive >= 1


@given(st.lists(frames, min_size=2, max_size=5, unique_by=lambda frame: frame.can_id))
def test_of_several_that_begin_at_once_one_wins_and_the_others_receive_its_frame(sent):
    *senders, listener = nodes([(0, 0)] * (len(sent) + 1))
    pairs = list(zip(senders, sent, strict=True))
    outcome = Exchange(0, parties(pairs, [listener])).outcome()
    assert len(outcome.sent) == 1
    (winner,) = outcome.sent
    assert outcome.frame == dict(pairs)[winner]
    assert set(outcome.heard) == {listener, *senders} - {winner}
    assert not outcome.error
    assert all(each.transmit == each.receive == 0 for _, each in outcome.errors)


@given(
    frames,
    st.integers(0, 130),
    st.lists(st.tuples(counters, counters), min_size=3, max_size=5),
    st.data(),
)
def test_whatever_is_wrong_everybody_is_ready_again_soon(frame, bit, counts, draw):
    sender, *others = nodes(counts)
    victims = draw.draw(st.sets(st.sampled_from([sender, *others])))
    wrong = Disturbance(bit=bit, seen_by=victims)
    outcome = Exchange(0, parties([(sender, frame)], others, wrong), bit).outcome()
    # At most a frame, then flags one after the other, delimiter and space; twice over when an
    # overload flag is taken for a frame.
    most = frame_bits(frame) + 2 * (4 * 6 + 8) + 2 * INTERFRAME_BITS
    assert max([outcome.free_bits, *outcome.ready_bits.values()]) <= most + frame_bits(frame)
    assert (sender in outcome.sent) <= (outcome.frame == frame)
    assert len(outcome.errors) == len(counts)
