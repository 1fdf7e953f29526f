"""A simulated table with its page: in the machine's time, with a program that a person starts."""

from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from time import sleep

from mdms_array.host import (
    coordinator_of,
    layout_of,
    parcels_of,
)
from mdms_array.simulation import host_report_of
from mdms_host.cli.exits import ExitCode, interrupted
from mdms_host.cli.kept import Kept
from mdms_host.cli.line import Job, has_line
from mdms_host.cli.live_array import Watched, attendants
from mdms_host.cli.streams import say
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.line.machine import Recipes
from mdms_host.page.run_slot import RunSlot
from mdms_host.page.simulated import SLICE_NS, SimulatedTable
from mdms_host.programs.program import Main
from mdms_host.programs.traffic.dispatch import ThreadExecutor
from mdms_host.routes.planner import planner_compiled_beside
from mdms_model.scenario.belief import believed
from mdms_model.scenario.scenario import Scenario
from mdms_sim.serve.clock import RealTime
from mdms_sim.serve.server import Server
from mdms_sim.simulation import NS_PER_S, Simulation, addresses_of, open_bank

#: Kinds of events that a table without a simulation has, too.
_HOSTS = ("coordinator", "line", "page")


def slot_of(
    scenario: Scenario, main: Main | None = None, recipes: Recipes[Job] | None = None
) -> RunSlot:
    """The host's place at a simulated table, where nobody sits yet. Raises `CommandError`.

    Every start begins `main`, or the scenario's own program, anew; with `recipes` the chosen one.
    """
    recipes = recipes or Recipes({"": (scenario, main)})
    # A scenario that does not fit the firmware is refused now, and not when somebody presses a
    # button.
    return RunSlot(recipes.starter(_coordinator_of), addresses_of(scenario).bus_count)


def _coordinator_of(job: Job) -> Coordinator:
    scenario, main = job
    return coordinator_of(scenario, main=main, executor=ThreadExecutor())


def table_of(
    scenario: Scenario,
    slot: RunSlot,
    simulation: Simulation,
    time: RealTime,
    report: Callable[[float, str, str], object] = lambda _time_s, _kind, _text: None,
) -> SimulatedTable:
    """The page of a simulation: its view and its commands; `report` is told of events."""
    told = believed(scenario)
    parcels = {parcel.name: parcel for parcel in (*parcels_of(scenario), *parcels_of(told))}
    table = SimulatedTable(
        scenario,
        layout_of(told),
        # Those that the host is not told of lie there too.
        tuple(parcels.values()),
        slot=slot,
        simulation=simulation,
        time=time,
    )
    table.report = report
    return table


@contextmanager
def attended(
    scenario: Scenario,
    slot: RunSlot,
    server: Server,
    arguments: Namespace,
    *,
    recipes: Recipes[Job],
    over: Callable[[], object],
    kept: Kept,
) -> Iterator[Callable[[], object]]:
    """The page and the line of a served table; a hook in place of `over` looks after them.

    With a line the host's events go to stderr, as those of `mdms run` do.
    """

    def report(time_s: float, kind: str, text: str) -> None:
        if has_line(arguments) and kind in _HOSTS:
            say(f"{time_s:8.3f} s  {text}")
        kept.event(time_s, kind, text)

    table = table_of(scenario, slot, server.simulation, server.time, report)
    watched = Watched(kept, slot, scenario)
    kernel = server.simulation.kernel
    with attendants(table, slot, scenario, arguments, recipes) as attend:

        def over_or_attended() -> object:
            attend()
            table.look()
            watched.look(kernel.now_ns / NS_PER_S, attend.line)
            return over() or attend.failure

        yield over_or_attended
    if attend.failure is not None:
        raise attend.failure


def show(scenario: Scenario, arguments: Namespace, main: Main | None = None) -> ExitCode:
    """Run a scenario's program in real time with its page, until Ctrl-C."""
    slot = slot_of(scenario, main)
    with (
        planner_compiled_beside(),
        closing(open_bank("cpython", addresses_of(scenario).node_ids)) as bank,
    ):
        simulation = Simulation(
            scenario,
            bank,
            [slot],
            host_report=lambda: host_report_of(slot.coordinator),
            recording=None,
            beyond_tipping=True,
        )
        # All code is compiled before anybody looks and time counts.
        simulation.kernel.run_until(SLICE_NS)
        table = table_of(scenario, slot, simulation, RealTime())
        slot.start()
        # The page is an extra.
        from mdms_host.cli.live_page import opened_page  # noqa: PLC0415

        with opened_page(table, arguments) as page, interrupted() as over:
            while not over():
                page.attend()
                table.advance()
                sleep(table.wait_s())
    return ExitCode.OK
