"""The frames on one wire: the next to be sent, its duration, the stations that receive it.

Bit boundaries lie at multiples of the bit time. All frames that ask for the bus within one bit time
contend for it; each takes its real length with stuff bits and the inter-frame space after it. While
all is well, a frame costs one event; everything else goes the careful way, by an `Exchange`, which
follows what each node makes of every bit. Nodes that start alike and see the same do the same, so
they are followed as one.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from typing import TYPE_CHECKING

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.controller import (
    BusOffRecovery,
    Confinement,
    Controller,
    ErrorState,
    Receivers,
    SendRequests,
)
from mdms_sim.bus.node import Node
from mdms_sim.bus.party import UNDISTURBED, Party, parties
from mdms_sim.bus.wire import INTERFRAME_BITS, arbitration_field, frame_bits

if TYPE_CHECKING:
    from mdms_sim.bus.bus import Bus

#: An error passive node that has just sent lets others go first for so long.
SUSPEND_BITS = 8


@dataclass(slots=True)
class ExchangeOutcome:
    """How it ended; all bits are counted from the start of the exchange.

    `frame` got through to somebody and ended after `frame_bits`; None if it did not. `free_bits` is
    when the first node would start a new frame, `ready_bits` when those do that are later than it.
    `sent` have sent the frame, `heard` received it, `tried` are all that were sending when it
    ended. `errors` are the counters of all after it; `error`: there was an error frame.
    """

    free_bits: int
    frame: Frame | None = None
    frame_bits: int = 0
    error: bool = False
    sent: list[Controller] = field(default_factory=list)
    heard: list[Controller] = field(default_factory=list)
    tried: list[Controller] = field(default_factory=list)
    ready_bits: dict[Controller, int] = field(default_factory=dict)
    errors: list[tuple[Controller, Confinement]] = field(default_factory=list)

    def settle(self, start_ns: int, bit_ns: int) -> None:
        """Moves the counters of all, and sets until when some must let others go first."""
        for controller, errors in self.errors:
            controller.errors.put(errors)
        for controller, bits in self.ready_bits.items():
            controller.suspended_until_ns = start_ns + bits * bit_ns
        for sender in self.tried:
            if sender.state is ErrorState.PASSIVE:
                ready_bits = self.ready_bits.get(sender, self.free_bits) + SUSPEND_BITS
                sender.suspended_until_ns = start_ns + ready_bits * bit_ns


class Exchange:
    """The acts of the nodes on one wire from `start_ns` on; bit `flip` is seen wrong by some."""

    def __init__(self, start_ns: int, parties: Sequence[Party], flip: int | None = None) -> None:
        self.start_ns = start_ns
        self.flip = flip
        self._parties = parties
        self._nodes: list[Node] = []

    def after(self, bits: int, stays: Callable[[Controller], object]) -> list[Party]:
        """How far those who stay have come after so many bits."""
        self._follow()
        parties = []
        for party, node in zip(self._parties, self._nodes, strict=True):
            controllers = tuple(each for each in party.controllers if stays(each))
            if controllers:
                seen = tuple(node.seen[: len(party.seen) + bits])
                parties.append(replace(party, controllers=controllers, seen=seen))
        return parties

    def outcome(self) -> ExchangeOutcome:
        """How it ends if nobody comes or goes."""
        return self._plain_outcome() or self._followed_outcome()

    def _plain_outcome(self) -> ExchangeOutcome | None:
        """Without a look at the bits: one sends, others listen, and nothing disturbs them."""
        senders = [party for party in self._parties if party.frame is not None]
        listeners = [party for party in self._parties if party.frame is None]
        plain = (
            self.flip is None
            and len(senders) == 1
            and listeners
            and not any(party.overloads or party.seen for party in self._parties)
        )
        if not plain:
            return None
        frame = senders[0].frame
        assert frame is not None
        bits = frame_bits(frame)
        outcome = ExchangeOutcome(bits + INTERFRAME_BITS, frame, bits)
        outcome.sent = outcome.tried = list(senders[0].controllers)
        for party in self._parties:
            errors = party.errors.copy()
            if party.frame is not None:
                errors.transmitted()
            else:
                errors.received()
            outcome.errors += [(each, errors) for each in party.controllers]
        outcome.heard = [each for party in listeners for each in party.controllers]
        return outcome

    def _follow(self) -> None:
        """Lets bits pass until every node is ready for the next frame."""
        if self._nodes:
            return
        self._nodes = nodes = [party.node() for party in self._parties]
        bit = 0
        while any(node.idle_after is None for node in nodes):
            level = min(node.drive for node in nodes)
            for party, node in zip(self._parties, nodes, strict=True):
                node.see(1 - level if party.misled and bit == self.flip else level)
            bit += 1

    def _followed_outcome(self) -> ExchangeOutcome:
        self._follow()
        outcome = ExchangeOutcome(self._free_bits())
        for party, node in zip(self._parties, self._nodes, strict=True):
            self._tell(outcome, party, node)
        outcome.error |= outcome.frame is None
        return outcome

    def _free_bits(self) -> int:
        return min(
            (node.idle_after or 0) - len(party.seen)
            for party, node in zip(self._parties, self._nodes, strict=True)
        )

    @staticmethod
    def _tell(outcome: ExchangeOutcome, party: Party, node: Node) -> None:
        """Adds what became of one party."""
        before = len(party.seen)
        outcome.errors += [(each, node.errors) for each in party.controllers]
        outcome.error |= node.flagged
        ready_bits = (node.idle_after or 0) - before
        if ready_bits > outcome.free_bits:
            outcome.ready_bits |= dict.fromkeys(party.controllers, ready_bits)
        if node.frame is not None and not node.outvoted:
            outcome.tried += party.controllers
        after = node.sent_after if node.sent_after is not None else node.heard_after
        if after is None:
            return
        if node.sent_after is not None:
            outcome.sent += party.controllers
        else:
            outcome.heard += party.controllers
        outcome.frame = node.heard or node.frame
        outcome.frame_bits = after - before


#: Frames end before anything else happens at that instant, and arbitration sees all requests of it.
PRIORITY_END = 0
PRIORITY_ARBITRATE = 1000

States = Sequence[tuple[Controller, ErrorState]]


class WireTraffic:
    """The frames on the wire of these controllers.

    `calm` may be set while no counter is above 0, nothing is disturbed and nobody is alone;
    `recovery` is called when the wire is taken; `ended` after everything that was not calm,
    with the states that nodes were in before.
    """

    def __init__(
        self,
        bus: "Bus",
        controllers: Sequence[Controller],
        recovery: BusOffRecovery,
        ended: Callable[[States], object],
    ) -> None:
        self.calm = False
        self.requests = SendRequests()
        self._next_number = bus.sequence.__next__
        self.receivers = Receivers(controllers, bus.observers)
        self.free_ns = 0
        self._bus = bus
        self._kernel = bus.kernel
        self._bit_ns = bus.bit_ns
        self._interframe_ns = INTERFRAME_BITS * bus.bit_ns
        self._controllers = controllers
        self._recovery = recovery
        self._ended = ended
        self._arbitrating = False
        # The frame on the wire: a frame that all is well with, or an exchange and how it will end.
        self._sending: tuple[Controller, Frame] | None = None
        self._exchange: tuple[Exchange, ExchangeOutcome] | None = None
        self._lost_by: Collection[Controller] = ()
        self._start_ns = 0
        self._end_ns = -1

    @property
    def busy(self) -> bool:
        """Whether a frame is on the wire, or its outcome."""
        return self._sending is not None or self._exchange is not None

    def request(self, controller: Controller, frame: Frame) -> None:
        """A frame stands in a mailbox and wants the bus."""
        number = self._next_number()
        heappush(self.requests, (arbitration_field(frame[0]), number, controller, frame))
        if not self._arbitrating:
            self._schedule_arbitration()

    def _schedule_arbitration(self) -> None:
        self._arbitrating = True
        start_ns = max(self._next_bit_ns(), self.free_ns)
        self._kernel.at(start_ns, PRIORITY_ARBITRATE, self._arbitrate)

    def _next_bit_ns(self) -> int:
        return -(-self._kernel.now_ns // self._bit_ns) * self._bit_ns

    def _arbitrate(self) -> None:
        if self.busy:
            return
        if self.requests:
            self._contend(self._kernel.now_ns)
        else:
            self._arbitrating = False

    def _contend(self, start_ns: int) -> None:
        """Lets the lowest of the requests have the bus from `start_ns` on."""
        requests = self.requests
        if not self.calm:
            self._contend_carefully(start_ns)
            return
        lowest = heappop(requests)
        if requests and requests[0][0] == lowest[0]:
            heappush(requests, lowest)
            self._contend_carefully(start_ns)
            return
        _, _, controller, frame = lowest
        self._sending = controller, frame
        self._start_ns = start_ns
        self._end_ns = end_ns = start_ns + frame_bits(frame) * self._bit_ns
        self.free_ns = free_ns = end_ns + self._interframe_ns
        self._bus.busy_ns += free_ns - start_ns
        self._kernel.at(end_ns, PRIORITY_END, self._end)

    def _end(self) -> None:
        kernel = self._kernel
        now_ns = kernel.now_ns
        if now_ns != self._end_ns:
            return  # something has happened since, and the end is another
        self._end_ns = -1
        sending = self._sending
        if sending is None:
            self._end_carefully()
        else:
            self._sending = None
            sender, frame = sending
            self._bus.frames += 1
            observers, receivers = self.receivers[frame[0]]
            for observer in observers:
                observer(frame, now_ns)
            for receiver in receivers:
                if receiver is not sender:
                    receiver.take(frame, now_ns)
            sender.on_sent(frame)
        if not self.requests:
            self._arbitrating = False
        elif kernel.nothing_until(self.free_ns):
            self._contend(self.free_ns)
        else:
            self._schedule_arbitration()

    # The careful way

    def _contend_carefully(self, start_ns: int) -> None:
        frames = self.requests.contenders(start_ns)
        if not frames:
            wake_ns = min(each[2].suspended_until_ns for each in self.requests)
            self._arbitrating = False
            self._kernel.at(wake_ns, PRIORITY_ARBITRATE, self._wake)
            return
        disturbance = UNDISTURBED
        if self._bus.disturbance is not None:
            disturbance = self._bus.disturbance(*frames[0]) or UNDISTURBED
        if disturbance.bit is None:
            key = arbitration_field(frames[0][1].can_id)
            frames = [each for each in frames if arbitration_field(each[1].can_id) == key]
        senders = [controller for controller, _ in frames]
        listeners = [each for each in self._controllers if each.live and each not in senders]
        self._lost_by = disturbance.lost_by
        self._start_ns = self.free_ns = start_ns
        self._watch(Exchange(start_ns, parties(frames, listeners, disturbance), disturbance.bit))
        if self._recovery:
            self._recovery.on_frame(start_ns, self.free_ns)

    def _wake(self) -> None:
        """A node that had to let others go first need not wait any longer."""
        if self.requests and not self._arbitrating:
            self._schedule_arbitration()

    def _watch(self, exchange: Exchange) -> None:
        """Sees an exchange to its end, the frame's or the error frame's."""
        outcome = exchange.outcome()
        self._exchange = exchange, outcome
        self._start_ns = exchange.start_ns
        end_bits = outcome.frame_bits or max(0, outcome.free_bits - INTERFRAME_BITS)
        self._end_ns = exchange.start_ns + end_bits * self._bit_ns
        free_ns = exchange.start_ns + outcome.free_bits * self._bit_ns
        self._bus.busy_ns += free_ns - self.free_ns
        self.free_ns = free_ns
        self._arbitrating = True
        self._kernel.at(self._end_ns, PRIORITY_END, self._end)

    def _end_carefully(self) -> None:
        assert self._exchange is not None
        (_, outcome), self._exchange = self._exchange, None
        states = [(each, each.state) for each in self._controllers]
        outcome.settle(self.free_ns - outcome.free_bits * self._bit_ns, self._bit_ns)
        if outcome.frame is not None:
            self._hand_over(outcome.frame, outcome)
        if outcome.error:
            # After a frame that some have got it is still under way.
            error_ns = max(self.free_ns - self._interframe_ns, self._kernel.now_ns)
            self._kernel.at(error_ns, PRIORITY_END, self._bus.on_error)
        self._ended(states)

    def _hand_over(self, frame: Frame, outcome: ExchangeOutcome) -> None:
        now_ns = self._kernel.now_ns
        self._bus.frames += 1
        observers, receivers = self.receivers[frame.can_id]
        for observer in observers:
            observer(frame, now_ns)
        for receiver in receivers:
            if receiver in outcome.heard and receiver not in self._lost_by:
                receiver.take(frame, now_ns)
        for sender in outcome.sent:
            self.requests.drop(sender, frame)
            sender.on_sent(frame)

    # Who comes and goes meanwhile

    def progress(self, stays: Callable[[Controller], object]) -> list[Party]:
        """How far those who stay have come by the next bit."""
        bits = (self._next_bit_ns() - self._start_ns) // self._bit_ns
        if self._exchange is not None:
            return self._exchange[0].after(bits, stays)
        frames = [] if self._sending is None else [self._sending]
        senders = [controller for controller, _ in frames]
        everybody = parties(
            frames, (each for each in self._controllers if each.live and each not in senders)
        )
        return Exchange(self._start_ns, everybody).after(bits if frames else 0, stays)

    def resume(self, those: Sequence[Party]) -> None:
        """Goes on from the next bit with the present nodes."""
        now_ns, flip = self._next_bit_ns(), None
        if self._exchange is not None and self._exchange[0].flip is not None:
            flip = self._exchange[0].flip - (now_ns - self._start_ns) // self._bit_ns
        if self._sending is not None:
            self._arbitrating = True
            self.request(*self._sending)
        if not self.busy:
            self.free_ns = max(self.free_ns, now_ns)
            self._recovery.on_frame(now_ns, now_ns)
        self._sending = self._exchange = None
        if those:
            self._watch(Exchange(now_ns, those, flip))
        else:
            self._rest(now_ns)
        self._recovery.postpone(self.free_ns)

    def _rest(self, now_ns: int) -> None:
        """Nobody is left on the wire."""
        self._bus.busy_ns += now_ns - self.free_ns
        self.free_ns, self._end_ns = now_ns, -1
        self._arbitrating = False
        self._wake()
