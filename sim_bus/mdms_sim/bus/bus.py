"""The shared wire: who sends next, how long it takes, who hears it.

Bit boundaries lie at multiples of the bit time. All frames that ask for the bus within one bit
time contend for it; each takes its real length with stuff bits and the inter-frame space after it.
"""

from collections.abc import Callable, Container
from heapq import heappop, heappush
from itertools import count

from mdms_protocol.frame import Frame
from mdms_sim.bus.controller import Controller, Station
from mdms_sim.bus.wire import INTERFRAME_BITS, arbitration_field, frame_bits
from mdms_sim.kernel import Kernel

NS_PER_S = 1_000_000_000
#: Frames end before anything else happens at that instant, and arbitration sees all requests of it.
PRIORITY_END = 0
PRIORITY_ARBITRATE = 1000
#: Identifiers whose receivers are remembered; a flood of others costs time, not memory.
REMEMBERED_IDENTIFIERS = 4096

Observer = Callable[[Frame, int], object]


class Bus:
    """A CAN bus in simulated time.

    `frames` counts those that got through, `errors` error frames, `busy_ns` the time the bus was
    not idle, inter-frame spaces included.
    """

    def __init__(self, kernel: Kernel, bitrate: int = 1_000_000) -> None:
        if bitrate <= 0 or NS_PER_S % bitrate:
            raise ValueError(f"bit rate {bitrate} does not give a whole number of ns per bit")
        self.bit_ns = NS_PER_S // bitrate
        self.frames = 0
        self.errors = 0
        self.busy_ns = 0
        self._kernel = kernel
        self._controllers: list[Controller] = []
        self._observers: list[Observer] = []
        self._receivers: dict[int, tuple[Controller, ...]] = {}
        self._requests: list[tuple[int, int, Controller, Frame]] = []
        self._sequence = count()
        self._arbitrating = False
        self._free_ns = 0

    def attach(self, station: Station, accept: Container[int] | None = None) -> Controller:
        """A new controller for `station`, which gets the frames whose `can_id` is in `accept`.

        None accepts every frame. A station does not hear its own frames.
        """
        controller = Controller(self, station, accept)
        self._controllers.append(controller)
        self._receivers.clear()
        return controller

    def set_filter(self, controller: Controller, accept: Container[int] | None) -> None:
        """Changes what a controller lets through, from the next end of a frame on."""
        controller.accept = accept
        self._receivers.clear()

    def observe(self, observer: Observer) -> None:
        """Has `observer(frame, now_ns)` called at the end of every frame on the bus."""
        self._observers.append(observer)

    def load(self) -> float:
        """Share of the time since start in which the bus was not idle."""
        return self.busy_ns / self._kernel.now_ns if self._kernel.now_ns else 0.0

    def request(self, controller: Controller, frame: Frame) -> None:
        """A frame stands in a mailbox and wants the bus; called by controllers."""
        key = arbitration_field(frame.can_id)
        heappush(self._requests, (key, next(self._sequence), controller, frame))
        if not self._arbitrating:
            self._schedule_arbitration()

    def _schedule_arbitration(self) -> None:
        bit_ns = self.bit_ns
        boundary_ns = -(-self._kernel.now_ns // bit_ns) * bit_ns
        self._arbitrating = True
        self._kernel.at(max(boundary_ns, self._free_ns), PRIORITY_ARBITRATE, self._arbitrate)

    def _arbitrate(self) -> None:
        _, _, controller, frame = heappop(self._requests)
        duration_ns = frame_bits(frame) * self.bit_ns
        end_ns = self._kernel.now_ns + duration_ns
        self._free_ns = end_ns + INTERFRAME_BITS * self.bit_ns
        self.busy_ns += self._free_ns - self._kernel.now_ns
        self._kernel.at(end_ns, PRIORITY_END, lambda: self._end(controller, frame))

    def _end(self, sender: Controller, frame: Frame) -> None:
        now_ns = self._kernel.now_ns
        self.frames += 1
        for observer in self._observers:
            observer(frame, now_ns)
        for receiver in self._receivers_of(frame.can_id):
            if receiver is not sender:
                receiver.on_received(frame, now_ns)
        sender.on_sent(frame)
        self._arbitrating = False
        if self._requests:
            self._schedule_arbitration()

    def _receivers_of(self, can_id: int) -> tuple[Controller, ...]:
        known = self._receivers.get(can_id)
        if known is None:
            if len(self._receivers) >= REMEMBERED_IDENTIFIERS:
                self._receivers.clear()
            known = tuple(c for c in self._controllers if c.accept is None or can_id in c.accept)
            self._receivers[can_id] = known
        return known
