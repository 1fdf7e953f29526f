"""`mdms run` with a page or a line: programs are started and stopped from outside."""

from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from math import inf
from typing import Any

from mdms_array.array import BelievedArray
from mdms_array.bus_load import timing_of
from mdms_array.figures import raise_for_end
from mdms_array.host import coordinator_of, estimates_of, layout_of, parcels_of
from mdms_array.operation import reported, watch_program
from mdms_array.run import RunError
from mdms_host.can_link.delays import punctual
from mdms_host.can_link.link import AnyLink, DeviceGoneError, drive
from mdms_host.can_link.links import open_links
from mdms_host.can_link.returning import ReturningLink, open_returning
from mdms_host.cli.exits import CommandError, ExitCode, interrupted
from mdms_host.cli.kept import Kept, keeping
from mdms_host.cli.line import has_line, opened_line
from mdms_host.cli.options import AGAIN
from mdms_host.cli.streams import say
from mdms_host.clock import Clock
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.operation import all_off
from mdms_host.coordination.other_host import refuse_other_host
from mdms_host.coordination.run_state import Phase
from mdms_host.line.attached import Line, LineError
from mdms_host.line.machine import Recipes
from mdms_host.line.packml import State
from mdms_host.page.bus_watch import BusWatch
from mdms_host.page.live import LiveTable
from mdms_host.page.run_slot import RunSlot
from mdms_host.programs.program import Main, TableProgram
from mdms_host.programs.traffic.dispatch import ThreadExecutor
from mdms_model.scenario.scenario import Scenario


class Attendants:
    """The page and the line of a table; called as often as its driver can.

    `failure` is why the line has ended, None as long as it has not.
    """

    def __init__(self, table: LiveTable) -> None:
        self.failure: LineError | None = None
        self.page: Callable[[], object] = lambda: None
        self.line: Line | None = None
        self._table = table

    def __call__(self) -> None:
        """Carry out commands, and show snapshots that are due."""
        self.page()
        if self.line is None or self.failure is not None:
            return
        try:
            told = self.line.attend()
        except LineError as error:
            self.failure = error
        else:
            if told and self.page is _nobody:
                # What the page would show is said on stderr alone.
                self._table.take_messages()


def _nobody() -> None:
    pass


@contextmanager
def attendants(
    table: LiveTable,
    slot: RunSlot,
    scenario: Scenario,
    arguments: Namespace,
    recipes: Recipes[Any],
) -> Iterator[Attendants]:
    """The page and the line of a table, as the options have them. Raises PageError, LineError."""
    attend = Attendants(table)
    attend.page = _nobody
    with ExitStack() as opened:
        if arguments.page is not None:
            # The page is an extra.
            from mdms_host.cli.live_page import opened_page  # noqa: PLC0415

            attend.page = opened.enter_context(opened_page(table, arguments)).attend
        if has_line(arguments):
            attend.line = opened.enter_context(
                opened_line(slot, scenario, arguments, table, recipes)
            )
        yield attend


#: A host that does nothing for so long was suspended: no busy machine keeps it away that long [s].
SUSPENDED_S = 2.0
#: How often somebody looks whether a report is due [s].
_LOOK_S = 0.01


class Watched:
    """Has the beliefs of a slot's hosts kept, and a report written after a fault or an abort."""

    def __init__(self, kept: Kept, slot: RunSlot, scenario: Scenario) -> None:
        self._kept = kept
        self._slot = slot
        self._scenario = scenario
        self._due_s = -inf
        self._faulted: Coordinator | None = None
        self._aborted = False

    def look(self, now_s: float, line: Line | None) -> None:
        """Look after it; returns at once most of the time."""
        if 0.0 <= self._due_s - now_s <= _LOOK_S:
            return
        self._due_s = now_s + _LOOK_S
        coordinator, kept = self._slot.coordinator, self._kept
        if coordinator is not None and kept.recent is not None and kept.recent.wants_belief(now_s):
            kept.recent.believe(now_s, estimates_of(coordinator, self._scenario))
        if coordinator is not None and coordinator is not self._faulted and coordinator.fault:
            self._faulted = coordinator
            kept.after_fault(now_s, coordinator.fault)
        if line is not None:
            states = line.machine.states
            before, self._aborted = self._aborted, states.state in (State.ABORTING, State.ABORTED)
            if self._aborted and not before:
                kept.after_fault(now_s, f"Aborted: {states.reason}")
        kept.attend(now_s)


def show_array(
    recipes: Recipes[tuple[BelievedArray, Main | None]], arguments: Namespace
) -> ExitCode:
    """Run the program again and again, as that is asked for, until Ctrl-C or the time limit.

    With a line the program waits for Reset and Start. Raises `CommandError` for a program that has
    ended with a fault. Raises `RunError` for a program that has failed or exceeds the time limit,
    unless a person has taken it over on the page. Also raises NoBusError, DeviceGoneError,
    PageError, LineError and OtherHostError.
    """
    belief, main = recipes.first
    layout = layout_of(belief.scenario, belief.cells)
    start = recipes.starter(_coordinator_of)
    with (
        keeping(belief.scenario, layout, arguments, main=main, array_file=arguments.array) as kept,
        _opened(belief, arguments) as (link, clock),
    ):
        refuse_other_host(link, clock)
        slot, table = _slot_and_table(belief, start, link, clock, kept)
        kept.counts = lambda: link.counts
        jobs = {name: (job.scenario, own) for name, (job, own) in recipes.jobs.items()}
        kept.run_by(jobs, lambda: recipes.running)
        if isinstance(link, ReturningLink):
            _tie(slot, link)
        watched = Watched(kept, slot, belief.scenario)
        with (
            interrupted(kept.on_hangup) as pressed,
            attendants(table, slot, belief.scenario, arguments, recipes) as attend,
        ):
            if not has_line(arguments):
                slot.start()
            incidents, attended_s = 0, clock.now_s()
            verdict = Verdict(slot, table, recipes)

            def attended() -> None:
                nonlocal incidents, attended_s
                # Noted before anything else: the host may be suspended in the middle of this.
                now_s = clock.now_s()
                away_s, attended_s = now_s - attended_s, now_s
                if away_s > SUSPENDED_S and attend.line is not None:
                    attend.line.machine.on_suspended(away_s)
                for time_s, text in link.incidents[incidents:]:
                    table.note("link", text, time_s, trouble=True)
                incidents = len(link.incidents)
                attend()
                watched.look(clock.now_s(), attend.line)
                verdict.look()

            def over() -> bool:
                attended()
                limited = arguments.limit is not None and clock.now_s() > arguments.limit
                if limited:
                    verdict.at_limit()
                return limited or attend.failure is not None or pressed() is not None

            with reported(kept, clock):
                _drive_and_end(slot, link, clock, over, attended)
    if attend.failure is not None:
        raise attend.failure
    run = slot.coordinator
    if run is not None and run.fault is not None:
        raise CommandError(run.fault, ExitCode.NODE_FAULT)
    verdict.raise_error()
    return ExitCode.OK


class Verdict:
    """How the program of a slot has ended, as of a run without a page or a line.

    It is judged when it finishes, and else at the time limit. A program that a person has taken
    over or stopped is not judged, nor one that its line keeps standing.
    """

    def __init__(
        self, slot: RunSlot, table: LiveTable, recipes: Recipes[tuple[BelievedArray, Main | None]]
    ) -> None:
        self._slot = slot
        self._table = table
        self._recipes = recipes
        self._finished: Coordinator | None = None
        self._judged: tuple[Coordinator, RunError | None] | None = None

    def look(self) -> None:
        """Judge a program that has finished just now."""
        run = self._slot.coordinator
        if run is None or run is self._finished or not run.finished:
            return
        program = run.program
        # Orders of the plant may go on after the program's own.
        if not (isinstance(program, TableProgram) and program.table.orders.is_any_under_way):
            self._finished = run
            self._judge(run, late=False)

    def at_limit(self) -> None:
        """Judge a program that the time limit ends."""
        run = self._slot.coordinator
        if run is not None and not (run.stopped or run.finished or run.phase is Phase.KEEPING):
            self._judge(run, late=not run.endless)

    def raise_error(self) -> None:
        """Raise the `RunError` of the last program, if it has one."""
        run = self._slot.coordinator
        if run is None or run is self._table.taken_over:
            return
        if run.stuck is not None:
            self._judge(run, late=False)
        judged, error = self._judged or (None, None)
        if judged is run and error is not None:
            raise error

    def _judge(self, run: Coordinator, *, late: bool) -> None:
        self._judged = run, None
        try:
            raise_for_end(self._recipes.jobs[self._recipes.running][0].scenario, run, late=late)
        except RunError as error:
            self._judged = run, error


def _opened(
    belief: BelievedArray, arguments: Namespace
) -> AbstractContextManager[tuple[AnyLink, Clock]]:
    """The way to the table, as `--device-gone` has it. Raises NoBusError."""
    returns = arguments.device_gone == AGAIN
    return (open_returning if returns else open_links)(arguments, belief.channels)


def _coordinator_of(job: tuple[BelievedArray, Main | None]) -> Coordinator:
    belief, main = job
    return coordinator_of(belief.scenario, belief.cells, main=main, executor=ThreadExecutor())


def _slot_and_table(
    belief: BelievedArray, start: Callable[[], Coordinator], link: AnyLink, clock: Clock, kept: Kept
) -> tuple[RunSlot, LiveTable]:
    """The host's place, where `start` begins every run, and its part of a page."""

    def make() -> Coordinator:
        coordinator = start()
        watch_program(coordinator, link, clock)
        return coordinator

    layout = layout_of(belief.scenario, belief.cells)
    timing = timing_of(belief.scenario.wire)
    watch = BusWatch(layout, timing.silence_s)
    slot = RunSlot(make, layout.bus_count, watch, kept.recent)

    def report(time_s: float, kind: str, text: str) -> None:
        say(f"{time_s:8.3f} s  {text}")
        kept.event(time_s, kind, text)

    def on_cycle(late_s: float) -> None:
        table.on_cycle(late_s)
        if kept.recent is not None:
            kept.recent.on_cycle(late_s)

    table = LiveTable(
        belief.scenario,
        layout,
        parcels_of(belief.scenario),
        slot=slot,
        watch=watch,
        now_s=clock.now_s,
    )
    table.report, table.error_frames = report, lambda: link.counts.error_frames
    slot.on_cycle = on_cycle
    return slot, table


def _tie(slot: RunSlot, link: ReturningLink) -> None:
    """Have a run end when the device is gone, and a stop wait until it is there again."""
    link.on_gone, link.at_rest = slot.fail, lambda: not slot.busy
    slot.is_there = lambda: link.is_there


def _drive_and_end(
    slot: RunSlot,
    link: AnyLink,
    clock: Clock,
    over: Callable[[], bool],
    attended: Callable[[], None],
) -> None:
    """Drive the array until it is over, then turn it off in order, whatever ended it."""

    def ended() -> bool:
        attended()
        return not slot.busy

    try:
        with punctual(clock):
            try:
                drive(slot, link, clock, over)
            except DeviceGoneError:
                if link.leave_gone():
                    _stop(slot, link, clock, ended)
                raise
            except Exception:
                # A defect of the program's own leaves a host that can still brake.
                _stop(slot, link, clock, ended)
                raise
            _stop(slot, link, clock, ended)
    except DeviceGoneError:
        raise
    except BaseException:
        if slot.busy:
            all_off(link)
        raise


def _stop(slot: RunSlot, link: AnyLink, clock: Clock, ended: Callable[[], bool]) -> None:
    """Turn the array off in order, on the buses whose devices are there.

    Raises DeviceGoneError after that where one has gone meanwhile.
    """
    if not slot.busy:
        return
    slot.stop()
    gone: DeviceGoneError | None = None
    while slot.busy:
        try:
            drive(slot, link, clock, ended)
        except DeviceGoneError as error:
            gone = gone or error
            if not link.leave_gone():
                raise
    if gone is not None:
        raise gone
