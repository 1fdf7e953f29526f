"""What is on one wire: who sends next, how long it takes, who receives it.

Bit boundaries lie at multiples of the bit time. All frames that ask for the bus within one bit
time contend for it; each takes its real length with stuff bits and the inter-frame space after it.
While all is well, a frame costs one event; everything else goes the careful way, by an `Exchange`,
which follows what each node makes of every bit.
"""

from collections.abc import Callable, Collection, Sequence
from heapq import heappop, heappush
from typing import TYPE_CHECKING

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.acceptance import Receivers
from mdms_sim.bus.confinement import ErrorState
from mdms_sim.bus.controller import Controller, Requests
from mdms_sim.bus.exchange import Exchange, Outcome
from mdms_sim.bus.length import frame_bits
from mdms_sim.bus.party import UNDISTURBED, Party, parties
from mdms_sim.bus.recovery import Recovery
from mdms_sim.bus.wire import INTERFRAME_BITS, arbitration_field

if TYPE_CHECKING:
    from mdms_sim.bus.bus import Bus

#: Frames end before anything else happens at that instant, and arbitration sees all requests of it.
PRIORITY_END = 0
PRIORITY_ARBITRATE = 1000

States = Sequence[tuple[Controller, ErrorState]]


class Traffic:
    """The frames on the wire of these controllers.

    `calm` may be set while no counter is above 0, nothing is disturbed and nobody is alone;
    `recovery` is called when the wire is taken; `ended` after everything that was not calm,
    with the states that nodes were in before.
    """

    def __init__(
        self,
        bus: "Bus",
        controllers: Sequence[Controller],
        recovery: Recovery,
        ended: Callable[[States], object],
    ) -> None:
        self.calm = False
        self.requests = Requests()
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
        # What is on the wire: a frame that all is well with, or an exchange and how it will end.
        self._sending: tuple[Controller, Frame] | None = None
        self._exchange: tuple[Exchange, Outcome] | None = None
        self._lost_by: Collection[Controller] = ()
        self._start_ns = 0
        self._end_ns = -1

    @property
    def busy(self) -> bool:
        """Whether a frame is on the wire, or what has become of it."""
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
        """Somebody who had to let others go first need not wait any longer."""
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

    def _hand_over(self, frame: Frame, outcome: Outcome) -> None:
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
        """Goes on from the next bit with those who are there now."""
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
