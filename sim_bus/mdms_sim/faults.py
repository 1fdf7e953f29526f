"""The faults of a run, by schedule and seed: on the wire, at the nodes, in the world.

Every fault is noted as an event when it begins and when it ends. Each draws from a sequence of its
own, so that one more fault does not change the others.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from random import Random
from typing import NamedTuple

import numpy as np

from mdms_model.run.record import Event
from mdms_model.scenario.fault import Fault
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Controller
from mdms_sim.bus.exchange import Disturbance
from mdms_sim.bus.segment import Segment
from mdms_sim.bus.wire import INTERFRAME_BITS, frame_bits
from mdms_sim.driver import ParticipantDriver
from mdms_sim.kernel import Kernel
from mdms_sim.nodes.bank import CellBank
from mdms_sim.physics.plane.control_step import UV_PER_V
from mdms_sim.physics.plane.handling import lift, push, set_down
from mdms_sim.physics.plane.world import World


class FaultEffect(NamedTuple):
    """The actions when a fault begins and when it ends; each may return a word on it."""

    begin: Callable[[], str | None]
    end: Callable[[], str | None]


#: Sets up one fault of a kind; its numbers are drawn from the sequence given.
FaultSetup = Callable[[Fault, Random], FaultEffect]


def cells_with(fault: Fault, cells: int) -> Sequence[int]:
    """The cells that have it, from 0, of so many."""
    return [cell - 1 for cell in fault.cells] or range(cells)


def last_counts(
    fault: Fault,
    at_work: list[Fault],
    cells_of: Callable[[Fault], Sequence[int]],
    put: Callable[[int, Fault | None], None],
) -> FaultEffect:
    """A fault of which the one that began last counts, of those `at_work` on a cell.

    `put(cell, last)` has a cell follow that one, None where there is none.
    """

    def follow() -> None:
        for cell in cells_of(fault):
            put(cell, next((each for each in reversed(at_work) if cell in cells_of(each)), None))

    def begin() -> None:
        at_work.append(fault)
        follow()

    def end() -> None:
        at_work.remove(fault)
        follow()

    return FaultEffect(begin, end)


#: A wrong bit may be any of a frame and the first two after it, where nobody sends yet.
BITS_AFTER = INTERFRAME_BITS - 1

#: The effect of a fault on a frame.
Effect = Callable[[Frame], Disturbance]


class FrameFault:
    """A fault that strikes the frames of some senders (None: all); `count` says how many."""

    def __init__(
        self,
        senders: Sequence[Controller] | None,
        probability: float,
        random: Random,
        effect: Effect,
    ) -> None:
        self.count = 0
        self._senders = senders
        self._probability = probability
        self._random = random
        self._effect = effect

    def on(self, sender: Controller, frame: Frame) -> Disturbance | None:
        """The fate of this frame, None for a normal one."""
        if self._senders is not None and sender not in self._senders:
            return None
        if self._random.random() >= self._probability:
            return None
        self.count += 1
        return self._effect(frame)


class FrameFaults:
    """The faults at work on a bus; the first that strikes a frame has it for itself."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._at_work: list[FrameFault] = []

    def begin(self, fault: FrameFault) -> None:
        """One more."""
        self._at_work.append(fault)
        self._bus.disturb(self._disturb)

    def end(self, fault: FrameFault) -> None:
        """One less."""
        self._at_work.remove(fault)
        self._bus.disturb(self._disturb if self._at_work else None)

    def _disturb(self, sender: Controller, frame: Frame) -> Disturbance | None:
        for fault in self._at_work:
            disturbance = fault.on(sender, frame)
            if disturbance is not None:
                return disturbance
        return None


def losing(buses: Sequence[Bus], victims: Sequence[Controller] | None) -> Effect:
    """Frames do not reach the victims (None: anybody), though all was well on the wire."""

    def lose(frame: Frame) -> Disturbance:
        everybody = [each for bus in buses for each in bus.controllers]
        return Disturbance(lost_by=everybody if victims is None else victims)

    return lose


def corrupting(random: Random, victims: Sequence[Controller] | None) -> Effect:
    """The victims (None: everybody) see one bit the wrong way round."""

    def corrupt(frame: Frame) -> Disturbance:
        return Disturbance(random.randrange(frame_bits(frame) + BITS_AFTER), victims)

    return corrupt


def overloading(nodes: Sequence[Controller], count: int) -> Effect:
    """The nodes hold up what follows a frame by so many overload frames each."""
    disturbance = Disturbance(overloads=dict.fromkeys(nodes, count))
    return lambda frame: disturbance


class WireFaults:
    """Faults of the wires between the controllers of cells, in their order; `kinds` by name."""

    def __init__(self, buses: Sequence[Bus], controllers: Sequence[Controller]) -> None:
        self._buses = buses
        self._controllers = controllers
        self._at_work = [FrameFaults(bus) for bus in buses]
        self.kinds: dict[str, FaultSetup] = {
            "loss": self._loss,
            "corruption": self._corruption,
            "overload": self._overload,
            "cut": self._cut,
        }

    def _nodes(self, cells: Sequence[int]) -> list[Controller] | None:
        """The controllers of cells numbered from 1; None, which is everybody, for no cells."""
        return [self._controllers[cell - 1] for cell in cells] or None

    def _any_on(self, bus: Bus, cells: Sequence[int]) -> bool:
        """Whether any of the cells, numbered from 1, is on a bus; no cells stand for everybody."""
        return not cells or any(self._controllers[cell - 1].segment.bus is bus for cell in cells)

    def _group(self, fault: Fault) -> list[Controller]:
        """The controllers of the cells that have it."""
        return [self._controllers[cell] for cell in cells_with(fault, len(self._controllers))]

    def _loss(self, fault: Fault, random: Random) -> FaultEffect:
        return self._striking(fault, random, losing(self._buses, self._nodes(fault.seen_by)))

    def _corruption(self, fault: Fault, random: Random) -> FaultEffect:
        return self._striking(fault, random, corrupting(random, self._nodes(fault.seen_by)))

    def _striking(self, fault: Fault, random: Random, effect: Effect) -> FaultEffect:
        senders = self._nodes(fault.cells)
        return self._on_frames(fault, FrameFault(senders, fault.probability, random, effect))

    def _overload(self, fault: Fault, random: Random) -> FaultEffect:
        effect = overloading(self._group(fault), fault.overload_frames)
        return self._on_frames(fault, FrameFault(None, fault.probability, random, effect))

    def _on_frames(self, fault: Fault, frame_fault: FrameFault) -> FaultEffect:
        struck = [
            at_work
            for number, (bus, at_work) in enumerate(zip(self._buses, self._at_work, strict=True))
            if fault.bus in (None, number)
            and self._any_on(bus, fault.cells)
            and self._any_on(bus, fault.seen_by)
        ]

        def begin() -> None:
            for at_work in struck:
                at_work.begin(frame_fault)

        def end() -> str:
            for at_work in struck:
                at_work.end(frame_fault)
            return f"{frame_fault.count} frames"

        return FaultEffect(begin, end)

    def _cut(self, fault: Fault, random: Random) -> FaultEffect:
        group = self._group(fault)
        pieces: list[Segment] = []

        def begin() -> None:
            for bus in self._buses:
                members = [each for each in group if each.segment.bus is bus]
                if members:
                    pieces.append(bus.cut(members))

        def end() -> None:
            while pieces:
                piece = pieces.pop()
                piece.bus.heal(piece)

        return FaultEffect(begin, end)


NS_PER_S = 1_000_000_000
#: Before the cells tick at that instant.
PRIORITY = 5


class NodeFaults:
    """Faults of the cells of a bank, with their controllers, and of the host; `kinds` by name.

    `drivers` are those of the participants, which are the host. A cell without power starts when
    the last fault that took it has ended. Then it hangs no more. Of two delays or drifts of a cell
    the one that began last counts.
    """

    def __init__(
        self,
        kernel: Kernel,
        controllers: Sequence[Controller],
        bank: CellBank,
        drivers: Sequence[ParticipantDriver],
    ) -> None:
        self._kernel = kernel
        self._controllers = controllers
        self._bank = bank
        self._drivers = drivers
        #: How many faults at work take the power of each cell, and the cells that hang.
        self._off = [0] * len(controllers)
        self._hung: set[int] = set()
        self._delays: list[Fault] = []
        self._drifts: list[Fault] = []
        self.kinds: dict[str, FaultSetup] = {
            "delay": self._delay,
            "babble": self._babble,
            "off": self._power_off,
            "hang": self._hang,
            "drift": self._drift,
            "host": self._host,
        }

    def _cells(self, fault: Fault) -> Sequence[int]:
        return cells_with(fault, len(self._controllers))

    def _bus_of(self, cell: int) -> Bus:
        return self._controllers[cell].segment.bus

    def _delay(self, fault: Fault, random: Random) -> FaultEffect:
        def set_delay(cell: int, last: Fault | None) -> None:
            delay_s = last.delay_s if last else 0.0
            self._controllers[cell].delay_ns = round(delay_s * NS_PER_S)

        return last_counts(fault, self._delays, self._cells, set_delay)

    def _babble(self, fault: Fault, random: Random) -> FaultEffect:
        babblers = [
            _Babbler(self._kernel, self._bus_of(cell), fault) for cell in self._cells(fault)
        ]

        def begin() -> None:
            for babbler in babblers:
                babbler.begin()

        def end() -> str:
            return f"{sum(babbler.end() for babbler in babblers)} frames"

        return FaultEffect(begin, end)

    def _power_off(self, fault: Fault, random: Random) -> FaultEffect:
        def begin() -> None:
            for cell in self._cells(fault):
                self._off[cell] += 1
                self._hung.discard(cell)
                self._bus_of(cell).switch_off(self._controllers[cell])
                self._bank.power_off(cell)

        def end() -> str | None:
            for cell in self._cells(fault):
                self._off[cell] -= 1
                if not self._off[cell]:
                    self._restart(cell, fault.node_id)
            return f"it is now node {fault.node_id}" if fault.node_id is not None else None

        return FaultEffect(begin, end)

    def _hang(self, fault: Fault, random: Random) -> FaultEffect:
        def begin() -> None:
            for cell in self._cells(fault):
                if not self._off[cell]:
                    self._hung.add(cell)
                    self._controllers[cell].hold()
                    self._bank.hang(cell)

        def end() -> str:
            overruns = 0
            for cell in self._cells(fault):
                if cell in self._hung:
                    self._hung.remove(cell)
                    overruns += self._controllers[cell].overruns
                    self._bus_of(cell).switch_off(self._controllers[cell])
                    self._restart(cell)
            return f"watchdog reset, {overruns} frames overrun"

        return FaultEffect(begin, end)

    def _restart(self, cell: int, node_id: int | None = None) -> None:
        self._bank.restart(cell, node_id)
        self._bus_of(cell).switch_on(self._controllers[cell])

    def _drift(self, fault: Fault, random: Random) -> FaultEffect:
        def set_drift(cell: int, last: Fault | None) -> None:
            self._bank.set_drift(cell, last.drift_ppm if last else 0)

        return last_counts(fault, self._drifts, self._cells, set_drift)

    def _host(self, fault: Fault, random: Random) -> FaultEffect:
        def begin() -> str | None:
            for driver in self._drivers:
                driver.leave(fault.bus)
            return None if self._drivers else "there is none"

        def end() -> None:
            for driver in self._drivers:
                driver.rejoin(fault.bus)

        return FaultEffect(begin, end)


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


#: The state of a wheel that counts the faults of a kind.
_OF_WHEELS = {
    "encoder_stuck": "encoder_stuck",
    "wheel_jammed": "jammed",
    "motor_reversed": "reversed",
}


class Places:
    """The place of each node, `of_node`, and the node at each place, `node_at`, all from 0.

    The table tells each node of the bank the node id that belongs to its place, of `node_ids` by
    place, or nothing (0).
    """

    def __init__(self, bank: CellBank, node_ids: Sequence[int]) -> None:
        self.of_node = np.arange(len(node_ids))
        self.node_at = np.arange(len(node_ids))
        self._bank = bank
        self._node_ids = node_ids
        for node in range(len(node_ids)):
            self._tell(node)

    def exchange(self, one: int, other: int) -> None:
        """Two nodes change places."""
        pair = [one, other]
        self.of_node[pair] = self.of_node[pair[::-1]]
        self.node_at[self.of_node[pair]] = pair
        for node in pair:
            self._tell(node)

    def _tell(self, node: int) -> None:
        self._bank.set_place(node, self._node_ids[self.of_node[node]])


class WorldFaults:
    """Faults of a world, and of what its cells measure of it; `kinds` by name.

    Where two faults of bridges, wheels, sensors or parcels overlap, the last to end sets things
    right; of two of the supply the one that began last counts.
    """

    def __init__(self, world: World, bank: CellBank, places: Places) -> None:
        self._world = world
        self._bank = bank
        self._places = places
        self._bridges = world.bridges
        self._nominal_supply_v = world.bridges.supply_v.copy()
        self._supplies: list[Fault] = []
        self.kinds: dict[str, FaultSetup] = {
            "supply": self._supply,
            "bridge_fault": self._bridge_fault,
            "sensor_stuck": self._sensor_stuck,
            **dict.fromkeys(_OF_WHEELS, self._wheel_fault),
            "push": self._push,
            "lift": self._lift,
            "wrong_place": self._wrong_place,
        }

    def _cells(self, fault: Fault) -> Sequence[int]:
        return cells_with(fault, len(self._nominal_supply_v))

    def _supply(self, fault: Fault, random: Random) -> FaultEffect:
        def supply(cell: int, last: Fault | None) -> None:
            supply_v = last.supply_v if last else self._nominal_supply_v[cell]
            self._bridges.supply_v[cell] = supply_v
            self._bridges.shorted[cell] = last is not None and last.brake
            self._bank.set_supply(cell, round(supply_v * UV_PER_V))

        begin, end = last_counts(fault, self._supplies, self._cells, supply)

        def begin_and_say() -> str | None:
            begin()
            return "the motors are shorted" if fault.brake else None

        return FaultEffect(begin_and_say, end)

    def _bridge_fault(self, fault: Fault, random: Random) -> FaultEffect:
        def shut_off(more: int) -> None:
            for cell in self._cells(fault):
                self._bridges.shut_off[cell] += more

        return FaultEffect(partial(shut_off, 1), partial(shut_off, -1))

    def _sensor_stuck(self, fault: Fault, random: Random) -> FaultEffect:
        stuck = self._world.stuck_sensors[int(fault.covered)]
        sensors = list(fault.sensors or range(stuck.shape[1]))

        def hold(more: int) -> None:
            for cell in self._cells(fault):
                stuck[cell, sensors] += more

        def begin() -> str:
            hold(1)
            return f"{_listed('sensor', sensors)} {'covered' if fault.covered else 'free'}"

        return FaultEffect(begin, partial(hold, -1))

    def _wheel_fault(self, fault: Fault, random: Random) -> FaultEffect:
        counts = self._world.scene.state.wheels[_OF_WHEELS[fault.kind]]

        def count(more: int) -> None:
            for wheel in self._wheels(fault):
                counts[wheel] += more

        def begin() -> str | None:
            count(1)
            return _listed("axis", fault.axes) if fault.axes else None

        return FaultEffect(begin, partial(count, -1))

    def _wheels(self, fault: Fault) -> Iterator[int]:
        """The wheels of its axes, none named: all of a cell's."""
        first = self._world.wheels.first
        for cell in self._cells(fault):
            for axis in fault.axes or range(1, first[cell + 1] - first[cell] + 1):
                yield first[cell] + axis - 1

    def _push(self, fault: Fault, random: Random) -> FaultEffect:
        scene, parcel = self._world.scene, self._parcel(fault)

        def begin() -> str:
            if not push(scene, parcel, fault.impulse_n_s, fault.twist_nms):
                return "it is lifted, and not pushed"
            x_n_s, y_n_s = fault.impulse_n_s
            return f"{x_n_s:g}, {y_n_s:g} N s and {fault.twist_nms:g} N m s"

        return FaultEffect(begin, lambda: None)

    def _lift(self, fault: Fault, random: Random) -> FaultEffect:
        scene, parcel = self._world.scene, self._parcel(fault)

        def begin() -> None:
            lift(scene, parcel)

        def end() -> str:
            if not set_down(scene, parcel, fault.x_m, fault.y_m, fault.yaw_rad):
                return "it is still held"
            x_m, y_m, yaw_rad = self._world.pose[parcel]
            return f"set down at x {x_m:.4f} m, y {y_m:.4f} m, yaw {yaw_rad:.4f} rad"

        return FaultEffect(begin, end)

    def _wrong_place(self, fault: Fault, random: Random) -> FaultEffect:
        assert fault.as_cell is not None
        one, other = fault.cells[0] - 1, fault.as_cell - 1

        def exchange() -> str:
            self._places.exchange(one, other)
            return f"it and cell {fault.as_cell} have changed places"

        return FaultEffect(exchange, exchange)

    def _parcel(self, fault: Fault) -> int:
        return [parcel.name for parcel in self._world.scenario.parcel].index(fault.parcel)


def _listed(noun: str, numbers: Sequence[int]) -> str:
    return f"{noun} {', '.join(map(str, numbers))}"


#: Called with a fault, whether it begins (or ends), and the time [ns].
FaultObserver = Callable[[Fault, bool, int], object]


@dataclass(frozen=True, slots=True)
class Ongoing:
    """A fault that somebody has had begin, and what draws from its sequence."""

    fault: Fault
    effect: FaultEffect
    random: Random


class Faults:
    """The faults of a scenario at work; `kinds` has what sets one up, by the name of its kind.

    `events` fills up as the run goes on.
    """

    def __init__(
        self, faults: Sequence[Fault], seed: int, kernel: Kernel, kinds: Mapping[str, FaultSetup]
    ) -> None:
        self.events: list[Event] = []
        self._observers: list[FaultObserver] = []
        self._kernel = kernel
        self._kinds = kinds
        self._seed = seed
        self._begun = len(faults)
        for number, fault in enumerate(faults):
            self._schedule(fault, Random(f"{seed}/{number}"))

    def observe(self, observer: FaultObserver) -> None:
        """Has `observer(fault, begins, now_ns)` called when a fault begins or ends."""
        self._observers.append(observer)

    def begin(self, fault: Fault) -> Ongoing:
        """Have a fault begin now, whatever its times say; `end` ends it.

        The fault must be possible in the scenario (see `check_faults`).
        """
        random = Random(f"{self._seed}/{self._begun}")
        self._begun += 1
        ongoing = Ongoing(fault, self._kinds[fault.kind](fault, random), random)
        self._note(fault, "begins", ongoing.effect.begin())
        return ongoing

    def end(self, ongoing: Ongoing, **values: float | None) -> None:
        """Have it end now, once; `values` take the place of the fault's own where it ends.

        So a parcel is set down where it was not known yet when it was lifted.
        """
        fault, effect = ongoing.fault, ongoing.effect
        if values:
            fault = replace(fault, **values)  # type: ignore[arg-type]
            effect = self._kinds[fault.kind](fault, ongoing.random)
        self._note(fault, "ends", effect.end())

    def _schedule(self, fault: Fault, random: Random) -> None:
        effect = self._kinds[fault.kind](fault, random)
        start_ns = round(fault.start_s * NS_PER_S)
        self._kernel.at(start_ns, PRIORITY, lambda: self._note(fault, "begins", effect.begin()))
        if fault.duration_s is not None:
            end_ns = start_ns + round(fault.duration_s * NS_PER_S)
            self._kernel.at(end_ns, PRIORITY, lambda: self._note(fault, "ends", effect.end()))

    def _note(self, fault: Fault, what: str, detail: str | None) -> None:
        for observer in self._observers:
            observer(fault, what == "begins", self._kernel.now_ns)
        time_s = self._kernel.now_ns / NS_PER_S
        text = f"{fault.kind} {what}" + (f": {detail}" if detail else "")
        for cell in fault.cells or [None]:
            parcel = fault.parcel or None
            self.events.append(Event(time_s, "fault", text, parcel=parcel, cell=cell))
