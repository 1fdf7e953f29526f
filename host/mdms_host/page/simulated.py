"""A simulated table as the page sees it: with its truth, its faults, and its time."""

from collections.abc import Callable
from typing import Any

import numpy as np

from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.page import commands
from mdms_host.page.commands import Command
from mdms_host.page.faults_by_hand import FaultsByHand
from mdms_host.page.live import LiveTable
from mdms_host.page.seat import Seat
from mdms_host.page.shown.bus_watch import BusWatch
from mdms_host.page.shown.events import events_of
from mdms_model.scenario.scenario import Scenario
from mdms_sim.bus.bus import Bus
from mdms_sim.serve.clock import RealTime
from mdms_sim.simulation import NS_PER_S, Simulation

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
            wall_s=lambda: time.wall_ns() / NS_PER_S,
        )
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
        self._seen = {"world": 0, "faults": 0, "referee": 0}
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

    def errors(self) -> Any:
        """How many error frames each bus has had."""
        return np.array([bus.errors for bus in self._simulation.buses], np.float64)

    def busy_s(self) -> Any:
        """How long each bus has been busy."""
        return np.array([bus.busy_ns for bus in self._simulation.buses]) / NS_PER_S

    def story(self) -> list[dict[str, Any]]:
        """See `Table`."""
        return [*super().story(), self._faults.message()]

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
