"""The frames in mailboxes that want the bus, lowest arbitration field first."""

from heapq import heapify

from mdms_protocol.frame import Frame
from mdms_sim.bus.controller import Controller

Request = tuple[int, int, Controller, Frame]


class Requests(list[Request]):
    """A heap of (arbitration field, number, controller, frame); numbers order equals.

    Frames are pushed and popped with `heapq`.
    """

    def drop(self, controller: Controller, frame: Frame | None = None) -> None:
        """Forgets what a controller wants to send, or that frame of it."""
        kept = [each for each in self if each[2] is not controller or frame not in (None, each[3])]
        if len(kept) < len(self):
            self[:] = kept
            heapify(self)

    def contenders(self, now_ns: int) -> list[tuple[Controller, Frame]]:
        """The lowest of each controller that need not let others go first, lowest first."""
        first: dict[Controller, Frame] = {}
        for _, _, controller, frame in sorted(self):
            if controller.suspended_until_ns <= now_ns:
                first.setdefault(controller, frame)
        return list(first.items())
