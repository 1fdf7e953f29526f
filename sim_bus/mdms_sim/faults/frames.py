"""Faults that strike single frames on the wire, by chance."""

from collections.abc import Callable, Sequence
from random import Random

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Controller
from mdms_sim.bus.length import frame_bits
from mdms_sim.bus.party import Disturbance
from mdms_sim.bus.wire import INTERFRAME_BITS

#: A wrong bit may be any of a frame and the first two after it, where nobody sends yet.
BITS_AFTER = INTERFRAME_BITS - 1

#: What a fault does to a frame.
Effect = Callable[[Frame], Disturbance]


class FrameFault:
    """A fault that strikes the frames of some senders (None: all); `count` says how many."""

    def __init__(
        self,
        senders: Sequence[Controller] | None,
        probability: float,
        random: Random,
        effect: Effect,
    ) -> None:
        self.count = 0
        self._senders = senders
        self._probability = probability
        self._random = random
        self._effect = effect

    def on(self, sender: Controller, frame: Frame) -> Disturbance | None:
        """What happens to this frame, None for nothing."""
        if self._senders is not None and sender not in self._senders:
            return None
        if self._random.random() >= self._probability:
            return None
        self.count += 1
        return self._effect(frame)


class FrameFaults:
    """The faults at work on a bus; the first that strikes a frame has it for itself."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._at_work: list[FrameFault] = []

    def begin(self, fault: FrameFault) -> None:
        """One more."""
        self._at_work.append(fault)
        self._bus.disturb(self._disturb)

    def end(self, fault: FrameFault) -> None:
        """One less."""
        self._at_work.remove(fault)
        self._bus.disturb(self._disturb if self._at_work else None)

    def _disturb(self, sender: Controller, frame: Frame) -> Disturbance | None:
        for fault in self._at_work:
            disturbance = fault.on(sender, frame)
            if disturbance is not None:
                return disturbance
        return None


def losing(buses: Sequence[Bus], victims: Sequence[Controller] | None) -> Effect:
    """Frames do not reach the victims (None: anybody), though all was well on the wire."""

    def lose(frame: Frame) -> Disturbance:
        everybody = [each for bus in buses for each in bus.controllers]
        return Disturbance(lost_by=everybody if victims is None else victims)

    return lose


def corrupting(random: Random, victims: Sequence[Controller] | None) -> Effect:
    """The victims (None: everybody) see one bit the wrong way round."""

    def corrupt(frame: Frame) -> Disturbance:
        return Disturbance(random.randrange(frame_bits(frame) + BITS_AFTER), victims)

    return corrupt


def overloading(nodes: Sequence[Controller], count: int) -> Effect:
    """The nodes hold up what follows a frame by so many overload frames each."""
    disturbance = Disturbance(overloads=dict.fromkeys(nodes, count))
    return lambda frame: disturbance
