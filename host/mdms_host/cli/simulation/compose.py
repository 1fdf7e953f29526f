"""Puts host and simulator together: a scenario is run in its fidelity."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from mdms_host.cli.compiling import compiling_watched
from mdms_host.cli.records.host_log import coordinator_events
from mdms_host.cli.records.plan_log import PlanLog
from mdms_host.cli.scenario.coordination import coordinator_of, estimates_of
from mdms_host.cli.scenario.field import references_m_s
from mdms_host.cli.scenario.programs import has_failed, programmed, waits_text
from mdms_host.cli.simulation.word import host_report_of
from mdms_host.clock import MonotonicClock
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.motion.goal import Goal
from mdms_host.programs.program import Main
from mdms_model.run.record import Record
from mdms_model.run.slip import slip_m_s
from mdms_model.scenario.scenario import Scenario
from mdms_sim.physics.plane.ideal import solve_ideal
from mdms_sim.physics.row.solver import solve_row
from mdms_sim.referee.rules import Violation
from mdms_sim.simulation import BusFigures, simulate

__all__ = ["Finished", "run_scenario"]

#: The paper's model, by fidelity.
SOLVERS = {"row": solve_row, "ideal": solve_ideal}


@dataclass(frozen=True, slots=True)
class Finished:
    """A run that has ended: what it recorded, how long it took, and what a coordinator met.

    `troubles` are what the coordinator found amiss, as (time [s], text), `lost` is which parcels it
    does not find any more at the end, and `stuck` why it could not go on to its goals; `goals` are
    where it steered parcels last, and `unfinished` is whether its program was to end, and has not,
    `waits` where it waits, and `failed` whether it has ended by an error in it;
    `lost_cells` are those that it does without by then, and `pauses` is how often it has held all
    parcels. `violations` are what the referee of the simulation has noted.
    `wall_s` leaves out `compile_s`, which passes once per installation.
    """

    record: Record
    nodes: str | None = None
    bus: BusFigures | None = None
    fault: str | None = None
    lost: str | None = None
    stuck: str | None = None
    goals: Mapping[str, Goal] = field(default_factory=dict)
    unfinished: bool = False
    waits: str = ""
    failed: bool = False
    troubles: tuple[tuple[float, str], ...] = ()
    lost_cells: tuple[int, ...] = ()
    pauses: int = 0
    violations: tuple[Violation, ...] = ()
    wall_s: float = 0.0
    compile_s: float = 0.0


def run_scenario(
    scenario: Scenario,
    nodes: str = "cpython",
    progress: Callable[[float], None] | None = None,
    bus_log: Path | None = None,
    main: Main | None = None,
) -> Finished:
    """Run a scenario in its fidelity; `main` is a program in place of its tasks, field or goals.

    `nodes` are "cpython" or "micropython"; `progress` gets the time reached [s] now and then.
    Raises ScenarioError, MicropythonMissing, NodeError, and `CommandError` for what does not fit.
    """
    if main is not None:
        scenario = programmed(scenario)
    if scenario.run.fidelity == "firmware":
        return timed(scenario, lambda: _firmware(scenario, nodes, progress, bus_log, main))
    return timed(scenario, lambda: _model(scenario))


def timed(scenario: Scenario, prepare: Callable[[], Callable[[], Finished]]) -> Finished:
    """Prepare a run, do it, and measure how long it took."""
    with compiling_watched() as compiled:
        work = prepare()
        before_s, clock = compiled.seconds, MonotonicClock()
        finished = work()
        wall_s = max(clock.now_s() - (compiled.seconds - before_s), 1e-6)
    if finished.record.slip_m_s is None:
        finished.record.slip_m_s = slip_m_s(scenario, finished.record)
    return replace(finished, wall_s=wall_s, compile_s=compiled.seconds)


def _model(scenario: Scenario) -> Callable[[], Finished]:
    """The paper's model, without cells and bus, ready to run."""
    solve, reference_m_s = SOLVERS[scenario.run.fidelity], references_m_s(scenario)
    return lambda: Finished(solve(scenario, reference_m_s))


def _firmware(
    scenario: Scenario,
    nodes: str,
    progress: Callable[[float], None] | None,
    bus_log: Path | None,
    main: Main | None,
) -> Callable[[], Finished]:
    """Cells, bus and coordinator, ready to run."""
    coordinator = coordinator_of(scenario, main=main)
    plans = PlanLog(coordinator)

    def on_progress(time_s: float) -> None:
        plans.look(time_s)
        if progress is not None:
            progress(time_s)

    def work() -> Finished:
        outcome = simulate(
            scenario,
            [coordinator],
            nodes,
            bus_log=bus_log,
            estimates=lambda: estimates_of(coordinator, scenario),
            host_report=lambda: host_report_of(coordinator),
            progress=on_progress,
            # A program ends by itself; goals are held to the end.
            over=lambda: scenario.motion.field == "program" and _has_ended(coordinator),
        )
        _add_events(outcome.record, coordinator)
        outcome.record.plans = plans.plans
        troubles = tuple(coordinator.troubles)
        return Finished(
            outcome.record,
            nodes,
            outcome.bus,
            fault=coordinator.fault,
            lost=coordinator.lost,
            stuck=coordinator.stuck,
            goals=dict(coordinator.goals),
            unfinished=not (coordinator.finished or coordinator.endless),
            waits=waits_text(coordinator),
            failed=has_failed(coordinator),
            troubles=troubles,
            lost_cells=tuple(sorted(coordinator.lost_cells)),
            pauses=coordinator.pauses,
            violations=outcome.violations,
        )

    return work


def _has_ended(coordinator: Coordinator) -> bool:
    return coordinator.finished or coordinator.stuck is not None


def _add_events(record: Record, coordinator: Coordinator) -> None:
    """Put the coordinator's events among those of the physics, by time."""
    events = record.events + coordinator_events(coordinator)
    record.events = sorted(events, key=lambda event: event.time_s)
