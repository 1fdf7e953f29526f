"""Response times on the bus against the analysis of Davis, Burns, Bril and Lukkien (2007).

Times are in bits. A message's transmission time C includes the inter-frame space, as in the paper;
the simulation reports when a frame ends, which is three bits earlier.
"""

from collections import deque
from dataclasses import dataclass
from itertools import count
from math import ceil
from random import Random

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.wire import INTERFRAME_BITS, frame_bits
from mdms_sim.kernel import Kernel

BIT_RATE = 125_000
BIT_NS = 8_000


@dataclass(frozen=True)
class Message:
    """Periodic, and sent by a node of its own; the list of messages is in order of priority."""

    frame: Frame
    period: int
    offset: int = 0

    @property
    def time(self):
        return frame_bits(self.frame) + INTERFRAME_BITS


def longest_busy(start, step):
    """The smallest fixed point of `step` from `start`; None beyond all reason."""
    before, now = None, start
    while now != before:
        before, now = now, step(now)
        if now > 1_000_000:
            return None
    return now


def worst_response(messages, number, blocked):
    """Equations 7 to 10 of the paper without jitter; `blocked` [bits] by a lower priority."""
    message, higher = messages[number], messages[:number]
    busy = longest_busy(
        message.time,
        lambda t: blocked + sum(ceil(t / each.period) * each.time for each in [*higher, message]),
    )
    if busy is None:
        return None
    responses = []
    for earlier in range(ceil(busy / message.period)):
        wait = longest_busy(
            blocked + earlier * message.time,
            lambda w, n=earlier: (
                blocked
                + n * message.time
                + sum(ceil((w + 1) / each.period) * each.time for each in higher)
            ),
        )
        responses.append(wait - earlier * message.period + message.time)
    return max(responses)


def blocking(messages, number):
    return max((each.time for each in messages[number + 1 :]), default=0)


class Watch:
    """Notes how long each release of each message took to get through."""

    def __init__(self, messages, duration):
        self.kernel = Kernel()
        bus = Bus(self.kernel, BIT_RATE)
        self.worst = [0] * len(messages)
        self._open = [deque() for _ in messages]
        self._numbers = {each.frame.can_id: number for number, each in enumerate(messages)}
        bus.observe(self.on_frame)
        for number, message in enumerate(messages):
            node = bus.attach(self, ())
            for k in count():
                release = message.offset + k * message.period
                if release > duration:
                    break
                self.kernel.at(
                    release * BIT_NS, 0, lambda n=number, m=message, c=node: self.release(n, m, c)
                )
        self.kernel.run_until((duration + 1_000_000) * BIT_NS)
        assert not any(self._open)

    def release(self, number, message, node):
        self._open[number].append(self.kernel.now_ns // BIT_NS)
        node.send(message.frame)

    def on_frame(self, frame, now_ns):
        number = self._numbers[frame.can_id]
        response = now_ns // BIT_NS - self._open[number].popleft() + INTERFRAME_BITS
        self.worst[number] = max(self.worst[number], response)


def frame_of(can_id, size, bits):
    """A frame with `size` bytes whose length with the gap is `bits`."""
    random = Random(can_id)
    while True:
        frame = Frame(can_id, random.randbytes(size))
        if frame_bits(frame) + INTERFRAME_BITS == bits:
            return frame


def example(bits=110):
    """Three messages of one length: A every 2.5, B and C every 3.5 of it."""
    periods = [5 * bits // 2, 7 * bits // 2, 7 * bits // 2]
    return [
        Message(frame_of(0x100 + number, 7, bits), period) for number, period in enumerate(periods)
    ]


def test_the_papers_example_has_the_papers_worst_cases():
    messages = example()
    c = messages[0].time
    found = [worst_response(messages, n, blocking(messages, n)) for n in range(3)]
    assert found == [2 * c, 3 * c, 3.5 * c]


def test_the_papers_example_reaches_three_and_a_half_in_the_second_instance():
    messages = example()
    watch = Watch(messages, duration=20 * messages[0].time)
    assert watch.worst[2] == 3.5 * messages[0].time


def critical_instant(messages, number):
    """Everything from `number` up at once, one bit after the longest below has begun."""
    lower = messages[number + 1 :]
    if not lower:
        return [*messages]
    longest = max(lower, key=lambda each: each.time)
    first = Message(longest.frame, 10_000_000, 0)
    urgent = [Message(each.frame, each.period, 1) for each in messages[: number + 1]]
    return [*urgent, first]


@st.composite
def message_sets(draw):
    """Up to seven messages that load the bus by no more than 95 %."""
    sizes = draw(st.lists(st.integers(0, 8), min_size=2, max_size=7))
    messages = []
    for number, size in enumerate(sizes):
        frame = Frame(0x080 + 0x71 * number, draw(st.binary(min_size=size, max_size=size)))
        messages.append(Message(frame, draw(st.integers(150, 3000)), draw(st.integers(0, 3000))))
    assume(sum(each.time / each.period for each in messages) <= 0.95)
    return messages


@settings(deadline=None, max_examples=200)
@given(message_sets())
def test_no_response_is_ever_longer_than_the_analysis_says(messages):
    watch = Watch(messages, duration=30_000)
    for number, worst in enumerate(watch.worst):
        bound = worst_response(messages, number, blocking(messages, number))
        assert bound is None or worst <= bound


@settings(deadline=None, max_examples=200)
@given(message_sets(), st.data())
def test_at_the_critical_instant_the_response_is_exactly_the_analysed_one(messages, data):
    number = data.draw(st.integers(0, len(messages) - 1))
    messages = [Message(each.frame, each.period, 0) for each in messages]
    # One bit of the blocking frame is over when the others are released.
    blocked = max(0, blocking(messages, number) - 1)
    bound = worst_response(messages, number, blocked)
    assume(bound is not None)
    watch = Watch(critical_instant(messages, number), duration=30_000)
    assert watch.worst[number] == bound
