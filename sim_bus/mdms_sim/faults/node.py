"""What goes wrong at the nodes: cells that are late, babble, hang or lose power; the host gone."""

from collections.abc import Mapping, Sequence
from functools import partial
from random import Random

from mdms_model.scenario.fault import Fault
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Controller
from mdms_sim.driver import Driver
from mdms_sim.faults.course import Course, Kind, cells_with
from mdms_sim.kernel import Kernel
from mdms_sim.nodes.bank import CellBank

NS_PER_S = 1_000_000_000
#: Before the cells tick at that instant.
PRIORITY = 5


class NodeFaults:
    """Faults of the cells of a bank, with their controllers, and of the host; `kinds` by name.

    `drivers` are those of the participants, which are the host.
    """

    def __init__(
        self,
        kernel: Kernel,
        controllers: Sequence[Controller],
        bank: CellBank,
        drivers: Sequence[Driver],
    ) -> None:
        self._kernel = kernel
        self._controllers = controllers
        self._bank = bank
        self._drivers = drivers
        self.kinds: Mapping[str, Kind] = {
            "delay": self._delay,
            "babble": self._babble,
            "off": self._off,
            "hang": self._hang,
            "drift": self._drift,
            "host": self._host,
        }

    def _cells(self, fault: Fault) -> Sequence[int]:
        return cells_with(fault, len(self._controllers))

    def _bus_of(self, cell: int) -> Bus:
        return self._controllers[cell].segment.bus

    def _delay(self, fault: Fault, random: Random) -> Course:
        def set_delay(delay_s: float) -> None:
            for cell in self._cells(fault):
                self._controllers[cell].delay_ns = round(delay_s * NS_PER_S)

        return Course(partial(set_delay, fault.delay_s), partial(set_delay, 0.0))

    def _babble(self, fault: Fault, random: Random) -> Course:
        babblers = [
            _Babbler(self._kernel, self._bus_of(cell), fault) for cell in self._cells(fault)
        ]

        def begin() -> None:
            for babbler in babblers:
                babbler.begin()

        def end() -> str:
            return f"{sum(babbler.end() for babbler in babblers)} frames"

        return Course(begin, end)

    def _off(self, fault: Fault, random: Random) -> Course:
        def begin() -> None:
            for cell in self._cells(fault):
                self._bus_of(cell).switch_off(self._controllers[cell])
                self._bank.power_off(cell)

        def end() -> str | None:
            for cell in self._cells(fault):
                self._bank.restart(cell, fault.node_id)
                self._bus_of(cell).switch_on(self._controllers[cell])
            return f"it is now node {fault.node_id}" if fault.node_id is not None else None

        return Course(begin, end)

    def _hang(self, fault: Fault, random: Random) -> Course:
        def begin() -> None:
            for cell in self._cells(fault):
                self._controllers[cell].hold()
                self._bank.hang(cell)

        def end() -> str:
            overruns = 0
            for cell in self._cells(fault):
                overruns += self._controllers[cell].overruns
                self._bus_of(cell).switch_off(self._controllers[cell])
                self._bank.restart(cell)
                self._bus_of(cell).switch_on(self._controllers[cell])
            return f"watchdog reset, {overruns} frames overrun"

        return Course(begin, end)

    def _drift(self, fault: Fault, random: Random) -> Course:
        def set_drift(drift_ppm: int) -> None:
            for cell in self._cells(fault):
                self._bank.set_drift(cell, drift_ppm)

        return Course(partial(set_drift, fault.drift_ppm), partial(set_drift, 0))

    def _host(self, fault: Fault, random: Random) -> Course:
        def begin() -> str | None:
            for driver in self._drivers:
                driver.leave(fault.bus)
            return None if self._drivers else "there is none"

        def end() -> None:
            for driver in self._drivers:
                driver.rejoin(fault.bus)

        return Course(begin, end)


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
