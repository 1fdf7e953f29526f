"""A line's machine on a simulated table, in virtual time: no servers, no protocols."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from mdms_array.host import coordinator_of
from mdms_host.can_link.recent import Recent
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.line.machine import Machine, Recipes
from mdms_host.line.packml import Command, State
from mdms_host.page.run_slot import RunSlot
from mdms_host.programs.program import Main
from mdms_host.programs.table_orders import Report
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Scenario
from mdms_sim.physics.plane.handling import take_away
from mdms_sim.simulation import NS_PER_S, Simulation, addresses_of, open_bank

TABLE = Path(__file__).parents[3] / "examples" / "line" / "table.toml"
#: A request, and what comes of it, is looked at so often [s].
_STEP_S = 0.002


class VirtualLine:
    """`beats` is whether a client's heartbeat goes on; close it when done."""

    def __init__(
        self,
        overrides: tuple[str, ...] = (),
        recent: Recent | None = None,
        *,
        source: str = str(TABLE),
        recipes: dict[str, tuple[Scenario, Main | None]] | None = None,
    ) -> None:
        scenario = load_scenario(source, ["run.fidelity=firmware", *overrides])
        addresses = addresses_of(scenario)
        self.reports: list[Report] = []
        self.beats = True
        jobs = {TABLE.stem: (scenario, None), **(recipes or {})}
        self.recipes: Recipes[tuple[Scenario, Main | None]] = Recipes(jobs)

        def make() -> Coordinator:
            chosen, main = self.recipes.begin()
            return coordinator_of(chosen, main=main)

        self.slot = RunSlot(make, addresses.bus_count, recent=recent)
        self._bank = open_bank("cpython", addresses.node_ids)
        self.simulation = Simulation(scenario, self._bank, [self.slot], recording=None)
        exits = tuple(each.name for each in scenario.exit)
        self.machine = Machine(self.slot, exits, self.now_s, self.reports.append, self.recipes)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._bank.close()

    def now_s(self) -> float:
        return self.simulation.kernel.now_ns / NS_PER_S

    @property
    def state(self) -> State:
        return self.machine.states.state

    def do(self, name: str, **values: Any) -> None:
        self.machine.do(name, values)

    def command(self, command: Command) -> None:
        self.machine.beat("plc")
        self.machine.command(command, "plc")

    def until(self, done: Callable[[], bool], within_s: float) -> None:
        end_s = self.now_s() + within_s
        while not done():
            assert self.now_s() < end_s, (self.state, self.machine.states.reason, self.reports)
            self.pass_s(_STEP_S)

    def until_state(self, state: State, within_s: float = 10.0) -> None:
        self.until(lambda: self.state is state, within_s)

    def pass_s(self, seconds: float) -> None:
        kernel, end_s = self.simulation.kernel, self.now_s() + seconds
        while self.now_s() < end_s:
            kernel.run_until(kernel.now_ns + round(_STEP_S * NS_PER_S))
            if self.beats:
                self.machine.beat("plc")
            self.machine.step()

    def bring_to_execute(self) -> None:
        self.command(Command.RESET)
        self.until_state(State.IDLE)
        self.command(Command.START)
        self.until_state(State.EXECUTE)

    def events(self, parcel: str) -> list[str]:
        return [report.event for report in self.reports if report.parcel == parcel]

    def of_order(self, key: str) -> list[str]:
        return [report.event for report in self.reports if report.key == key]

    def moving(self) -> bool:
        """Whether any wheel turns, by the simulator and not by a belief."""
        return bool((abs(self.simulation.world.wheel_speed_m_s) > 0.01).any())

    def take_parcels_off(self) -> None:
        """A person takes all parcels off the table, to where they come from."""
        take_parcels_off(self.simulation)

    def begin(self, kind: str, **values: Any) -> Any:
        return self.simulation.faults.begin(Fault(kind, **values))


def take_parcels_off(simulation: Simulation) -> None:
    """Take all parcels off a table, to where they come from."""
    scene = simulation.world.scene
    for number, parcel in enumerate(scene.state.parcels):
        if not parcel["away"]:
            take_away(scene, number)
