"""The CAN bus in simulated time: its nodes, its traffic, its disturbances."""

from collections.abc import Callable, Collection, Container
from itertools import count

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.controller import (
    Acceptance,
    Controller,
    ErrorState,
    FrameObserver,
    Observation,
    Station,
)
from mdms_sim.bus.exchange import Disturbance
from mdms_sim.bus.segment import Segment
from mdms_sim.kernel import Kernel

NS_PER_S = 1_000_000_000
BITRATE_MIN = 10_000
BITRATE_MAX = 1_000_000

ErrorObserver = Callable[[int], object]
StateObserver = Callable[[Controller, int], object]
Disturb = Callable[[Controller, Frame], Disturbance | None]


class Bus:
    """One wire, or several while it is cut.

    `frames` counts those that got through, `errors` error frames, `busy_ns` the time
    that the bus was not idle, inter-frame spaces included. Raises ValueError for a bit rate without
    a whole number of ns per bit or outside of 10 kbit/s to 1 Mbit/s.
    """

    def __init__(self, kernel: Kernel, bitrate: int = BITRATE_MAX) -> None:
        if not BITRATE_MIN <= bitrate <= BITRATE_MAX or NS_PER_S % bitrate:
            raise ValueError(
                f"bit rate must be {BITRATE_MIN} to {BITRATE_MAX} bit/s and divide 1 s into whole "
                f"ns, got {bitrate}"
            )
        self.kernel = kernel
        self.bitrate = bitrate
        self.bit_ns = NS_PER_S // bitrate
        self.frames = 0
        self.errors = 0
        self.busy_ns = 0
        self.sequence = count()
        self.observers: list[Observation] = []
        self.disturbance: Disturb | None = None
        self._error_observers: list[ErrorObserver] = []
        self._state_observers: list[StateObserver] = []
        self._segments = [Segment(self)]

    def attach(self, station: Station, accept: Container[int] | None = None) -> Controller:
        """A new controller for `station`, which gets the frames whose `can_id` is in `accept`.

        None accepts every frame. A station does not receive its own frames.
        """
        controller = Controller(self._segments[0], station, None)
        self._segments[0].add(controller)
        self.set_filter(controller, accept)
        return controller

    def detach(self, controller: Controller) -> None:
        """Takes a controller off the bus with everything it had to send."""
        controller.segment.remove((controller,))
        controller.live = False
        controller.drop_queue()

    def set_filter(self, controller: Controller, accept: Container[int] | None) -> None:
        """Changes the filter of a controller, from the next end of a frame on."""
        controller.accept = accept
        if isinstance(accept, Acceptance):
            accept.on_change(self._reconsider)
        controller.segment.reconsider()

    @property
    def controllers(self) -> list[Controller]:
        """All that are attached, piece by piece."""
        return [each for segment in self._segments for each in segment.controllers]

    def switch_off(self, controller: Controller) -> None:
        """The node loses its power: it neither sends nor acknowledges, and loses its frames.

        Its error counters are lost too, and a way back from bus off ends.
        """
        was_off = controller.state is ErrorState.BUS_OFF
        controller.segment.silence((controller,))
        controller.live = False
        controller.drop_queue()
        controller.errors.reset()
        controller.segment.reconsider()
        if was_off:
            self.on_state(controller)

    def switch_on(self, controller: Controller) -> None:
        """The node starts anew, and receives what begins from now on."""
        controller.segment.silence((controller,))
        controller.live = True
        controller.segment.reconsider()

    def recover(self, controller: Controller) -> None:
        """Starts the way back from bus off: 128 times eleven recessive bits; what waits is sent."""
        controller.segment.recover(controller)

    # What can be watched

    def observe(self, observer: FrameObserver, accept: Container[int] | None = None) -> None:
        """Has `observer(frame, now_ns)` called at the end of every frame whose `can_id` it accepts.

        None accepts every frame.
        """
        self.observers.append((observer, accept))
        self._reconsider()

    def observe_errors(self, observer: ErrorObserver) -> None:
        """Has `observer(now_ns)` called at the end of every error frame."""
        self._error_observers.append(observer)

    def observe_states(self, observer: StateObserver) -> None:
        """Has `observer(controller, now_ns)` called when a node becomes passive, off or active."""
        self._state_observers.append(observer)

    def on_error(self) -> None:
        """An error frame has ended; called by segments."""
        self.errors += 1
        for observer in self._error_observers:
            observer(self.kernel.now_ns)

    def on_state(self, controller: Controller) -> None:
        """A node's error state has changed; called by segments."""
        for observer in self._state_observers:
            observer(controller, self.kernel.now_ns)

    def _reconsider(self) -> None:
        for segment in self._segments:
            segment.reconsider()

    def load(self) -> float:
        """Share of the time since start in which the bus was not idle."""
        return self.busy_ns / self.kernel.now_ns if self.kernel.now_ns else 0.0

    # What can go wrong

    def disturb(self, disturb: Disturb | None) -> None:
        """Has `disturb(sender, frame)` say what happens to each transmission, from the next on."""
        self.disturbance = disturb
        self._reconsider()

    def cut(self, group: Collection[Controller]) -> Segment:
        """Cuts the wire: `group` goes on alone.

        A frame on the wire goes on where its sender is; for the others it ends in recessive bits.
        """
        piece = Segment(self)
        for segment in tuple(self._segments):
            members = [each for each in group if each.segment is segment]
            if members:
                segment.move(members, piece)
        self._segments.append(piece)
        return piece

    def heal(self, piece: Segment) -> None:
        """Joins a piece to the main wire again; all see from now on what any of them drives."""
        self._segments.remove(piece)
        piece.move(tuple(piece.controllers), self._segments[0])
