"""A gateway between two buses: the forwarding of a real one, with two simulated controllers."""

from functools import partial
from typing import Any

from mdms_gateway.gateway import Gateway
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Controller
from mdms_sim.kernel import Kernel
from mdms_sim.nodes.bank import BusOffWatch

NS_PER_MS = 1_000_000
#: Latency of its background loop, as a cell's: from a frame's end to a mailbox of the other side.
TURN_NS = 100_000
#: With the cells' answers.
PRIORITY = 20


class GatewayNode:
    """A node on two buses, which forwards by `tables`: the first to the second bus, and back.

    `ways` are the two directions, with their counts.
    """

    def __init__(
        self, kernel: Kernel, buses: tuple[Bus, Bus], tables: tuple[dict[int, int], dict[int, int]]
    ) -> None:
        self._kernel = kernel
        self.ways: tuple[Any, Any] = Gateway(*tables).ways
        ears = [_Ear(partial(self._on_frame, side)) for side in range(2)]
        self.controllers: list[Controller] = [
            bus.attach(ear, frozenset(table))
            for bus, ear, table in zip(buses, ears, tables, strict=True)
        ]
        self._turning = False
        for bus in buses:
            BusOffWatch(kernel, bus, self.controllers, self)

    def set_bus_off(self, cell: int, off: bool) -> None:
        """Has nothing to switch off; what waits meanwhile grows overdue."""

    def _on_frame(self, side: int, frame: Frame, now_ns: int) -> None:
        self.ways[side].take(frame.can_id, frame.data, now_ns // NS_PER_MS)
        self._turn_soon()

    def _turn_soon(self) -> None:
        if not self._turning:
            self._turning = True
            self._kernel.at(self._kernel.now_ns + TURN_NS, PRIORITY, self._turn)

    def _turn(self) -> None:
        """One turn of its background loop, and another while anything waits."""
        self._turning = False
        for way, controller in zip(self.ways, reversed(self.controllers), strict=True):
            way.drain(partial(_send, controller), self._kernel.now_ns // NS_PER_MS)
        if any(way.waiting for way in self.ways):
            self._turn_soon()


class _Ear:
    """One side of a gateway as its bus sees it."""

    def __init__(self, on_frame: partial[None]) -> None:
        self.on_frame = on_frame


def _send(controller: Controller, can_id: int, data: bytes) -> bool | None:
    """As a board does: None while the bus is off, and while `machine.CAN.send` takes no more."""
    if not controller.live or not controller.has_room(can_id):
        return None
    return controller.send(Frame(can_id, data))
