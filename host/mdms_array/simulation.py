"""Host and simulator together: a scenario in virtual time, all at once or by hand."""

import sys
from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from mdms_array.extras import COMPILER, RECORDING, require
from mdms_array.figures import REPORTED_S, broken_off, simulated_run
from mdms_array.host import (
    break_off,
    coordinator_of,
    estimates_of,
    has_failed,
    programmed,
    references_m_s,
    waits_text,
)
from mdms_array.recording import PlanLog, coordinator_events, keep_run
from mdms_array.run import (
    FailedError,
    FaultError,
    LostError,
    Run,
    StoppedError,
    TimeLimitError,
)
from mdms_array.source import (
    LONGEST_S,
    SHORTEST_S,
    Source,
    check_time,
    open_source,
)
from mdms_array.table import BlockingTable, for_one_block, wait_for_ever
from mdms_host.clock import MonotonicClock
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import TROUBLED
from mdms_host.motion.goal import GoalPose
from mdms_host.programs.program import Main, TableProgram
from mdms_host.programs.table import Table
from mdms_host.routes.planner import planner_compiled_beside
from mdms_model.compiled import WAITING
from mdms_model.errors import InputError, check_path
from mdms_model.log import LOG
from mdms_model.run.folder import BUS_LOG, check_other_run, fresh_folder
from mdms_model.run.record import MOST_SAMPLES, Record, exit_of, leaving
from mdms_model.scenario.rules import check_rules
from mdms_model.scenario.scenario import Scenario, Signal
from mdms_sim.physics.plane.ideal import solve_ideal
from mdms_sim.physics.row.solver import solve_row
from mdms_sim.referee.truth import HostReport, Pose
from mdms_sim.simulation import Outcome, Recording, Simulation, addresses_of, open_bank
from mdms_sim.simulation import simulate as run_simulation

if TYPE_CHECKING:
    from numba.core.event import Event

NOTICE = "Compiling the simulator's inner loops; this happens once per installation."


@dataclass(slots=True)
class Compiled:
    """Time that has gone into compiling so far [s]."""

    seconds: float = 0.0


@contextmanager
def compiling_watched() -> Iterator[Compiled]:
    """Measures the compilation meanwhile; a long one is announced on a terminal, once.

    So is the time in which another process compiles the same.

    Raises `Error` without the compiler.
    """
    require(COMPILER, "a simulation")
    # It is an extra.
    from numba.core.event import Listener, install_listener  # noqa: PLC0415

    compiled, clock = Compiled(), MonotonicClock()

    class Stopwatch(Listener):
        """Functions that others call are compiled while those are, so only the outermost counts."""

        depth = 0
        start_s = 0.0
        reported = False

        def on_start(self, event: "Event") -> None:
            if not self.depth:
                self.start_s = clock.now_s()
            self.depth += 1
            self.report()

        def on_end(self, event: "Event") -> None:
            self.report()
            self.depth -= 1
            if not self.depth:
                compiled.seconds += clock.now_s() - self.start_s

        def report(self) -> None:
            spent_s = compiled.seconds + clock.now_s() - self.start_s
            if spent_s >= REPORTED_S and not self.reported and sys.stderr.isatty():
                self.reported = True
                LOG.warning(NOTICE)

    stopwatch = Stopwatch()
    with install_listener("numba:compile", stopwatch), install_listener(WAITING, stopwatch):
        yield compiled


Result = TypeVar("Result")
#: The paper's model, by fidelity.
SOLVERS = {"row": solve_row, "ideal": solve_ideal}


def run_scenario(
    scenario: Scenario,
    nodes: str = "cpython",
    progress: Callable[[float], None] | None = None,
    bus_log: Path | None = None,
    main: Main | None = None,
) -> Run:
    """Run a scenario in its fidelity; `main` is a program in place of its tasks, field or goals.

    `nodes` are "cpython" or "micropython"; `progress` gets the time reached [s] now and then.
    A cell whose process dies ends the run with a fault. Raises ScenarioError, MicropythonMissing,
    NodeError when the cells cannot begin, and `InputError` for values that do not fit.
    """
    if main is not None:
        scenario = programmed(scenario)
    if scenario.run.fidelity == "firmware":
        return _firmware(scenario, nodes, progress, bus_log, main)
    record, wall_s, compile_s = timed(lambda: _model(scenario))
    return simulated_run(scenario, record, wall_s=wall_s, compile_s=compile_s)


def timed(prepare: Callable[[], Callable[[], Result]]) -> tuple[Result, float, float]:
    """Prepare a run and do it; its result, its duration, and the time of numba's compilation."""
    with compiling_watched() as compiled:
        work = prepare()
        before_s, clock = compiled.seconds, MonotonicClock()
        result = work()
        wall_s = clock.now_s() - (compiled.seconds - before_s)
    return result, wall_s, compiled.seconds


def _model(scenario: Scenario) -> Callable[[], Record]:
    """The paper's model, without cells and bus, ready to run."""
    solve, reference_m_s = SOLVERS[scenario.run.fidelity], references_m_s(scenario)
    return lambda: solve(scenario, reference_m_s)


def _firmware(
    scenario: Scenario,
    nodes: str,
    progress: Callable[[float], None] | None,
    bus_log: Path | None,
    main: Main | None,
) -> Run:
    """Cells, bus and coordinator."""

    def prepare() -> Callable[[], tuple[Coordinator, Outcome]]:
        coordinator = coordinator_of(scenario, main=main)
        return lambda: (coordinator, _simulated(scenario, coordinator, nodes, progress, bus_log))

    with planner_compiled_beside():
        (coordinator, outcome), wall_s, compile_s = timed(prepare)
    run = simulated_run(
        scenario,
        outcome.record,
        coordinator,
        nodes=nodes,
        bus=outcome.bus,
        violations=outcome.violations,
        fault=outcome.fault,
        wall_s=wall_s,
        compile_s=compile_s,
    )
    return broken_off(run, coordinator)


def _simulated(
    scenario: Scenario,
    coordinator: Coordinator,
    nodes: str,
    progress: Callable[[float], None] | None,
    bus_log: Path | None,
) -> Outcome:
    plans = PlanLog(coordinator)

    def on_progress(time_s: float) -> None:
        plans.look(time_s)
        if progress is not None:
            progress(time_s)

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
    _take_exits_as_asked(outcome.record, scenario, coordinator.program)
    _add_reports(outcome.record, coordinator, plans)
    return outcome


def host_report_of(coordinator: Coordinator | None) -> HostReport | None:
    """Its present report; None where none runs."""
    if coordinator is None:
        return None
    troubles = coordinator.troubles
    stopped = "stopped by a person" if coordinator.stopped else None
    held = troubles[-1][1] if troubles and coordinator.phase in TROUBLED else None
    return HostReport(
        goals=_poses(coordinator.goals),
        arrived=_poses(coordinator.arrived),
        believed={
            name: (pose.x_m, pose.y_m, pose.yaw_rad)
            for name in coordinator.arrived
            if (pose := coordinator.estimate(name)) is not None
        },
        reason=coordinator.fault or coordinator.stuck or coordinator.lost or held or stopped,
        trouble_s=troubles[-1][0] if troubles else -inf,
        # A program may end before a parcel is there whose task it does not await.
        over=coordinator.finished and coordinator.arrived.keys() == coordinator.goals.keys(),
        guessed=coordinator.tracker.guessed,
    )


def _poses(goals: Mapping[str, GoalPose]) -> dict[str, Pose]:
    return {name: (goal.x_m, goal.y_m, goal.yaw_rad) for name, goal in goals.items()}


def _has_ended(coordinator: Coordinator) -> bool:
    return coordinator.finished or coordinator.stuck is not None


def _take_exits_as_asked(record: Record, scenario: Scenario, program: object) -> None:
    """An exit that the program has asked for by its name is none of the wrong ones.

    Names of parcels that come are the host's guess among those of a kind, so the kind counts.
    """
    asked = program.table.asked_exits if isinstance(program, TableProgram) else set()
    kinds = {parcel.name: parcel.kind for parcel in scenario.parcel}
    for number, event in enumerate(record.events):
        if event.kind == "exit" and event.parcel is not None:
            kind, name = kinds[event.parcel], exit_of(event)
            if (kind, name) in asked:
                record.events[number] = leaving(event.time_s, event.parcel, name, wrong=False)


def _add_reports(record: Record, coordinator: Coordinator, plans: PlanLog) -> None:
    """Put the coordinator's events among those of the physics, by time, and its plans."""
    events = record.events + coordinator_events(coordinator)
    record.events = sorted(events, key=lambda event: event.time_s)
    record.plans = plans.plans


Signals = Mapping[str, Sequence[tuple[float, Any]]]
NS_PER_S = 1_000_000_000
#: Signals come before the cells tick at that instant.
PRIORITY_SIGNAL = 4
#: The parcels of a table are found within this, or something is wrong with them [s].
FOUND_S = 20.0


def simulate(
    scenario: Source,
    program: Main | None = None,
    signals: Signals | None = None,
    limit_s: float | None = None,
    record: str | Path | None = None,
    *,
    force: bool = False,
) -> Run:
    """Run a scenario in virtual time; it returns however the run ends.

    `scenario` is a built-in name, a file, the folder of an earlier run, a dict, or a `Scenario`.
    `program` is `async def program(table)`, in place of the scenario's goals and tasks, or of the
    program that an earlier run had. `signals` has its values from outside: by name, pairs of time
    [s] and value. `limit_s` takes the place of the scenario's duration. `record` is a folder that
    keeps the run; values of signals are text then. `force` overwrites another run in it; a run
    without a program may replace itself.

    Raises `InputError` for what cannot be run, `Error` where an extra is not installed, and OSError
    for a disk that takes no record.
    """
    require(COMPILER, "mdms_array.simulate")
    folder = None if record is None else check_path("record", record)
    if folder is not None:
        require(RECORDING, "mdms_array.simulate with a record")
    checked, main = open_source(scenario, program)
    if limit_s is not None:
        duration_s = check_time("limit_s", limit_s, SHORTEST_S)
        checked = replace(checked, run=replace(checked.run, duration_s=duration_s))
        # A longer run has more samples than may be kept.
        check_rules(checked)
    listed = _listed(signals)
    if listed and main is None and checked.motion.field != "program":
        raise InputError(f"signals: {', '.join(signals or ())} is given, but no program takes it")
    checked = replace(checked, signal=(*checked.signal, *listed))
    if folder is None:
        return run_scenario(checked, main=main)
    _refuse_unkept(listed)
    if not force:
        repeated = checked if main is None else None
        ways_out = "force=True overwrites it, or give another folder"
        check_other_run(folder, repeated, ways_out)
    return run_and_keep(checked, folder, main=main)


def run_and_keep(
    scenario: Scenario,
    out: Path,
    nodes: str = "cpython",
    *,
    progress: Callable[[float], None] | None = None,
    bus_format: str = "log",
    main: Main | None = None,
    over: Callable[[], object] = lambda: None,
) -> Run:
    """Run a scenario and keep it in a folder, which its figures name then. Raises OSError.

    `over` is called after the run, before its pictures are drawn.
    """
    with fresh_folder(out) as folder:
        run = run_scenario(scenario, nodes, progress, folder / BUS_LOG, main)
        over()
        run = replace(run, figures={**run.figures, "run": str(out)})
        keep_run(folder, scenario, run.record, dict(run.figures), bus_format, main=main)
    return run


def _refuse_unkept(signals: Sequence[Signal]) -> None:
    """Raises `InputError` for a value that the scenario of a run folder does not have."""
    for signal in signals:
        if not isinstance(signal.value, str):
            raise InputError(
                f"signals: {signal.name} has {signal.value!r}, but a record keeps text; give "
                f"{str(signal.value)!r}, or no record"
            )


def _listed(signals: Signals | None) -> tuple[Signal, ...]:
    listed = []
    if not isinstance(signals, Mapping | None):
        raise InputError(f"signals: {signals!r} is no table of lists by name")
    for name, pairs in (signals or {}).items():
        if not isinstance(pairs, Sequence) or not isinstance(name, str):
            raise InputError(f"signals: {name!r} has {pairs!r}, but must have a list of pairs")
        for pair in pairs:
            if not (isinstance(pair, Sequence) and len(pair) == 2):
                raise InputError(
                    f"signals: {name} has {pair!r}, but must have pairs (time_s, value)"
                )
            listed.append(
                Signal(name, pair[1], check_time(f"signals: the time of {name}", pair[0]))
            )
    return tuple(listed)


@for_one_block
def virtual(scenario: Source, signals: Signals | None = None) -> Iterator[BlockingTable]:
    """A table by hand, in virtual time: time passes only inside its calls.

    The scenario's goals, tasks and duration do not count. Entering brings the cells up and finds
    the parcels. Raises `InputError` for what cannot be run, `Error` where an extra is not
    installed, and `RunError` for a table that does not come up.
    """
    require(COMPILER, "mdms_array.virtual")
    checked, _ = open_source(scenario, wait_for_ever)
    checked = replace(checked, signal=(*checked.signal, *_listed(signals)))
    with closing(open_bank("cpython", addresses_of(checked).node_ids)) as bank:
        driver = VirtualDriver(checked, bank)
        driver.begin()
        try:
            yield BlockingTable(driver)
        finally:
            failure = driver.close()
        if failure is not None:
            raise FailedError(failure, driver.run_so_far)


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
            recording=Recording(
                estimates=partial(estimates_of, self._coordinator, scenario),
                most_samples=MOST_SAMPLES,
            ),
            host_report=partial(host_report_of, self._coordinator),
        )
        _schedule_signals(self._simulation, scenario, program)
        self._wall_s = 0.0
        #: Why no more time may pass, None while it may.
        self._ended: str | None = None
        self._advances = False

    def begin(self) -> None:
        """Bring the cells up and find the parcels. Raises `RunError`."""
        self._advance(FOUND_S, lambda: self._program.began)
        if not self._program.began:
            waits = waits_text(self._coordinator) or ": its parcels have not been found"
            raise TimeLimitError(f"the table does not come up{waits}", self.run_so_far)

    def close(self) -> str | None:
        """Let no more time pass; why its programs have failed as they were broken off, if so."""
        self._ended = "its `with` block has ended"
        return break_off(self._coordinator)

    @property
    def table(self) -> Table:
        """The table as programs see it."""
        return self._program.table

    @property
    def is_within(self) -> bool:
        """See `table.Driver`."""
        return self._advances

    def call(
        self,
        routine: Callable[[Table], Coroutine[Any, Any, Result]],
        limit_s: float | None,
    ) -> Result:
        """Let time pass until a coroutine is done, and return its result. Raises its errors."""
        if self._ended is not None:
            raise StoppedError(f"the table has stopped: {self._ended}", self.run_so_far)
        task = self.table.start(routine(self.table))
        task.heed()

        def has_result() -> bool:
            # A program that ends by an error breaks all tasks off, and then the run ends.
            return task.done and not task.cancelled

        limit_s = LONGEST_S if limit_s is None else limit_s
        try:
            self._advance(limit_s, has_result)
        except BaseException:
            task.cancel()
            raise
        if not has_result():
            where = task.where
            task.cancel()
            told = f"not done within {limit_s:g} s: it waits in {where}"
            raise TimeLimitError(told, self.run_so_far)
        return task.result()

    @property
    def run_so_far(self) -> Run:
        """The run up to now."""
        outcome = self._simulation.outcome()
        _add_reports(outcome.record, self._coordinator, self._plans)
        return simulated_run(
            self._scenario,
            outcome.record,
            self._coordinator,
            nodes="cpython",
            bus=outcome.bus,
            violations=outcome.violations,
            wall_s=self._wall_s,
            by_hand=True,
        )

    def _advance(self, seconds: float, over: Callable[[], bool]) -> None:
        """Let so much time pass at most. Raises `RunError` where the run cannot go on."""
        coordinator, simulation = self._coordinator, self._simulation

        def ended() -> bool:
            return over() or coordinator.stopped or coordinator.stuck is not None

        end_s, clock = simulation.kernel.now_ns / NS_PER_S + seconds, MonotonicClock()
        self._advances = True
        try:
            simulation.run_until(end_s, self._plans.look, ended)
        except BaseException:
            # What was under way, such as the next step of time, is lost.
            self._ended = "it was broken off within a step; begin another one"
            raise
        finally:
            self._advances = False
        self._wall_s += clock.now_s()
        if simulation.tipped:
            run = self.run_so_far
            raise LostError(run.reason, run)
        if coordinator.fault is not None:
            raise FaultError(coordinator.fault, self.run_so_far)
        if coordinator.stuck is not None:
            kind = FailedError if has_failed(coordinator) else StoppedError
            raise kind(coordinator.stuck, self.run_so_far)


def _schedule_signals(simulation: Simulation, scenario: Scenario, program: object) -> None:
    """Have the signals of a scenario come to its program at their times, and no others."""
    if not isinstance(program, TableProgram):
        return
    program.driver.in_virtual_time()
    for signal in scenario.signal:
        receive = partial(program.driver.receive, signal.name, signal.value)
        simulation.kernel.at(round(signal.time_s * NS_PER_S), PRIORITY_SIGNAL, receive)
