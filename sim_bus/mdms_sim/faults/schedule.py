"""What goes wrong in a run, by schedule and seed: on the wire, at the nodes, in the world.

Every fault is noted as an event when it begins and when it ends. Each draws from a sequence of its
own, so that one more fault does not change what the others do.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from random import Random

import numpy as np
from numpy.typing import NDArray

from mdms_model.run.record import Event
from mdms_model.scenario.fault import Fault
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Controller
from mdms_sim.driver import Driver
from mdms_sim.faults.course import Course
from mdms_sim.faults.node import NS_PER_S, PRIORITY, NodeFaults
from mdms_sim.faults.wire import WireFaults
from mdms_sim.faults.world import WorldFaults
from mdms_sim.kernel import Kernel
from mdms_sim.nodes.bank import CellBank
from mdms_sim.physics.plane.world import World

#: Called with a fault, whether it begins (or ends), and the time [ns].
FaultObserver = Callable[[Fault, bool, int], object]


@dataclass(frozen=True, slots=True)
class Ongoing:
    """A fault that somebody has had begin, and what draws from its sequence."""

    fault: Fault
    course: Course
    random: Random


class Faults:
    """The faults of a scenario, at work on buses, the cells on them, their world and the host.

    `controllers` are the cells' in their order, `drivers` those of the participants; `places` has
    the place of each node, both from 0. `events` fills up as the run goes on.
    """

    def __init__(
        self,
        faults: Sequence[Fault],
        seed: int,
        *,
        kernel: Kernel,
        buses: Sequence[Bus],
        controllers: Sequence[Controller],
        bank: CellBank,
        world: World,
        places: NDArray[np.intp],
        drivers: Sequence[Driver],
    ) -> None:
        self.events: list[Event] = []
        self._observers: list[FaultObserver] = []
        self._kernel = kernel
        self._kinds = {
            **WireFaults(buses, controllers).kinds,
            **NodeFaults(kernel, controllers, bank, drivers).kinds,
            **WorldFaults(world, bank, places).kinds,
        }
        self._seed = seed
        self._begun = len(faults)
        for number, fault in enumerate(faults):
            self._schedule(fault, Random(f"{seed}/{number}"))

    def observe(self, observer: FaultObserver) -> None:
        """Has `observer(fault, begins, now_ns)` called when a fault begins or ends."""
        self._observers.append(observer)

    def begin(self, fault: Fault) -> Ongoing:
        """Have a fault begin now, whatever its times say; `end` ends it.

        The fault must be one that the scenario could have (see `check_faults`).
        """
        random = Random(f"{self._seed}/{self._begun}")
        self._begun += 1
        ongoing = Ongoing(fault, self._kinds[fault.kind](fault, random), random)
        self._note(fault, "begins", ongoing.course.begin())
        return ongoing

    def end(self, ongoing: Ongoing, **values: float | None) -> None:
        """Have it end now, once; `values` take the place of the fault's own where it ends.

        So a parcel is set down where it was not known yet when it was lifted.
        """
        fault, course = ongoing.fault, ongoing.course
        if values:
            fault = replace(fault, **values)  # type: ignore[arg-type]
            course = self._kinds[fault.kind](fault, ongoing.random)
        self._note(fault, "ends", course.end())

    def _schedule(self, fault: Fault, random: Random) -> None:
        course = self._kinds[fault.kind](fault, random)
        start_ns = round(fault.start_s * NS_PER_S)
        self._kernel.at(start_ns, PRIORITY, lambda: self._note(fault, "begins", course.begin()))
        if fault.duration_s is not None:
            end_ns = start_ns + round(fault.duration_s * NS_PER_S)
            self._kernel.at(end_ns, PRIORITY, lambda: self._note(fault, "ends", course.end()))

    def _note(self, fault: Fault, what: str, detail: str | None) -> None:
        for observer in self._observers:
            observer(fault, what == "begins", self._kernel.now_ns)
        time_s = self._kernel.now_ns / NS_PER_S
        text = f"{fault.kind} {what}" + (f": {detail}" if detail else "")
        for cell in fault.cells or [None]:
            parcel = fault.parcel or None
            self.events.append(Event(time_s, "fault", text, parcel=parcel, cell=cell))
