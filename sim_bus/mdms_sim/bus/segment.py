"""One piece of wire: the frames on it, its nodes, and the fate of a frame when they come or go.

Bit boundaries lie at multiples of the bit time. All frames that ask for the bus within one bit time
contend for it; each takes its real length with stuff bits and the inter-frame space after it. While
all is well, a frame costs one event; everything else goes the careful way, by an `Exchange`, which
follows what each node makes of every bit.
"""

from collections.abc import Callable, Collection, Sequence
from heapq import heappop, heappush
from typing import TYPE_CHECKING

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.controller import (
    BusOffRecovery,
    Controller,
    ErrorState,
    Receivers,
    SendRequests,
)
from mdms_sim.bus.exchange import UNDISTURBED, Exchange, ExchangeOutcome, Party, parties
from mdms_sim.bus.identifier import arbitration_field
from mdms_sim.bus.wire import INTERFRAME_BITS, frame_bits
from mdms_sim.kernel import Action

if TYPE_CHECKING:
    from mdms_sim.bus.bus import Bus

#: Frames end before anything else happens at that instant, and arbitration sees all requests of it.
PRIORITY_END = 0
PRIORITY_ARBITRATE = 1000


class Segment:
    """Controllers that receive each other."""

    def __init__(self, bus: "Bus") -> None:
        self.controllers: list[Controller] = []
        self.bus = bus
        self._kernel = bus.kernel
        self._bit_ns = bus.bit_ns
        self._interframe_ns = INTERFRAME_BITS * bus.bit_ns
        self._recovery = BusOffRecovery(bus.kernel, bus.bit_ns, self._recovered)
        self._requests = SendRequests()
        self._next_number = bus.sequence.__next__
        self._receivers = Receivers(self.controllers, bus.observers)
        #: No counter is above 0, nothing is disturbed and nobody is alone.
        self._calm = False
        self._arbitrating = False
        # The frame on the wire: a frame that all is well with, or an exchange and how it will end.
        self._sending: tuple[Controller, Frame] | None = None
        self._exchange: tuple[Exchange, ExchangeOutcome] | None = None
        self._lost_by: Collection[Controller] = ()
        self._start_ns = 0
        self._end_ns = -1
        #: When the wire is free for the next frame.
        self._free_ns = 0

    # The frames

    @property
    def _busy(self) -> bool:
        """Whether a frame is on the wire, or its outcome."""
        return self._sending is not None or self._exchange is not None

    def request(self, controller: Controller, frame: Frame) -> None:
        """A frame stands in a mailbox and wants the bus."""
        number = self._next_number()
        heappush(self._requests, (arbitration_field(frame[0]), number, controller, frame))
        if not self._arbitrating:
            self._schedule_arbitration()

    def _schedule_arbitration(self) -> None:
        self._arbitrating = True
        start_ns = max(self._next_bit_ns(), self._free_ns)
        self._kernel.at(start_ns, PRIORITY_ARBITRATE, self._arbitrate)

    def _next_bit_ns(self) -> int:
        return -(-self._kernel.now_ns // self._bit_ns) * self._bit_ns

    def _arbitrate(self) -> None:
        if self._busy:
            return
        if self._requests:
            self._contend(self._kernel.now_ns)
        else:
            self._arbitrating = False

    def _contend(self, start_ns: int) -> None:
        """Lets the lowest of the requests have the bus from `start_ns` on."""
        requests = self._requests
        if not self._calm:
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
        self._free_ns = free_ns = end_ns + self._interframe_ns
        self.bus.busy_ns += free_ns - start_ns
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
            self.bus.frames += 1
            observers, receivers = self._receivers[frame[0]]
            for observer in observers:
                observer(frame, now_ns)
            for receiver in receivers:
                if receiver is not sender:
                    receiver.take(frame, now_ns)
            sender.on_sent(frame)
        if not self._requests:
            self._arbitrating = False
        elif kernel.nothing_until(self._free_ns):
            self._contend(self._free_ns)
        else:
            self._schedule_arbitration()

    # The frames, the careful way

    def _contend_carefully(self, start_ns: int) -> None:
        frames = self._requests.contenders(start_ns)
        if not frames:
            wake_ns = min(each[2].suspended_until_ns for each in self._requests)
            self._arbitrating = False
            self._kernel.at(wake_ns, PRIORITY_ARBITRATE, self._wake)
            return
        disturbance = UNDISTURBED
        if self.bus.disturbance is not None:
            disturbance = self.bus.disturbance(*frames[0]) or UNDISTURBED
        if disturbance.bit is None:
            key = arbitration_field(frames[0][1].can_id)
            frames = [each for each in frames if arbitration_field(each[1].can_id) == key]
        senders = [controller for controller, _ in frames]
        listeners = [each for each in self.controllers if each.live and each not in senders]
        self._lost_by = disturbance.lost_by
        self._start_ns = self._free_ns = start_ns
        self._watch(Exchange(start_ns, parties(frames, listeners, disturbance), disturbance.bit))
        if self._recovery:
            self._recovery.on_frame(start_ns, self._free_ns)

    def _wake(self) -> None:
        """A node that had to let others go first need not wait any longer."""
        if self._requests and not self._arbitrating:
            self._schedule_arbitration()

    def _watch(self, exchange: Exchange) -> None:
        """Sees an exchange to its end, the frame's or the error frame's."""
        outcome = exchange.outcome()
        self._exchange = exchange, outcome
        self._start_ns = exchange.start_ns
        end_bits = outcome.frame_bits or max(0, outcome.free_bits - INTERFRAME_BITS)
        self._end_ns = exchange.start_ns + end_bits * self._bit_ns
        free_ns = exchange.start_ns + outcome.free_bits * self._bit_ns
        self.bus.busy_ns += free_ns - self._free_ns
        self._free_ns = free_ns
        self._arbitrating = True
        self._kernel.at(self._end_ns, PRIORITY_END, self._end)

    def _end_carefully(self) -> None:
        assert self._exchange is not None
        (_, outcome), self._exchange = self._exchange, None
        states = [(each, each.state) for each in self.controllers]
        outcome.settle(self._free_ns - outcome.free_bits * self._bit_ns, self._bit_ns)
        if outcome.frame is not None:
            self._hand_over(outcome.frame, outcome)
        if outcome.error:
            # After a frame that some have got it is still under way.
            error_ns = max(self._free_ns - self._interframe_ns, self._kernel.now_ns)
            self._kernel.at(error_ns, PRIORITY_END, self.bus.on_error)
        self._tell_states(states)

    def _hand_over(self, frame: Frame, outcome: ExchangeOutcome) -> None:
        now_ns = self._kernel.now_ns
        self.bus.frames += 1
        observers, receivers = self._receivers[frame.can_id]
        for observer in observers:
            observer(frame, now_ns)
        for receiver in receivers:
            if receiver in outcome.heard and receiver not in self._lost_by:
                receiver.take(frame, now_ns)
        for sender in outcome.sent:
            self._requests.drop(sender, frame)
            sender.on_sent(frame)

    def _tell_states(self, before: Sequence[tuple[Controller, ErrorState]]) -> None:
        for node, state in before:
            if node.state is not state:
                if node.state is ErrorState.BUS_OFF:
                    self.silence((node,))
                    node.live = False
                self.bus.on_state(node)
        self.reconsider()

    # The nodes that come and go

    def add(self, controller: Controller) -> None:
        """Puts a controller on this wire; it receives what begins from now on."""
        self._go_on_without(())
        self._take_in(controller)

    def remove(self, controllers: Collection[Controller]) -> None:
        """Takes them off at once; frames that they are sending end there."""
        self.silence(controllers)
        for controller in controllers:
            self.controllers.remove(controller)
        self.reconsider()

    def silence(self, controllers: Collection[Controller]) -> None:
        """They drive nothing more, do not receive the present frame, and want to send nothing."""
        self._go_on_without(controllers)
        for controller in controllers:
            self._requests.drop(controller)
            self._recovery.drop(controller)

    def move(self, controllers: Collection[Controller], other: "Segment") -> None:
        """Puts them on another wire, each in the midst of its frame.

        A node on its way back from bus off begins to count anew there.
        """
        recovering = [each for each in controllers if each in self._recovery]
        busy = self._busy or other._busy
        if busy:
            there = other._progress(lambda each: True)
            there += self._progress(lambda each: each in controllers)
        self.remove(controllers)
        other._free_ns = max(other._free_ns, self._free_ns)
        if busy:
            other._resume(there)
        for controller in controllers:
            other._take_in(controller)
        for controller in recovering:
            other.recover(controller)

    def _take_in(self, controller: Controller) -> None:
        controller.segment = self
        self.controllers.append(controller)
        if controller.live:
            controller.request_again()
        self.reconsider()

    def _go_on_without(self, controllers: Collection[Controller]) -> None:
        if self._busy:
            self._resume(self._progress(lambda each: each not in controllers))

    def reconsider(self) -> None:
        """Works out anew who receives what and whether all is well; either may have changed."""
        self._receivers.clear()
        listening = sum(1 for each in self.controllers if each.live)
        self._calm = (
            listening > 1
            and self.bus.disturbance is None
            and all(each.errors.clean for each in self.controllers)
        )

    def later(self, delay_ns: int, action: Action) -> None:
        """Has `action` called after a time."""
        self._kernel.at(self._kernel.now_ns + delay_ns, PRIORITY_END, action)

    def _progress(self, stays: Callable[[Controller], object]) -> list[Party]:
        """How far those who stay have come by the next bit."""
        bits = (self._next_bit_ns() - self._start_ns) // self._bit_ns
        if self._exchange is not None:
            return self._exchange[0].after(bits, stays)
        frames = [] if self._sending is None else [self._sending]
        senders = [controller for controller, _ in frames]
        everybody = parties(
            frames, (each for each in self.controllers if each.live and each not in senders)
        )
        return Exchange(self._start_ns, everybody).after(bits if frames else 0, stays)

    def _resume(self, those: Sequence[Party]) -> None:
        """Goes on from the next bit with the present nodes."""
        now_ns, flip = self._next_bit_ns(), None
        if self._exchange is not None and self._exchange[0].flip is not None:
            flip = self._exchange[0].flip - (now_ns - self._start_ns) // self._bit_ns
        if self._sending is not None:
            self._arbitrating = True
            self.request(*self._sending)
        if not self._busy:
            self._free_ns = max(self._free_ns, now_ns)
            self._recovery.on_frame(now_ns, now_ns)
        self._sending = self._exchange = None
        if those:
            self._watch(Exchange(now_ns, those, flip))
        else:
            self._rest(now_ns)
        self._recovery.postpone(self._free_ns)

    def _rest(self, now_ns: int) -> None:
        """Nobody is left on the wire."""
        self.bus.busy_ns += now_ns - self._free_ns
        self._free_ns, self._end_ns = now_ns, -1
        self._arbitrating = False
        self._wake()

    # Coming back from bus off

    def recover(self, controller: Controller) -> None:
        """Lets a node that is bus off come back."""
        self._recovery.start(controller, max(self._kernel.now_ns, self._free_ns))

    def _recovered(self, controller: Controller) -> None:
        controller.errors.reset()
        self._go_on_without(())
        controller.live = True
        self.bus.on_state(controller)
        controller.request_again()
        self.reconsider()
