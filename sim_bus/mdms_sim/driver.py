"""How the simulation drives what is on the bus besides the cells."""

from functools import partial
from math import ceil, isinf

from mdms_model.participant import Participant
from mdms_protocol.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.kernel import Kernel

NS_PER_S = 1_000_000_000
#: A participant is not polled more often than this.
POLL_NS = 100_000
#: After the world has moved and the cells have answered at that instant.
PRIORITY_POLL = 30


class Driver:
    """Puts a participant on the bus and polls it when it wants to be polled.

    A participant that has left is not polled and receives nothing, whatever it had to send is lost.
    """

    def __init__(self, kernel: Kernel, bus: Bus, participant: Participant) -> None:
        self._kernel = kernel
        self._bus = bus
        self._left = 0
        self._participant = participant
        self._mailbox = bus.attach(self)
        self._due_ns: int | None = None
        self._earliest_ns = 0
        self._wake_s = participant.wake_s
        self._schedule(self._wake_s)

    def leave(self) -> None:
        """Takes the participant off the bus, until it has rejoined as often as it has left."""
        self._left += 1
        self._bus.switch_off(self._mailbox)

    def rejoin(self) -> None:
        """Puts it back, as late as it is: it is polled at once for what was due."""
        self._left -= 1
        if not self._left:
            self._bus.switch_on(self._mailbox)
            self._schedule(self._participant.wake_s)

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """A frame was on the bus."""
        participant = self._participant
        participant.on_frame(frame, now_ns / NS_PER_S)
        wake_s = participant.wake_s
        if wake_s != self._wake_s:
            self._schedule(wake_s)

    def _schedule(self, wake_s: float) -> None:
        self._wake_s = wake_s
        if isinf(wake_s):
            return
        wake_ns = max(ceil(wake_s * NS_PER_S), self._kernel.now_ns, self._earliest_ns)
        if self._due_ns is None or wake_ns < self._due_ns:
            self._due_ns = wake_ns
            self._kernel.at(wake_ns, PRIORITY_POLL, partial(self._poll, wake_ns))

    def _poll(self, due_ns: int) -> None:
        if due_ns != self._due_ns:
            return
        if self._left:
            self._due_ns = None
            return
        for frame in self._participant.poll(due_ns / NS_PER_S):
            self._mailbox.send(frame)
        self._due_ns = None
        self._earliest_ns = due_ns + POLL_NS
        self._schedule(self._participant.wake_s)
