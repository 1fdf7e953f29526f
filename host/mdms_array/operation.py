"""A program on a real or served array, from the first look at its bus to a recorded run."""

from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, replace
from io import TextIOWrapper
from pathlib import Path
from typing import Protocol

from mdms_array.array import BelievedArray
from mdms_array.bus_load import check_load
from mdms_array.checks import refuse_tipping
from mdms_array.figures import believed_run, broken_off
from mdms_array.host import coordinator_of, estimates_of, refuse_unstoppable
from mdms_array.recording import PlanLog
from mdms_array.run import Run
from mdms_host.can_link.bus_log import LogWriter, open_log
from mdms_host.can_link.link import AnyLink, DeviceGoneError, LinkCounts
from mdms_host.can_link.links import open_links
from mdms_host.can_link.recent import Recent
from mdms_host.clock import Clock
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.operation import Ending, OnEvent, Operation, operate
from mdms_host.coordination.other_host import refuse_other_host
from mdms_host.coordination.recorder import Recorder
from mdms_host.programs.program import Main, TableProgram
from mdms_host.programs.traffic.dispatch import ThreadExecutor
from mdms_model.errors import Error, InputError
from mdms_model.run.folder import BUS_LOG
from mdms_protocol.codecs.frame import Frame

LogFrame = Callable[[Frame, float, int], object]
#: While it is entered, its value gives the interrupt that asks for the end, or None.
Interrupted = Callable[[], AbstractContextManager[Callable[[], KeyboardInterrupt | None]]]


class Keeps(Protocol):
    """Keeps the last minute of a run in `recent`, and writes reports of it.

    `counts` returns the counts of the link.
    """

    recent: Recent | None
    counts: Callable[[], LinkCounts | None]

    def attend(self, now_s: float) -> None:
        """Time has passed."""

    def after_fault(self, now_s: float, reason: str) -> None:
        """The run has a fault."""


class BrokenOffError(Error):
    """A defect broke the run off; the array is off."""


def check_array(belief: BelievedArray, options: Namespace, array_file: Path | None) -> None:
    """Raise `InputError` for a scenario that the array does not bear."""
    if array_file is not None:
        _refuse_tipping_on(belief, array_file)
    check_load(belief.scenario, options)
    refuse_unstoppable(belief.scenario)


def _refuse_tipping_on(belief: BelievedArray, array_file: Path) -> None:
    """Raise `InputError` for a parcel that fits the scenario's table, but not the file's."""
    try:
        refuse_tipping(belief.scenario)
    except InputError as error:
        where = f"{belief.scenario.title!r} on {array_file}"
        raise InputError(f"{where}: {error}") from None


def operate_array(
    belief: BelievedArray,
    options: Namespace,
    limit_s: float,
    main: Main | None = None,
    *,
    report: OnEvent,
    interrupted: Interrupted,
    log_frame: LogFrame = lambda _frame, _time_s, _bus: None,
    keep: Keeps | None = None,
) -> tuple[Operation, Run]:
    """Bring an array up, run its program, turn everything off; the ending, and the believed run.

    `options` are python-can's, `report` is given events with their times and kinds. `keep` keeps
    the last minute, and is told of faults. Raises `LinkError` for a bus that cannot be opened; a
    bus that goes away later ends the run. Raises OtherHostError, and `BrokenOffError` for a defect.
    """
    scenario = belief.scenario
    coordinator = coordinator_of(scenario, belief.cells, main=main, executor=ThreadExecutor())
    plans = PlanLog(coordinator)

    def look(time_s: float) -> None:
        plans.look(time_s)
        if keep is not None:
            keep.attend(time_s)

    recorder = Recorder(
        coordinator,
        lambda: estimates_of(coordinator, scenario),
        log_frame,
        look=look,
        recent=None if keep is None else keep.recent,
        flow=flow_of(coordinator),
    )
    with open_links(options, belief.channels) as (link, clock), reported(keep, clock):
        if keep is not None:
            keep.counts = lambda: link.counts
        refuse_other_host(link, clock)
        watch_program(coordinator, link, clock)
        try:
            with interrupted() as pressed:
                operation = operate(
                    coordinator,
                    link,
                    clock,
                    limit_s,
                    report,
                    participant=recorder,
                    interrupted=pressed,
                )
        except DeviceGoneError as error:
            operation = Operation(Ending.DEVICE_GONE, clock.now_s(), str(error), link.counts)
        if keep is not None:
            keep.attend(clock.now_s())
            if operation.ending in (Ending.FAULT, Ending.DEVICE_GONE):
                keep.after_fault(clock.now_s(), str(operation.fault))
        record = recorder.record(link.incidents)
    record.plans = plans.plans
    run = believed_run(
        scenario,
        record,
        coordinator,
        fault=operation.fault,
        late=operation.ending is not Ending.DONE,
        interrupted=operation.interrupt is not None,
    )
    run = broken_off(run, coordinator)
    of_operation = {
        "ending": str(operation.ending),
        "duration_s": operation.duration_s,
        "link": asdict(operation.link),
        "node_ids": [cell.node_id for cell in coordinator.cells],
    }
    return operation, replace(run, figures={**run.figures, **of_operation})


def flow_of(coordinator: Coordinator) -> Callable[[], list[tuple[str, str | None]]]:
    """The parcels that the program has seen come and leave, for a `Recorder`."""
    program = coordinator.program
    return program.driver.take_flow if isinstance(program, TableProgram) else list


@contextmanager
def reported(keep: Keeps | None, clock: Clock) -> Iterator[None]:
    """Have a report written of a run that its device or a defect ends.

    Raises `BrokenOffError` for a defect, when the array is off.
    """
    try:
        yield
    except DeviceGoneError as error:
        if keep is not None:
            keep.after_fault(clock.now_s(), str(error))
        raise
    except (Error, OSError):
        raise
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        if keep is not None:
            keep.attend(clock.now_s())
            keep.after_fault(clock.now_s(), f"broken off: {what}")
        raise BrokenOffError(f"the run was broken off, and the array turned off: {what}") from error


@contextmanager
def bus_log_in(
    folder: Path, belief: BelievedArray, failed: Callable[[OSError], object]
) -> Iterator[LogFrame]:
    """Yield the function that logs a frame of an array's buses into a run folder.

    Where the disk takes no more the log ends, and `failed(error)` is called.
    """
    with TextIOWrapper(open_log(folder / BUS_LOG, failed), "ascii", newline="\n") as log:
        yield LogWriter(log, len(belief.scenario.array.buses) or 1).on_frame


def watch_program(coordinator: Coordinator, link: AnyLink, clock: Clock) -> None:
    """Name a program that keeps the table waiting as the cause of delays, in real time."""
    program = coordinator.program
    if clock.is_real and isinstance(program, TableProgram):
        program.driver.watch(
            clock.now_s,
            lambda where, took_s: link.delays.on_blocked(where, took_s, clock.now_s()),
        )
