"""The last minute is kept in a memory that does not grow, and frames come back as they were."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.can_link.recent import KEPT_S, FrameRing, Recent, unpacked
from mdms_protocol.codecs.frame import Frame

FRAMES = st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8))


@given(st.lists(st.tuples(FRAMES, st.integers(0, 2), st.booleans()), max_size=40))
def test_the_last_frames_come_back_in_order_with_bus_and_sender(sent) -> None:
    ring = FrameRing(16)
    for number, (frame, bus, own) in enumerate(sent):
        ring.add(frame, float(number), bus, 0x80 if own else 0)
    kept = [(each.frame, each.bus, each.sent) for each in unpacked(ring.packed())]
    assert kept == sent[-16:]


def test_an_hour_of_a_full_bus_takes_the_memory_of_a_minute() -> None:
    recent = Recent()
    before = len(recent.moment(0.0).frames)
    for number in range(400_000):
        recent.on_received(Frame(0x181, bytes(8)), number / 5000)
    for number in range(10_000):
        recent.note(number, "line", "x")
        recent.believe(number, np.zeros((1, 3)))
    moment = recent.moment(10_000.0)
    assert before == 0
    assert len(moment.frames) == 60 * 5000 * 22
    assert len(moment.events) == 5000
    assert len(moment.beliefs) == 1200
    assert len(moment.load) == 60


def test_frames_before_the_last_minute_are_left_out() -> None:
    recent = Recent()
    for time_s in (1.0, 30.0, 80.0):
        recent.on_sent(Frame(0x80, b""), time_s)
    kept = unpacked(recent.moment(85.0).frames, 85.0 - KEPT_S)
    assert [(each.time_s, each.sent) for each in kept] == [(30.0, True), (80.0, True)]
