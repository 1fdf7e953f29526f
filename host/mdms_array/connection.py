"""A real or served table, and a thread that drives it while a program thinks."""

from argparse import Namespace
from collections.abc import Callable, Coroutine, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Thread, current_thread
from time import monotonic
from typing import Any, TypeVar

import numpy as np

from mdms_array.array import BelievedArray, believe
from mdms_array.figures import believed_run
from mdms_array.host import break_off, coordinator_of, estimates_of
from mdms_array.operation import check_array
from mdms_array.run import ERRORS, FailedError, Run, RunError, StoppedError, TimeLimitError
from mdms_array.source import Source, open_source
from mdms_array.table import BlockingTable, for_one_block, wait_for_ever
from mdms_host.can_link.link import AnyLink
from mdms_host.can_link.links import open_links
from mdms_host.clock import Clock
from mdms_host.commissioning.array_file import read_array
from mdms_host.coordination.operation import Operation, operate
from mdms_host.coordination.other_host import refuse_other_host
from mdms_host.coordination.recorder import Recorder
from mdms_host.programs.program import TableProgram
from mdms_host.programs.script import ScriptTask
from mdms_host.programs.table import Table
from mdms_host.programs.traffic.dispatch import ThreadExecutor
from mdms_model.errors import InputError, check_path

Result = TypeVar("Result")
#: Bring-up, and finding the parcels, take no longer, or something is wrong [s].
FOUND_S = 30.0
#: How often a waiting call looks whether the thread still lives [s].
LOOK_S = 0.1
#: The errors that end a table by hand, and not one call alone.
ENDS = ("fault", "lost", "stopped", "failed")


@for_one_block
def connect(
    array_file: str | Path | None = None,
    interface: str | None = None,
    channel: str | None = None,
    *,
    scenario: Source | None = None,
    **bus_options: Any,
) -> Iterator[BlockingTable]:
    """A real or served table; leaving the block stops it in order.

    `array_file` describes the table, as of `mdms run --array`. `scenario` has the parcels and the
    speed; without it the array file names one. `interface`, `channel` and `bus_options` (such as
    `bitrate`) are python-can's own; its environment and files give the rest.

    A thread drives the table from enter to exit, so the program may take its time. Raises
    `InputError`, `LinkError` where there is no way to the bus, and `RunError` for a table that does
    not come up. Leaving the block raises `FaultError` for a fault that no call has raised yet.
    """
    path = None if array_file is None else check_path("array_file", array_file)
    checked, _ = open_source(_scenario_of(path, scenario), wait_for_ever)
    given = {"interface": interface, "channel": channel} | bus_options
    options = Namespace(**{name: value for name, value in given.items() if value is not None})
    belief = believe(checked, path, options)
    check_array(belief, options, path)
    with open_links(options, belief.channels) as (link, clock):
        refuse_other_host(link, clock)
        driver = ThreadDriver(belief, link, clock)
        with driver.driven():
            yield BlockingTable(driver)


def _scenario_of(path: Path | None, scenario: Source | None) -> Source:
    if scenario is not None:
        return scenario
    if path is None:
        raise InputError("connect: neither an array file nor a scenario is given; give scenario=")
    named = read_array(path).table.scenario
    if named is None:
        raise InputError(
            f"{path}: names no scenario with the parcels; set array.scenario to a name or a file, "
            "or connect with scenario="
        )
    beside = path.parent / named
    return beside if beside.is_file() else named


class ThreadDriver:
    """Drives a table in a thread of its own; see `table.Driver`."""

    def __init__(self, belief: BelievedArray, link: AnyLink, clock: Clock) -> None:
        self._belief = belief
        self._link = link
        self._clock = clock
        self._coordinator = coordinator_of(
            belief.scenario, belief.cells, main=wait_for_ever, executor=ThreadExecutor()
        )
        program = self._coordinator.program
        assert isinstance(program, TableProgram)
        self._program = program
        self._recorder = Recorder(
            self._coordinator,
            lambda: estimates_of(self._coordinator, belief.scenario),
            look=self._look,
            flow=program.driver.take_flow,
        )
        self._asked: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._calls: list[tuple[ScriptTask[Any], Event]] = []
        self._operation: Operation | None = None
        self._error: BaseException | None = None
        self._thread = Thread(target=self._operate, name="table", daemon=True)

    @contextmanager
    def driven(self) -> Iterator[None]:
        """Bring the table up, and stop it in order at the end. Raises `RunError`."""
        self._thread.start()
        try:
            self._wait_for(lambda: self._program.began, FOUND_S)
            yield
        finally:
            self._asked.put(self._coordinator.stop)
            self._thread.join()
            failure = break_off(self._coordinator)
        if self._error is not None or self._coordinator.fault is not None:
            # It came while the script was thinking, and no call has said so.
            raise self._ended()
        if failure is not None:
            raise FailedError(failure, self.run_so_far)

    @property
    def table(self) -> Table:
        """The table as programs see it."""
        return self._program.table

    @property
    def is_within(self) -> bool:
        """See `table.Driver`."""
        return current_thread() is self._thread

    def call(
        self,
        routine: Callable[[Table], Coroutine[Any, Any, Result]],
        limit_s: float | None,
    ) -> Result:
        """Wait for the end of a coroutine; its result. Raises its errors and `RunError`."""
        done = Event()
        started: list[ScriptTask[Result]] = []

        def start() -> None:
            task = self.table.start(routine(self.table))
            task.heed()
            started.append(task)
            self._calls.append((task, done))

        def cancel() -> None:
            for task in started:
                task.cancel()

        self._asked.put(start)
        try:
            self._wait_for(done.is_set, limit_s, done, started)
        except BaseException:
            self._asked.put(cancel)
            raise
        result: Result = started[0].result()
        return result

    @property
    def run_so_far(self) -> Run:
        """The run up to now, as it is believed."""
        record = self._recorder.record(list(self._link.incidents))
        # The coordinator belongs to the thread; the record is too long for a cycle.
        return self._in_thread(
            lambda: believed_run(
                self._belief.scenario, record, self._coordinator, fault=self._fault()
            )
        )

    def _in_thread(self, work: Callable[[], Result]) -> Result:
        """Do something short between two cycles, and return its result. Raises its errors."""
        if self.is_within:
            return work()
        done: Future[Result] = Future()

        def do() -> None:
            try:
                done.set_result(work())
            except Exception as error:
                done.set_exception(error)

        self._asked.put(do)
        while not done.done():
            if not self._thread.is_alive():
                return work()
            wait((done,), LOOK_S)
        return done.result()

    def _fault(self) -> str | None:
        """Why the table cannot go on."""
        if self._error is not None:
            return str(self._error) or type(self._error).__name__
        # The ending names the parts that were held up, too.
        told = None if self._operation is None else self._operation.fault
        return told or self._coordinator.fault

    def _operate(self) -> None:
        """The work of the thread from beginning to end."""
        try:
            self._operation = operate(
                self._coordinator, self._link, self._clock, participant=self._recorder
            )
        except BaseException as error:
            self._error = error

    def _wait_for(
        self,
        over: Callable[[], bool],
        limit_s: float | None,
        event: Event | None = None,
        tasks: Sequence[ScriptTask[Any]] = (),
    ) -> None:
        """Wait at most so long for tasks. Raises `RunError` where the table does not go on."""
        end_s = np.inf if limit_s is None else monotonic() + limit_s
        while not over():
            if self._operation is not None or self._error is not None:
                raise self._ended()
            if monotonic() > end_s:
                where = (f"it waits in {task.where}" for task in tasks)
                told = ": ".join((f"not done within {limit_s:g} s", *where))
                raise TimeLimitError(told, self.run_so_far)
            (event or Event()).wait(LOOK_S)

    def _ended(self) -> RunError:
        run = self.run_so_far
        kind = ERRORS[run.status] if run.status in ENDS else StoppedError
        return kind(run.reason if run.status in ENDS else "the table has stopped", run)

    def _look(self, _time_s: float) -> None:
        """Start the requested coroutines, and report each that is done; in the thread."""
        while True:
            try:
                self._asked.get_nowait()()
            except Empty:
                break
        for task, done in self._calls:
            # A task that was broken off has no result: its call waits for the end of the run.
            if task.done and not task.cancelled:
                done.set()
        self._calls = [(task, done) for task, done in self._calls if not task.done]
