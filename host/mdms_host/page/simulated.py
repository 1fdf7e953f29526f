"""A simulated table as the page sees it: with its truth, its time, and faults that a person begins.

Each fault begins and ends as a scenario's would.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.page import commands
from mdms_host.page.bus_watch import BusWatch
from mdms_host.page.commands import Command, EndFault, PageRefusedError
from mdms_host.page.events import events_of
from mdms_host.page.flow import FlowCount, beside
from mdms_host.page.live import LiveTable, ParcelsByHand
from mdms_host.page.run_slot import RunSlot
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.run_rules import check_faults
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_model.scenario.tree import plain
from mdms_sim.bus.bus import Bus
from mdms_sim.faults import PRIORITY, Ongoing
from mdms_sim.serve.clock import RealTime
from mdms_sim.simulation import NS_PER_S, Simulation

#: Of these a cell has one or none.
_ONCE = ("off", "hang")


@dataclass(frozen=True, slots=True)
class _Begun:
    since_s: float
    ongoing: Ongoing
    #: Whether the simulation has begun it, for a parcel that has tipped.
    by_itself: bool = False


class FaultsByHand:
    """The faults at work, by number; `on_change` is called when one begins or ends."""

    def __init__(
        self, simulation: Simulation, scenario: Scenario, on_change: Callable[[], object]
    ) -> None:
        self._simulation = simulation
        self._scenario = scenario
        self._on_change = on_change
        self._begun: dict[int, _Begun] = {}
        self._count = 0

    def begin(self, fault: Fault) -> int:
        """Have one begin; returns its number. Raises `PageRefusedError`."""
        if fault.start_s:
            raise PageRefusedError("fault.start_s: a fault begins at once; leave it out")
        self._check(fault)
        self._check_once(fault)
        self._count += 1
        number, kernel = self._count, self._simulation.kernel
        ongoing = self._simulation.faults.begin(fault)
        if fault.kind != "push":
            self._begun[number] = _Begun(kernel.now_ns / NS_PER_S, ongoing)
            self._on_change()
        if fault.duration_s is not None:
            end_ns = kernel.now_ns + round(fault.duration_s * NS_PER_S)
            kernel.at(end_ns, PRIORITY, lambda: self._end_by_itself(number))
        return number

    def add_off_table(self) -> None:
        """List the parcels that have tipped, to be set down again."""
        off_table = self._simulation.off_table
        while off_table:
            self._count += 1
            since_s = self._simulation.kernel.now_ns / NS_PER_S
            self._begun[self._count] = _Begun(since_s, off_table.pop(0), by_itself=True)
            self._on_change()

    def end(self, command: EndFault) -> None:
        """Have one end. Raises `PageRefusedError`."""
        begun = self._begun.get(command.number)
        if begun is None:
            raise PageRefusedError(f"there is no fault {command.number}")
        pose = {"x_m": command.x_m, "y_m": command.y_m, "yaw_rad": command.yaw_rad}
        given: dict[str, Any] = {name: value for name, value in pose.items() if value is not None}
        if given:
            if begun.ongoing.fault.kind != "lift":
                raise PageRefusedError("only a parcel that was lifted is set down somewhere")
            self._check(replace(begun.ongoing.fault, duration_s=1.0, **given))
        del self._begun[command.number]
        self._simulation.faults.end(begun.ongoing, **given)
        self._on_change()

    def let_go(self) -> None:
        """Set down lifted parcels at their places before; parcels that have tipped stay off."""
        for number, begun in list(self._begun.items()):
            if begun.ongoing.fault.kind == "lift" and not begun.by_itself:
                self.end(EndFault(number))

    def message(self) -> dict[str, Any]:
        """The message `faults`."""
        faults = [
            {"number": number, "since_s": begun.since_s, "fault": _chosen(begun.ongoing.fault)}
            for number, begun in self._begun.items()
        ]
        return {"kind": "faults", "faults": faults}

    def _end_by_itself(self, number: int) -> None:
        if number in self._begun:
            self.end(EndFault(number))

    def _check(self, fault: Fault) -> None:
        try:
            check_faults(replace(self._scenario, fault=(fault,)))
        except ScenarioError as error:
            raise PageRefusedError(str(error).replace("fault.0", "fault")) from None

    def _check_once(self, fault: Fault) -> None:
        """A cell that has no power has none to lose, and a parcel in the hand is lifted already."""
        cells = range(1, self._scenario.array.columns * self._scenario.array.rows + 1)
        for begun in self._begun.values():
            other = begun.ongoing.fault
            if fault.kind == other.kind and fault.kind in _ONCE:
                again = set(fault.cells or cells) & set(other.cells or cells)
                if again:
                    raise PageRefusedError(f"cell {min(again)}: {fault.kind} already")
            if fault.kind == other.kind == "lift" and fault.parcel == other.parcel:
                raise PageRefusedError(f"{fault.parcel} is lifted already")


def _chosen(fault: Fault) -> dict[str, Any]:
    """The keys of a fault that differ from its defaults."""
    usual = plain(Fault(fault.kind))
    values = plain(fault).items()
    return {"kind": fault.kind} | {key: value for key, value in values if usual.get(key) != value}


#: The simulation is not run further than this without looking after the page.
SLICE_NS = 1_000_000


class SimulatedTable(LiveTable):
    """A live table in a simulation that passes with the machine's time."""

    offers = (
        *LiveTable.offers,
        *("fault", "end_fault", "pause", "resume", "step", "speed"),
    )

    def __init__(
        self,
        scenario: Scenario,
        layout: Layout,
        parcels: tuple[Parcel, ...],
        *,
        slot: RunSlot,
        simulation: Simulation,
        time: RealTime,
    ) -> None:
        kernel = simulation.kernel
        watch = BusWatch(layout)
        super().__init__(
            scenario,
            layout,
            parcels,
            slot=slot,
            watch=watch,
            now_s=lambda: kernel.now_ns / NS_PER_S,
        )
        self._by_hand = ParcelsByHand(lambda: time.wall_ns() / NS_PER_S)
        for number, bus in enumerate(simulation.buses):
            bus.observe(_on_bus(watch, number))
        self._scenario = scenario
        self._simulation = simulation
        self._time = time
        self._usual_speed = self._speed = time.speed
        self._pause_ns: int | None = None
        self._paused = False
        self._faults = FaultsByHand(
            simulation, scenario, lambda: self._new_messages.append(self._faults.message())
        )
        self._flow = FlowCount(self._ends)
        self._seen = {"world": 0, "faults": 0, "referee": 0}
        self._pace = _Pace(time)

    def description(self) -> dict[str, Any]:
        """See `Table`."""
        return super().description() | {"simulated": True}

    def values(self) -> dict[str, Any]:
        """See `LiveTable`."""
        world, buses = self._simulation.world, self._simulation.buses
        self._flow.count(world.events)
        believed = super().values()
        flow = self._flow.values(self._simulation.kernel.now_ns / NS_PER_S)
        return (
            believed
            | flow
            | {
                "speed": self._speed,
                "paused": [int(self._paused)],
                "real_time_factor": self._pace.factor(self._simulation.kernel.now_ns),
                "bus_counters": [_worst_counters(bus) for bus in buses],
                "wheel_slip": world.slip_m_s,
                "wheel_normal": world.normal_n,
                "parcel_true": self._true_poses(believed.get("parcel_believed")),
            }
        )

    def _true_poses(self, poses_believed: Any) -> Any:
        """Of those that are on the table, by the names under which the host has them."""
        world, parcels = self._simulation.world, self._scenario.parcel
        states, poses = world.scene.state.parcels, world.pose
        there = (states["lifted"] == 0) & (states["away"] == 0)
        known = {one.name: poses[k] for k, one in enumerate(parcels) if there[k]}
        if poses_believed is not None:
            found = zip(self._things, poses_believed, strict=True)
            believed = {name: pose for name, pose in found if np.isfinite(pose[0])}
            known = beside(believed, known, self._ends)
        unknown = np.full(3, np.nan)
        return [known.get(name, unknown) for name in self._things]

    def errors(self) -> Any:
        """How many error frames each bus has had."""
        return np.array([bus.errors for bus in self._simulation.buses], np.float64)

    def busy_s(self) -> Any:
        """How long each bus has been busy."""
        return np.array([bus.busy_ns for bus in self._simulation.buses]) / NS_PER_S

    def opening_messages(self) -> list[dict[str, Any]]:
        """See `Table`."""
        return [*super().opening_messages(), self._faults.message()]

    def take_messages(self) -> list[dict[str, Any]]:
        """See `Table`."""
        sources = {
            "world": self._simulation.world.events,
            "faults": self._simulation.faults.events,
            "referee": self._simulation.referee.events,
        }
        for name, events in sources.items():
            self.add_events(events_of(events[self._seen[name] :]))
            self._seen[name] = len(events)
        return super().take_messages()

    # Time ----------------------------------------------------------------------------------------

    def advance(self) -> None:
        """Let the simulation come up to the machine's time, by one slice at most."""
        kernel = self._simulation.kernel
        due_ns = self._time.sim_ns(kernel.now_ns)
        if due_ns > kernel.now_ns:
            kernel.run_until(min(due_ns, kernel.now_ns + SLICE_NS))
        self.look()

    def look(self) -> None:
        """Time has passed: note how late it is, and stand still where that was asked for."""
        self._faults.add_off_table()
        now_ns = self._simulation.kernel.now_ns
        if self._pause_ns is not None and now_ns >= self._pause_ns:
            self._pause()
        if not self._paused:
            self.on_cycle(max(0.0, self._time.sim_ns(now_ns) - now_ns) / NS_PER_S)

    def wait_s(self) -> float:
        """How long nothing is due [s of the machine's time]."""
        next_ns = self._simulation.kernel.next_ns
        now_ns = self._simulation.kernel.now_ns
        return 0.01 if next_ns is None else min(0.01, self._time.wait_s(next_ns, now_ns))

    def _pause(self) -> None:
        self._pause_ns, self._paused = None, True
        self._time.change_speed(0.0, self._simulation.kernel.now_ns)

    def _resume(self) -> None:
        self._pause_ns = None
        self._pass_time()

    def _step(self, step_ns: int) -> None:
        """Go on to a time; one more step while one is under way goes on behind it."""
        begun_ns = self._simulation.kernel.now_ns if self._pause_ns is None else self._pause_ns
        self._pass_time()
        self._pause_ns = begun_ns + step_ns

    def _pass_time(self) -> None:
        self._paused = False
        self._time.change_speed(self._speed, self._simulation.kernel.now_ns)

    # Commands ------------------------------------------------------------------------------------

    def do(self, command: Command) -> str | None:
        """See `Table`."""
        match command:
            case commands.Pause():
                self._pause()
            case commands.Resume():
                self._resume()
            case commands.Step():
                self._step(round(command.duration_s * NS_PER_S))
            case commands.Speed():
                self._speed = command.factor
                if not self._paused:
                    self._pass_time()
            case commands.BeginFault():
                return f"fault {self._faults.begin(command.fault)}"
            case commands.EndFault():
                self._faults.end(command)
            case _:
                return super().do(command)
        return None

    def abandon(self) -> None:
        """See `Table`: time passes as it did, and no parcel stays in a hand that is gone."""
        super().abandon()
        self._faults.let_go()
        self._speed = self._usual_speed
        self._resume()


class _Pace:
    """How fast the simulation really goes, over half a second."""

    def __init__(self, time: RealTime) -> None:
        self._time = time
        self._last = time.wall_ns(), 0
        self._factor = 1.0

    def factor(self, now_ns: int) -> float:
        """Simulated time over the machine's."""
        wall_ns = self._time.wall_ns()
        passed_ns = wall_ns - self._last[0]
        if passed_ns >= NS_PER_S // 2:
            self._factor = (now_ns - self._last[1]) / passed_ns
            self._last = wall_ns, now_ns
        return self._factor


def _worst_counters(bus: Bus) -> tuple[int, int]:
    """The highest transmit and receive error counter of any node."""
    counters = [each.errors for each in bus.controllers]
    return max(each.transmit for each in counters), max(each.receive for each in counters)


def _on_bus(watch: BusWatch, bus: int) -> Callable[..., None]:
    return lambda frame, now_ns: watch.on_frame(frame, now_ns / NS_PER_S, bus)
