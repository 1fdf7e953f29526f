"""Gateways between two simulated buses: frames that tables list, each under another identifier.

A gateway carries states, and only the newest state of an identifier counts. So one frame of an
identifier waits at most. A frame that a bus does not take within the time limit is dropped and
counted.
"""

from collections.abc import Callable, Mapping
from functools import partial

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Controller, Listener
from mdms_sim.kernel import Kernel
from mdms_sim.nodes.bank import BusOffWatch

NS_PER_MS = 1_000_000
#: Latency of its background loop, as a cell's: from a frame's end to a mailbox of the other side.
TURN_NS = 100_000
#: With the cells' answers.
PRIORITY = 20
#: One SYNC: then the next state of the same sender is due.
LIMIT_MS = 10
_DATA_MAX = 8

#: Sends a frame as a board does; None while there is no room.
Send = Callable[[int, bytes], bool | None]


class GatewayDirection:
    """One direction: `table` maps the identifiers that come in to those that leave.

    `forwarded` counts frames that the other bus has taken. `replaced` counts those that a newer one
    of their identifier has overtaken, and `overdue` those that waited for too long.
    """

    def __init__(self, table: Mapping[int, int]) -> None:
        self.forwarded = 0
        self.replaced = 0
        self.overdue = 0
        self._table = table
        # By identifier, the oldest first: the data of a frame, and when it came.
        self._frames: dict[int, tuple[bytes, int]] = {}

    @property
    def waiting(self) -> int:
        """How many frames wait for the other bus."""
        return len(self._frames)

    @property
    def dropped(self) -> int:
        """How many frames were listed and have not been forwarded."""
        return self.replaced + self.overdue

    def take(self, can_id: int, data: bytes, now_ms: int) -> None:
        """Take in a frame; ignore an identifier without an entry, and data too long for CAN."""
        if can_id not in self._table or len(data) > _DATA_MAX:
            return
        # The newer frame keeps the turn of the older one, so a frequent sender is not held up.
        self.replaced += can_id in self._frames
        self._frames[can_id] = (data, now_ms)

    def drain(self, send: Send, now_ms: int) -> None:
        """Send the frames that wait, the oldest first, until there is no room."""
        frames = self._frames
        while frames:
            can_id = next(iter(frames))
            data, since_ms = frames[can_id]
            if now_ms - since_ms > LIMIT_MS:
                self.overdue += 1
            elif send(self._table[can_id], data) is None:
                return
            else:
                self.forwarded += 1
            del frames[can_id]


class GatewayNode:
    """A node on two buses, which forwards by `tables`: the first to the second bus, and back.

    `ways` are the two directions, with their counts. Raises ValueError for tables by which a frame
    would come back, or two frames would become one.
    """

    def __init__(
        self, kernel: Kernel, buses: tuple[Bus, Bus], tables: tuple[dict[int, int], dict[int, int]]
    ) -> None:
        check_tables(*tables)
        self._kernel = kernel
        self.ways = (GatewayDirection(tables[0]), GatewayDirection(tables[1]))
        ears = [Listener(partial(self._on_frame, side)) for side in range(2)]
        self.controllers: list[Controller] = [
            bus.attach(ear, frozenset(table))
            for bus, ear, table in zip(buses, ears, tables, strict=True)
        ]
        #: Each direction, and how frames of it are sent.
        self._ways_out = [
            (way, partial(_send, controller))
            for way, controller in zip(self.ways, reversed(self.controllers), strict=True)
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
        now_ms = self._kernel.now_ns // NS_PER_MS
        for way, send in self._ways_out:
            way.drain(send, now_ms)
        if self.ways[0].waiting or self.ways[1].waiting:
            self._turn_soon()


def check_tables(there: Mapping[int, int], back: Mapping[int, int]) -> None:
    """Raise ValueError for tables by which a frame would come back, or two would become one."""
    for table, other in ((there, back), (back, there)):
        leaving = set(table.values())
        if len(leaving) != len(table):
            raise ValueError("two identifiers would leave as one")
        if leaving & set(other):
            raise ValueError(f"identifier 0x{min(leaving & set(other)):X} would come back")


def _send(controller: Controller, can_id: int, data: bytes) -> bool | None:
    """As a board does: None while the bus is off, and while `machine.CAN.send` takes no more."""
    if not controller.live or not controller.has_room(can_id):
        return None
    return controller.send(Frame(can_id, data))
