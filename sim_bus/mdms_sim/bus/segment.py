"""One piece of wire: its nodes, and the fate of a frame when somebody comes or goes."""

from collections.abc import Collection
from typing import TYPE_CHECKING

from mdms_sim.bus.controller import BusOffRecovery, Controller, ErrorState
from mdms_sim.bus.traffic import PRIORITY_END, States, WireTraffic
from mdms_sim.kernel import Action

if TYPE_CHECKING:
    from mdms_sim.bus.bus import Bus


class Segment:
    """Controllers that receive each other.

    `request(controller, frame)`: a frame stands in a mailbox and wants the bus.
    """

    def __init__(self, bus: "Bus") -> None:
        self.controllers: list[Controller] = []
        self.bus = bus
        self._kernel = bus.kernel
        self._recovery = BusOffRecovery(bus.kernel, bus.bit_ns, self._recovered)
        self._traffic = WireTraffic(bus, self.controllers, self._recovery, self._tell_states)
        self.request = self._traffic.request

    def add(self, controller: Controller) -> None:
        """Puts a controller on this wire; it receives what begins from now on."""
        self._go_on_without(())
        self._take_in(controller)

    def remove(self, controllers: Collection[Controller]) -> None:
        """Takes them off at once; frames that they are sending end there."""
        self.silence(controllers)
        for controller in controllers:
            self.controllers.remove(controller)
        self.reconsider()

    def silence(self, controllers: Collection[Controller]) -> None:
        """They drive nothing more, do not receive the present frame, and want to send nothing."""
        self._go_on_without(controllers)
        for controller in controllers:
            self._traffic.requests.drop(controller)
            self._recovery.drop(controller)

    def move(self, controllers: Collection[Controller], other: "Segment") -> None:
        """Puts them on another wire, each in the midst of its frame.

        A node on its way back from bus off begins to count anew there.
        """
        recovering = [each for each in controllers if each in self._recovery]
        busy = self._traffic.busy or other._traffic.busy
        if busy:
            there = other._traffic.progress(lambda each: True)
            there += self._traffic.progress(lambda each: each in controllers)
        self.remove(controllers)
        other._traffic.free_ns = max(other._traffic.free_ns, self._traffic.free_ns)
        if busy:
            other._traffic.resume(there)
        for controller in controllers:
            other._take_in(controller)
        for controller in recovering:
            other.recover(controller)

    def _take_in(self, controller: Controller) -> None:
        controller.segment = self
        self.controllers.append(controller)
        if controller.live:
            controller.request_again()
        self.reconsider()

    def _go_on_without(self, controllers: Collection[Controller]) -> None:
        traffic = self._traffic
        if traffic.busy:
            traffic.resume(traffic.progress(lambda each: each not in controllers))

    def reconsider(self) -> None:
        """Works out anew who receives what and whether all is well; either may have changed."""
        self._traffic.receivers.clear()
        listening = sum(1 for each in self.controllers if each.live)
        self._traffic.calm = (
            listening > 1
            and self.bus.disturbance is None
            and all(each.errors.clean for each in self.controllers)
        )

    def later(self, delay_ns: int, action: Action) -> None:
        """Has `action` called after a time."""
        self._kernel.at(self._kernel.now_ns + delay_ns, PRIORITY_END, action)

    def _tell_states(self, before: States) -> None:
        for node, state in before:
            if node.state is not state:
                if node.state is ErrorState.BUS_OFF:
                    self.silence((node,))
                    node.live = False
                self.bus.on_state(node)
        self.reconsider()

    # Coming back from bus off

    def recover(self, controller: Controller) -> None:
        """Lets a node that is bus off come back."""
        self._recovery.start(controller, max(self._kernel.now_ns, self._traffic.free_ns))

    def _recovered(self, controller: Controller) -> None:
        controller.errors.reset()
        self._go_on_without(())
        controller.live = True
        self.bus.on_state(controller)
        controller.request_again()
        self.reconsider()
