"""What goes wrong in a run, by schedule and seed: on the wire, at the nodes, in their clocks.

Every fault is noted as an event when it begins and when it ends. Each draws from a sequence of its
own, so that one more fault does not change what the others do.
"""

from collections.abc import Callable, Sequence
from functools import partial
from random import Random

from mdms_model.run.record import Event
from mdms_model.scenario.scenario import Fault
from mdms_protocol.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Controller
from mdms_sim.faults.wire import Effect, FrameFault, WireFaults, corrupting, losing, overloading
from mdms_sim.kernel import Kernel
from mdms_sim.nodes.bank import CellBank
from mdms_sim.physics.plane.control_step import UV_PER_V
from mdms_sim.physics.plane.world import World

NS_PER_S = 1_000_000_000
#: Before the cells tick at that instant.
PRIORITY = 5


class Faults:
    """The faults of a scenario, at work on a bus and the cells on it.

    `controllers` are the cells' in their order; `events` fills up as the run goes on.
    """

    def __init__(
        self,
        faults: Sequence[Fault],
        seed: int,
        *,
        kernel: Kernel,
        bus: Bus,
        controllers: Sequence[Controller],
        bank: CellBank,
        world: World,
    ) -> None:
        self.events: list[Event] = []
        self._kernel = kernel
        self._bus = bus
        self._controllers = controllers
        self._bank = bank
        self._bridges = world.bridges
        self._nominal_supply_v = world.bridges.supply_v.copy()
        self._wire = WireFaults(bus)
        for number, fault in enumerate(faults):
            self._schedule(fault, Random(f"{seed}/{number}"))

    def _schedule(self, fault: Fault, random: Random) -> None:
        begin, end = getattr(self, f"_{fault.kind}")(fault, random)
        start_ns = round(fault.start_s * NS_PER_S)
        self._kernel.at(start_ns, PRIORITY, lambda: self._tell(fault, "begins", begin()))
        if fault.duration_s is not None:
            end_ns = start_ns + round(fault.duration_s * NS_PER_S)
            self._kernel.at(end_ns, PRIORITY, lambda: self._tell(fault, "ends", end()))

    def _tell(self, fault: Fault, what: str, detail: str | None) -> None:
        time_s = self._kernel.now_ns / NS_PER_S
        text = f"{fault.kind} {what}" + (f": {detail}" if detail else "")
        for cell in fault.cells or [None]:
            self.events.append(Event(time_s, "fault", text, cell=cell))

    def _cells(self, fault: Fault) -> Sequence[int]:
        """The cells that have it, from 0."""
        return [cell - 1 for cell in fault.cells] or range(len(self._controllers))

    def _nodes(self, cells: Sequence[int]) -> list[Controller] | None:
        """The controllers of cells numbered from 1; None, which is everybody, for no cells."""
        return [self._controllers[cell - 1] for cell in cells] or None

    # On the wire

    def _loss(self, fault: Fault, random: Random) -> "_Ways":
        return self._striking(fault, random, losing(self._bus, self._nodes(fault.seen_by)))

    def _corruption(self, fault: Fault, random: Random) -> "_Ways":
        return self._striking(fault, random, corrupting(random, self._nodes(fault.seen_by)))

    def _striking(self, fault: Fault, random: Random, effect: Effect) -> "_Ways":
        return self._on_frames(
            FrameFault(self._nodes(fault.cells), fault.probability, random, effect)
        )

    def _overload(self, fault: Fault, random: Random) -> "_Ways":
        busy = [self._controllers[cell] for cell in self._cells(fault)]
        effect = overloading(busy, fault.overload_frames)
        return self._on_frames(FrameFault(None, fault.probability, random, effect))

    def _on_frames(self, frame_fault: FrameFault) -> "_Ways":
        def begin() -> None:
            self._wire.begin(frame_fault)

        def end() -> str:
            self._wire.end(frame_fault)
            return f"{frame_fault.count} frames"

        return begin, end

    def _cut(self, fault: Fault, random: Random) -> "_Ways":
        group = [self._controllers[cell] for cell in self._cells(fault)]
        pieces = []

        def begin() -> None:
            pieces.append(self._bus.cut(group))

        def end() -> None:
            self._bus.heal(pieces.pop())

        return begin, end

    # At the nodes

    def _delay(self, fault: Fault, random: Random) -> "_Ways":
        def set_delay(delay_s: float) -> None:
            for cell in self._cells(fault):
                self._controllers[cell].delay_ns = round(delay_s * NS_PER_S)

        return partial(set_delay, fault.delay_s), partial(set_delay, 0.0)

    def _babble(self, fault: Fault, random: Random) -> "_Ways":
        babblers = [_Babbler(self._kernel, self._bus, fault) for _ in self._cells(fault)]

        def begin() -> None:
            for babbler in babblers:
                babbler.begin()

        def end() -> str:
            return f"{sum(babbler.end() for babbler in babblers)} frames"

        return begin, end

    def _off(self, fault: Fault, random: Random) -> "_Ways":
        def begin() -> None:
            for cell in self._cells(fault):
                self._bus.switch_off(self._controllers[cell])
                self._bank.power_off(cell)

        def end() -> str | None:
            for cell in self._cells(fault):
                self._bank.restart(cell, fault.node_id)
                self._bus.switch_on(self._controllers[cell])
            return f"it is now node {fault.node_id}" if fault.node_id is not None else None

        return begin, end

    def _hang(self, fault: Fault, random: Random) -> "_Ways":
        def begin() -> None:
            for cell in self._cells(fault):
                self._controllers[cell].hold()
                self._bank.hang(cell)

        def end() -> str:
            overruns = 0
            for cell in self._cells(fault):
                overruns += self._controllers[cell].overruns
                self._bus.switch_off(self._controllers[cell])
                self._bank.restart(cell)
                self._bus.switch_on(self._controllers[cell])
            return f"watchdog reset, {overruns} frames overrun"

        return begin, end

    def _supply(self, fault: Fault, random: Random) -> "_Ways":
        def set_supply(cell: int, supply_v: float) -> None:
            self._bridges.supply_v[cell] = supply_v
            self._bank.set_supply(cell, round(supply_v * UV_PER_V))

        def begin() -> None:
            for cell in self._cells(fault):
                set_supply(cell, fault.supply_v)

        def end() -> None:
            for cell in self._cells(fault):
                set_supply(cell, self._nominal_supply_v[cell])

        return begin, end

    def _bridge_fault(self, fault: Fault, random: Random) -> "_Ways":
        def shut_off(value: int) -> None:
            for cell in self._cells(fault):
                self._bridges.shut_off[cell] = value

        return partial(shut_off, 1), partial(shut_off, 0)

    def _drift(self, fault: Fault, random: Random) -> "_Ways":
        def set_drift(drift_ppm: int) -> None:
            for cell in self._cells(fault):
                self._bank.set_drift(cell, drift_ppm)

        return partial(set_drift, fault.drift_ppm), partial(set_drift, 0)


_Ways = tuple[Callable[[], str | None], Callable[[], str | None]]


class _Babbler:
    """A node that sends the same frame over and over."""

    def __init__(self, kernel: Kernel, bus: Bus, fault: Fault) -> None:
        self._kernel = kernel
        self._bus = bus
        self._frame = Frame(fault.can_id, bytes(8))
        self._period_ns = round(fault.period_s * NS_PER_S)
        self._controller: Controller | None = None

    def begin(self) -> None:
        """Join the bus and babble."""
        self._controller = self._bus.attach(self, ())
        self._babble()

    def end(self) -> int:
        """Leave the bus; returns how many frames it has sent."""
        controller, self._controller = self._controller, None
        if controller is None:
            return 0
        self._bus.detach(controller)
        return controller.sent

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """Receives nothing."""

    def _babble(self) -> None:
        if self._controller is not None:
            # Always one more than the bus is busy with, so that it never rests.
            if self._controller.pending < 2:
                self._controller.send(self._frame)
            self._kernel.at(self._kernel.now_ns + self._period_ns, PRIORITY, self._babble)
