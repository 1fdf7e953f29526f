"""A simulated table as the page sees it: with its truth, its faults, and its time."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.page import commands
from mdms_host.page.bus_watch import BusWatch
from mdms_host.page.commands import Command, RefusedError
from mdms_host.page.live import LiveTable
from mdms_host.page.seat import Seat
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.fault_rules import check_faults
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_model.scenario.tree import plain
from mdms_sim.bus.bus import Bus
from mdms_sim.faults.node import PRIORITY
from mdms_sim.faults.schedule import Ongoing
from mdms_sim.serve.clock import RealTime
from mdms_sim.simulation import NS_PER_S, Simulation

#: The simulation is not run further than this without looking after the page.
SLICE_NS = 1_000_000
#: Of these a cell has one or none.
_ONCE = ("off", "hang")


@dataclass(frozen=True, slots=True)
class _Begun:
    number: int
    since_s: float
    ongoing: Ongoing


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
        seat: Seat,
        simulation: Simulation,
        time: RealTime,
    ) -> None:
        kernel = simulation.kernel
        watch = BusWatch(layout)
        super().__init__(
            scenario.title,
            layout,
            parcels,
            seat=seat,
            watch=watch,
            now_s=lambda: kernel.now_ns / NS_PER_S,
        )
        for number, bus in enumerate(simulation.buses):
            bus.observe(_on_bus(watch, number))
        self._scenario = scenario
        self._simulation = simulation
        self._time = time
        self._usual_speed = self._speed = time.speed
        self._pause_ns: int | None = None
        self._paused = False
        self._begun: dict[int, _Begun] = {}
        self._faults = 0
        self._seen = {"world": 0, "faults": 0}
        self._pace = _Pace(time)

    def description(self) -> dict[str, Any]:
        """See `Table`."""
        return super().description() | {"simulated": True}

    def values(self) -> dict[str, Any]:
        """See `LiveTable`."""
        world, buses = self._simulation.world, self._simulation.buses
        return super().values() | {
            "speed": self._speed,
            "paused": [int(self._paused)],
            "real_time_factor": self._pace.factor(self._simulation.kernel.now_ns),
            "bus_errors": [bus.errors for bus in buses],
            "bus_counters": [_worst_counters(bus) for bus in buses],
            "wheel_slip": world.slip_m_s,
            "wheel_normal": world.normal_n,
            "parcel_true": self._true_poses(),
        }

    def _true_poses(self) -> Any:
        """Of those that are on the table, by their names."""
        world, parcels = self._simulation.world, self._scenario.parcel
        states, poses = world.scene.state.parcels, world.pose
        there = (states["lifted"] == 0) & (states["away"] == 0)
        known = {one.name: poses[k] for k, one in enumerate(parcels) if there[k]}
        unknown = np.full(3, np.nan)
        return [known.get(name, unknown) for name in self._things]

    def busy_s(self) -> Any:
        """How long each bus has been busy."""
        return np.array([bus.busy_ns for bus in self._simulation.buses]) / NS_PER_S

    def story(self) -> list[dict[str, Any]]:
        """See `Table`."""
        return [*super().story(), self._fault_list()]

    def news(self) -> list[dict[str, Any]]:
        """See `Table`."""
        sources = {"world": self._simulation.world.events, "faults": self._simulation.faults.events}
        for name, events in sources.items():
            for event in events[self._seen[name] :]:
                more = {"cell": event.cell, "parcel": event.parcel}
                more = {key: value for key, value in more.items() if value is not None}
                if event.parcel:
                    more["trouble"] = event.kind == "tip"
                detail = event.detail if event.parcel is None else f"{event.parcel}: {event.detail}"
                self.note(event.kind, detail, event.time_s, **more)
            self._seen[name] = len(events)
        return super().news()

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
        self._pause_ns, self._paused = None, False
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
                self._resume()
                step_ns = round(command.duration_s * NS_PER_S)
                self._pause_ns = self._simulation.kernel.now_ns + step_ns
            case commands.Speed():
                self._speed = command.factor
                if not self._paused:
                    self._resume()
            case commands.BeginFault():
                return f"fault {self._begin(command.fault)}"
            case commands.EndFault():
                self._end(command)
            case _:
                return super().do(command)
        return None

    def abandon(self) -> None:
        """See `Table`: time passes as it did, and no parcel stays in a hand that is gone."""
        super().abandon()
        for number, begun in list(self._begun.items()):
            if begun.ongoing.fault.kind == "lift":
                self._end(commands.EndFault(number))
        self._speed = self._usual_speed
        self._resume()

    def _begin(self, fault: Fault) -> int:
        if fault.start_s:
            raise RefusedError("fault.start_s: a fault begins at once; leave it out")
        self._check(fault)
        for begun in self._begun.values():
            other = begun.ongoing.fault
            if fault.kind == other.kind and fault.kind in _ONCE:
                again = set(fault.cells) & set(other.cells)
                if again or not fault.cells:
                    raise RefusedError(f"cell {min(again, default='s')}: {fault.kind} already")
        self._faults += 1
        number, kernel = self._faults, self._simulation.kernel
        ongoing = self._simulation.faults.begin(fault)
        if fault.kind != "push":
            self._begun[number] = _Begun(number, self._now_s(), ongoing)
            self._news.append(self._fault_list())
        if fault.duration_s is not None:
            end_ns = kernel.now_ns + round(fault.duration_s * NS_PER_S)
            kernel.at(end_ns, PRIORITY, lambda: self._end_by_itself(number))
        return number

    def _end(self, command: commands.EndFault) -> None:
        begun = self._begun.get(command.number)
        if begun is None:
            raise RefusedError(f"there is no fault {command.number}")
        pose = {"x_m": command.x_m, "y_m": command.y_m, "yaw_rad": command.yaw_rad}
        given: dict[str, Any] = {name: value for name, value in pose.items() if value is not None}
        if given:
            if begun.ongoing.fault.kind != "lift":
                raise RefusedError("only a parcel that was lifted is set down somewhere")
            self._check(replace(begun.ongoing.fault, duration_s=1.0, **given))
        del self._begun[command.number]
        self._simulation.faults.end(begun.ongoing, **given)
        self._news.append(self._fault_list())

    def _end_by_itself(self, number: int) -> None:
        if number in self._begun:
            self._end(commands.EndFault(number))

    def _check(self, fault: Fault) -> None:
        try:
            check_faults(replace(self._scenario, fault=(fault,)))
        except ScenarioError as error:
            raise RefusedError(str(error).replace("fault.0", "fault")) from None

    def _fault_list(self) -> dict[str, Any]:
        faults = [
            {
                "number": begun.number,
                "since_s": begun.since_s,
                "fault": _chosen(begun.ongoing.fault),
            }
            for begun in self._begun.values()
        ]
        return {"kind": "faults", "faults": faults}


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


def _chosen(fault: Fault) -> dict[str, Any]:
    """What of a fault differs from what it comes with."""
    usual = plain(Fault(fault.kind))
    values = plain(fault).items()
    return {"kind": fault.kind} | {k: v for k, v in values if usual.get(k) != v}


def _worst_counters(bus: Bus) -> tuple[int, int]:
    """The highest transmit and receive error counter of any node."""
    counters = [each.errors for each in bus.controllers]
    return max(each.transmit for each in counters), max(each.receive for each in counters)


def _on_bus(watch: BusWatch, bus: int) -> Callable[..., None]:
    return lambda frame, now_ns: watch.on_frame(frame, now_ns / NS_PER_S, bus)
