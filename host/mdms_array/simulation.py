"""Host and simulator together: a scenario in virtual time, all at once or by hand."""

from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Any, TypeVar

from mdms_array.compiling import compiling_watched
from mdms_array.figures import fault_of, figures_of, goals_of
from mdms_array.host import (
    coordinator_of,
    estimates_of,
    has_failed,
    programmed,
    references_m_s,
    waits_text,
)
from mdms_array.recording import PlanLog, coordinator_events, keep_run
from mdms_array.run import (
    FaultError,
    Finished,
    Incident,
    LostError,
    Run,
    StoppedError,
    TimeLimitError,
    parcels_by_name,
)
from mdms_array.source import Source, open_source
from mdms_array.table import BlockingTable, wait_for_ever
from mdms_host.clock import MonotonicClock
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.motion.goal import Goal
from mdms_host.motion.outcome import missed_text
from mdms_host.programs.program import Main, TableProgram
from mdms_host.programs.table import Table
from mdms_model.errors import InputError
from mdms_model.run.comings import is_wrong
from mdms_model.run.folder import BUS_LOG, fresh_folder
from mdms_model.run.history import MOST_SAMPLES
from mdms_model.run.record import Record
from mdms_model.run.slip import slip_m_s
from mdms_model.scenario.scenario import Scenario
from mdms_model.scenario.task import Signal
from mdms_sim.physics.plane.ideal import solve_ideal
from mdms_sim.physics.row.solver import solve_row
from mdms_sim.referee.truth import HostReport, Pose
from mdms_sim.simulation import Simulation, addresses_of, open_bank
from mdms_sim.simulation import simulate as run_simulation

#: The paper's model, by fidelity.
SOLVERS = {"row": solve_row, "ideal": solve_ideal}


def run_scenario(
    scenario: Scenario,
    nodes: str = "cpython",
    progress: Callable[[float], None] | None = None,
    bus_log: Path | None = None,
    main: Main | None = None,
) -> Finished:
    """Run a scenario in its fidelity; `main` is a program in place of its tasks, field or goals.

    `nodes` are "cpython" or "micropython"; `progress` gets the time reached [s] now and then.
    Raises ScenarioError, MicropythonMissing, NodeError, and `InputError` for what does not fit.
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
        outcome = run_simulation(
            scenario,
            [coordinator],
            nodes,
            bus_log=bus_log,
            estimates=lambda: estimates_of(coordinator, scenario),
            host_report=lambda: host_report_of(coordinator),
            progress=on_progress,
            # A program ends by itself; goals are held to the end.
            over=lambda: scenario.motion.field == "program" and _has_ended(coordinator),
            prepare=lambda simulation: _schedule_signals(simulation, scenario, coordinator.program),
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
            endless=coordinator.endless,
            waits=waits_text(coordinator),
            failed=has_failed(coordinator),
            troubles=troubles,
            lost_cells=tuple(sorted(coordinator.lost_cells)),
            pauses=coordinator.pauses,
            violations=outcome.violations,
        )

    return work


def host_report_of(coordinator: Coordinator | None) -> HostReport | None:
    """What it says now; None where none runs."""
    if coordinator is None:
        return None
    troubles = coordinator.troubles
    stopped = "stopped by a person" if coordinator.stopped else None
    return HostReport(
        goals=_poses(coordinator.goals),
        arrived=_poses(coordinator.arrived),
        believed={
            name: (pose.x_m, pose.y_m, pose.yaw_rad)
            for name in coordinator.arrived
            if (pose := coordinator.estimate(name)) is not None
        },
        reason=coordinator.fault or coordinator.stuck or coordinator.lost or stopped,
        trouble_s=troubles[-1][0] if troubles else -inf,
        over=coordinator.finished,
    )


def _poses(goals: Mapping[str, Goal]) -> dict[str, Pose]:
    return {name: (goal.x_m, goal.y_m, goal.yaw_rad) for name, goal in goals.items()}


def _has_ended(coordinator: Coordinator) -> bool:
    return coordinator.finished or coordinator.stuck is not None


def _add_events(record: Record, coordinator: Coordinator) -> None:
    """Put the coordinator's events among those of the physics, by time."""
    events = record.events + coordinator_events(coordinator)
    record.events = sorted(events, key=lambda event: event.time_s)


__all__ = ["simulate", "virtual"]

Result = TypeVar("Result")
Signals = Mapping[str, Sequence[tuple[float, Any]]]
NS_PER_S = 1_000_000_000
#: Signals come before the cells tick at that instant.
PRIORITY_SIGNAL = 4
#: The parcels of a table are found within this, or something is wrong with them [s].
FOUND_S = 20.0
#: A virtual table has no end of its own; a scenario has one [s].
LONGEST_S = 1e5


def simulate(
    scenario: Source,
    program: Main | None = None,
    signals: Signals | None = None,
    limit_s: float | None = None,
    record: str | Path | None = None,
) -> Run:
    """Run a scenario in virtual time; it returns however the run ends.

    `scenario` is a built-in name, a file, a dict, or a `Scenario`. `program` is
    `async def program(table)`, in place of the scenario's goals and tasks. `signals` has what comes
    to it from outside: by name, pairs of time [s] and value. `limit_s` takes the place of the
    scenario's duration. `record` is a folder that keeps the run.

    Raises `InputError` for what cannot be run.
    """
    checked, main = open_source(scenario, program)
    if limit_s is not None:
        checked = replace(checked, run=replace(checked.run, duration_s=limit_s))
    listed = _listed(signals)
    if listed and main is None and checked.motion.field != "program":
        raise InputError(f"signals: {', '.join(signals or ())} is given, but no program takes it")
    checked = replace(checked, signal=(*checked.signal, *listed))
    if record is None:
        return run_of(checked, run_scenario(checked, main=main))
    finished, _ = run_and_keep(checked, Path(record), main=main)
    return run_of(checked, finished)


def run_and_keep(
    scenario: Scenario,
    out: Path,
    nodes: str = "cpython",
    *,
    progress: Callable[[float], None] | None = None,
    bus_format: str = "log",
    main: Main | None = None,
) -> tuple[Finished, dict[str, Any]]:
    """Run a scenario and keep it in a folder; the run and its figures. Raises OSError."""
    with fresh_folder(out) as folder:
        finished = run_scenario(scenario, nodes, progress, folder / BUS_LOG, main)
        figures = figures_of(scenario, finished) | {"run": str(out)}
        keep_run(folder, scenario, finished.record, figures, bus_format)
    return finished, figures


def run_of(scenario: Scenario, finished: Finished) -> Run:
    """What a finished run comes to."""
    status, reason = _status(scenario, finished)
    outcomes = goals_of(scenario, finished)
    names = [parcel.name for parcel in scenario.parcel]
    return Run(
        scenario,
        status,
        reason,
        finished.record,
        figures_of(scenario, finished),
        parcels_by_name(finished.record, names, finished.goals, outcomes),
        incidents=[Incident(time_s, text) for time_s, text in finished.troubles],
        violations=finished.violations,
        bus=finished.bus,
        endless=finished.endless,
        wall_s=finished.wall_s,
    )


def _status(scenario: Scenario, finished: Finished) -> tuple[str, str]:
    """How a run has ended, and why if not as asked: the first of these that holds."""
    events = finished.record.events
    tipped = any(event.kind == "tip" for event in events)
    wrong = [event for event in events if event.kind == "exit" and is_wrong(event)]
    missed = missed_text(goals_of(scenario, finished))
    late = f"the program has not come to its end{finished.waits}"
    endings: tuple[tuple[object, str, str | None], ...] = (
        (tipped, "lost", fault_of(finished)),
        (finished.failed, "failed", finished.stuck),
        (finished.fault, "fault", finished.fault),
        (finished.lost, "lost", finished.lost),
        (wrong, "failed", f"{wrong[0].parcel} {wrong[0].detail}" if wrong else None),
        (finished.stuck, "stopped", finished.stuck),
        (missed, "time limit", missed),
        (finished.unfinished, "time limit", late),
        (finished.endless, "time limit", "the job has no end of its own"),
        (True, "reached", ""),
    )
    return next((status, str(reason)) for holds, status, reason in endings if holds)


def _listed(signals: Signals | None) -> tuple[Signal, ...]:
    return tuple(
        Signal(name, value, float(time_s))
        for name, pairs in (signals or {}).items()
        for time_s, value in pairs
    )


@contextmanager
def virtual(scenario: Source, signals: Signals | None = None) -> Iterator[BlockingTable]:
    """A table by hand, in virtual time: time passes only inside its calls.

    The scenario's goals, tasks and duration do not count. Entering brings the cells up and finds
    the parcels. Raises `InputError` for what cannot be run, and `RunError` for a table that does
    not come up.
    """
    checked, _ = open_source(scenario, wait_for_ever)
    checked = replace(checked, signal=(*checked.signal, *_listed(signals)))
    with closing(open_bank("cpython", addresses_of(checked).node_ids)) as bank:
        driver = VirtualDriver(checked, bank)
        driver.begin()
        yield BlockingTable(driver)


class VirtualDriver:
    """Drives a simulated table as far as a call needs; see `table.Driver`."""

    def __init__(self, scenario: Scenario, bank: Any) -> None:
        self._scenario = scenario
        self._coordinator = coordinator_of(scenario, main=wait_for_ever)
        program = self._coordinator.program
        assert isinstance(program, TableProgram)
        self._program = program
        self._plans = PlanLog(self._coordinator)
        self._simulation = Simulation(
            scenario,
            bank,
            [self._coordinator],
            estimates=partial(estimates_of, self._coordinator, scenario),
            host_report=partial(host_report_of, self._coordinator),
            most_samples=MOST_SAMPLES,
        )
        _schedule_signals(self._simulation, scenario, program)
        self._wall_s = 0.0

    def begin(self) -> None:
        """Bring the cells up and find the parcels. Raises `RunError`."""
        self._advance(FOUND_S, lambda: self._program.began)
        if not self._program.began:
            waits = waits_text(self._coordinator) or ": its parcels have not been found"
            raise TimeLimitError(f"the table does not come up{waits}", self.run_so_far)

    @property
    def table(self) -> Table:
        """The table as programs see it."""
        return self._program.table

    def call(
        self,
        routine: Callable[[Table], Coroutine[Any, Any, Result]],
        limit_s: float | None,
    ) -> Result:
        """Let time pass until a coroutine is done; what it returns. Raises what it raises."""
        task = self.table.start(routine(self.table))
        task.heed()
        self._advance(LONGEST_S if limit_s is None else limit_s, lambda: task.done)
        if not task.done:
            task.cancel()
            where = waits_text(self._coordinator)
            raise TimeLimitError(f"not done within {limit_s:g} s{where}", self.run_so_far)
        return task.result()

    @property
    def run_so_far(self) -> Run:
        """The run up to now."""
        coordinator, outcome = self._coordinator, self._simulation.outcome()
        events = outcome.record.events + coordinator_events(coordinator)
        outcome.record.events = sorted(events, key=lambda event: event.time_s)
        outcome.record.plans = self._plans.plans
        return run_of(
            self._scenario,
            Finished(
                outcome.record,
                "cpython",
                outcome.bus,
                fault=coordinator.fault,
                lost=coordinator.lost,
                stuck=coordinator.stuck,
                goals=dict(coordinator.goals),
                failed=has_failed(coordinator),
                troubles=tuple(coordinator.troubles),
                lost_cells=tuple(sorted(coordinator.lost_cells)),
                pauses=coordinator.pauses,
                violations=outcome.violations,
                wall_s=max(self._wall_s, 1e-6),
            ),
        )

    def _advance(self, seconds: float, over: Callable[[], bool]) -> None:
        """Let so much time pass at most. Raises `RunError` where the run cannot go on."""
        coordinator, simulation = self._coordinator, self._simulation

        def ended() -> bool:
            return over() or coordinator.stopped or coordinator.stuck is not None

        end_s, clock = simulation.kernel.now_ns / NS_PER_S + seconds, MonotonicClock()
        simulation.run_until(end_s, self._plans.look, ended)
        self._wall_s += clock.now_s()
        if simulation.tipped:
            run = self.run_so_far
            raise LostError(run.reason, run)
        if coordinator.fault is not None:
            raise FaultError(coordinator.fault, self.run_so_far)
        if coordinator.stuck is not None:
            raise StoppedError(coordinator.stuck, self.run_so_far)


def _schedule_signals(simulation: Simulation, scenario: Scenario, program: object) -> None:
    """Have the signals of a scenario come to its program at their times, and no others."""
    if not isinstance(program, TableProgram):
        return
    program.driver.in_virtual_time()
    for signal in scenario.signal:
        receive = partial(program.driver.receive, signal.name, signal.value)
        simulation.kernel.at(round(signal.time_s * NS_PER_S), PRIORITY_SIGNAL, receive)
