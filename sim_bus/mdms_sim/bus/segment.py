"""One piece of wire: who sends next, how long it takes, who hears it.

Bit boundaries lie at multiples of the bit time. All frames that ask for the bus within one bit
time contend for it; each takes its real length with stuff bits and the inter-frame space after it.
While all is well, an attempt to send costs two events; everything else goes the careful way, where
`attempt` tells what each node makes of the bits.
"""

from collections.abc import Collection, Container
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING

from mdms_protocol.frame import Frame
from mdms_sim.bus.attempt import UNDISTURBED, Attempt, attempt
from mdms_sim.bus.confinement import ErrorState
from mdms_sim.bus.controller import Controller
from mdms_sim.bus.length import frame_bits
from mdms_sim.bus.receivers import Receivers
from mdms_sim.bus.recovery import Recovery
from mdms_sim.bus.wire import INTERFRAME_BITS, arbitration_field
from mdms_sim.kernel import Action

if TYPE_CHECKING:
    from mdms_sim.bus.bus import Bus

#: Frames end before anything else happens at that instant, and arbitration sees all requests of it.
PRIORITY_END = 0
PRIORITY_ARBITRATE = 1000
#: An error passive node that has just sent lets others go first for so long.
SUSPEND_BITS = 8

_Request = tuple[int, int, Controller, Frame]


class Segment:
    """Controllers that hear each other."""

    def __init__(self, bus: "Bus") -> None:
        self.controllers: list[Controller] = []
        self._bus = bus
        self._kernel = bus.kernel
        self._observers = bus.observers
        self._next_number = bus.sequence.__next__
        self._bit_ns = bus.bit_ns
        self._interframe_ns = INTERFRAME_BITS * bus.bit_ns
        self._receivers = Receivers(self.controllers)
        self._requests: list[_Request] = []
        self._arbitrating = False
        self._free_ns = 0
        self._senders: tuple[tuple[Controller, Frame], ...] = ()
        self._attempt: Attempt | None = None
        self._broken = False
        self._lost_by: Collection[Controller] = ()
        self._recovery = Recovery(bus.kernel, bus.bit_ns, self._recovered)
        self._calm = False

    # Who is there

    def add(self, controller: Controller) -> None:
        """Puts a controller on this wire."""
        controller.segment = self
        self.controllers.append(controller)
        if controller.live and not controller.listen_only:
            controller.request_again()
        self.reconsider()

    def remove(self, controller: Controller) -> None:
        """Takes it off; a frame that it is sending breaks off."""
        self.controllers.remove(controller)
        self._recovery.drop(controller)
        self.silence(controller)

    def silence(self, controller: Controller) -> None:
        """The controller sends nothing more of what it has asked to send."""
        self._requests = [each for each in self._requests if each[2] is not controller]
        heapify(self._requests)
        if any(sender is controller for sender, _ in self._senders):
            self._broken = True
        self.reconsider()

    def break_off(self) -> None:
        """Destroys the frame on the wire, if any."""
        self._broken = bool(self._senders)

    def reconsider(self) -> None:
        """Forgets who hears what, and whether all is well; to be called when either may change."""
        self._receivers.clear()
        listening = sum(1 for each in self.controllers if each.live and not each.listen_only)
        self._calm = (
            listening > 1
            and self._bus.disturbance is None
            and all(each.errors.clean for each in self.controllers)
        )

    # Sending

    def request(self, controller: Controller, frame: Frame) -> None:
        """A frame stands in a mailbox and wants the bus."""
        key = arbitration_field(frame.can_id)
        heappush(self._requests, (key, self._next_number(), controller, frame))
        if not self._arbitrating:
            self._schedule_arbitration()

    def later(self, delay_ns: int, action: Action) -> None:
        """Has `action` called after a time."""
        self._kernel.at(self._kernel.now_ns + delay_ns, PRIORITY_END, action)

    def _schedule_arbitration(self) -> None:
        bit_ns = self._bit_ns
        boundary_ns = -(-self._kernel.now_ns // bit_ns) * bit_ns
        self._arbitrating = True
        self._kernel.at(max(boundary_ns, self._free_ns), PRIORITY_ARBITRATE, self._arbitrate)

    def _arbitrate(self) -> None:
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
        key, _, controller, frame = heappop(requests)
        if requests and requests[0][0] == key:
            self._start(start_ns, ((controller, frame), *self._pop_rivals(key)))
        else:
            self._senders = ((controller, frame),)
            self._occupy(start_ns, frame_bits(frame))

    def _wake(self) -> None:
        """Somebody who had to let others go first need not wait any longer."""
        if self._requests and not self._arbitrating:
            self._schedule_arbitration()

    def _pop_rivals(self, key: int) -> list[tuple[Controller, Frame]]:
        """The other requests with the same arbitration field, one of each controller."""
        rivals = []
        while self._requests and self._requests[0][0] == key:
            _, _, controller, frame = heappop(self._requests)
            rivals.append((controller, frame))
        return rivals

    def _contend_carefully(self, start_ns: int) -> None:
        ready = [each for each in self._requests if each[2].suspended_until_ns <= start_ns]
        if not ready:
            wake_ns = min(each[2].suspended_until_ns for each in self._requests)
            self._arbitrating = False
            self._kernel.at(wake_ns, PRIORITY_ARBITRATE, self._wake)
            return
        key = min(ready)[0]
        chosen = sorted(each for each in ready if each[0] == key)
        self._requests = [each for each in self._requests if each not in chosen]
        heapify(self._requests)
        self._start(start_ns, tuple((controller, frame) for _, _, controller, frame in chosen))

    def _start(self, start_ns: int, frames: tuple[tuple[Controller, Frame], ...]) -> None:
        """The careful way: works out at the start how it will end."""
        senders = [controller for controller, _ in frames]
        receivers = [
            each
            for each in self.controllers
            if each.live and not each.listen_only and each not in senders
        ]
        disturbance = UNDISTURBED
        if self._bus.disturbance is not None:
            disturbance = self._bus.disturbance(*frames[0]) or UNDISTURBED
        self._senders = frames
        self._attempt = attempt(frames, receivers, disturbance)
        self._lost_by = disturbance.lost_by
        self._occupy(start_ns, self._attempt.bits)

    def _occupy(self, start_ns: int, bits: int) -> None:
        end_ns = start_ns + bits * self._bit_ns
        self._free_ns = free_ns = end_ns + self._interframe_ns
        self._bus.busy_ns += free_ns - start_ns
        if self._recovery:
            self._recovery.on_frame(start_ns, free_ns)
        self._kernel.at(end_ns, PRIORITY_END, self._end)

    # Ending

    def _end(self) -> None:
        frames, self._senders = self._senders, ()
        if self._attempt is None and not self._broken:
            sender, frame = frames[0]
            self._hand_over(frame, (sender,))
            sender.on_sent(frame)
        else:
            self._end_carefully(frames)
        if self._requests and self._kernel.nothing_until(self._free_ns):
            self._contend(self._free_ns)
        elif self._requests:
            self._schedule_arbitration()
        else:
            self._arbitrating = False

    def _hand_over(self, frame: Frame, deaf: Container[Controller]) -> None:
        now_ns = self._kernel.now_ns
        self._bus.frames += 1
        for observer in self._observers:
            observer(frame, now_ns)
        for receiver in self._receivers[frame.can_id]:
            if receiver not in deaf:
                receiver.take(frame, now_ns)

    def _end_carefully(self, frames: tuple[tuple[Controller, Frame], ...]) -> None:
        outcome, self._attempt = self._attempt, None
        if self._broken or outcome is None:
            self._broken = False
            outcome = Attempt(0, destroyed=True, failed=[sender for sender, _ in frames])
        before = {each: each.state for each in self.controllers}
        outcome.count(self.controllers)
        for sender, frame in frames:
            if sender not in outcome.sent and sender.live:
                self.request(sender, frame)
        if outcome.destroyed:
            self._bus.on_error()
        else:
            self._deliver_carefully(outcome, frames)
        self._suspend(frames)
        self._tell_states(before)
        self.reconsider()

    def _deliver_carefully(
        self, outcome: Attempt, frames: tuple[tuple[Controller, Frame], ...]
    ) -> None:
        confused = [node for node, _ in outcome.confused]
        frame = next(frame for sender, frame in frames if sender is outcome.sent[0])
        deaf = {*(sender for sender, _ in frames), *confused, *self._lost_by}
        self._hand_over(frame, deaf)
        for sender in outcome.sent:
            sender.on_sent(frame)

    def _suspend(self, frames: tuple[tuple[Controller, Frame], ...]) -> None:
        for sender, _ in frames:
            if sender.state is ErrorState.PASSIVE:
                sender.suspended_until_ns = self._free_ns + SUSPEND_BITS * self._bit_ns

    def _tell_states(self, before: dict[Controller, ErrorState]) -> None:
        for node, state in before.items():
            if node.state is not state:
                if node.state is ErrorState.BUS_OFF:
                    node.live = False
                    self.silence(node)
                self._bus.on_state(node)

    # Coming back from bus off

    def recover(self, controller: Controller) -> None:
        """Lets a node that is bus off come back."""
        self._recovery.start(controller, max(self._kernel.now_ns, self._free_ns))

    def _recovered(self, controller: Controller) -> None:
        controller.errors.reset()
        controller.live = True
        self._bus.on_state(controller)
        controller.request_again()
        self.reconsider()
