"""`mdms run`: the coordinator on a real or served array."""

import json
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace

from mdms_array.array import Belief, believe
from mdms_array.checks import check_load, refuse_tipping
from mdms_array.connection import open_links
from mdms_array.extras import PAGE, RECORDING, require
from mdms_array.figures import believed_run
from mdms_array.host import coordinator_of, estimates_of, refuse_unstoppable
from mdms_array.recording import PlanLog, keep_run, lasting
from mdms_array.run import Run
from mdms_array.source import open_program
from mdms_host.can_link.bus_log import LogWriter
from mdms_host.can_link.link import DeviceGoneError
from mdms_host.cli.exits import CommandError, Exit, exit_of, interrupted
from mdms_host.cli.files import writing
from mdms_host.cli.streams import say
from mdms_host.coordination.operation import Ending, Operation, operate
from mdms_host.coordination.other_host import refuse_other_host
from mdms_host.coordination.recorder import Recorder
from mdms_host.programs.program import Main
from mdms_host.programs.traffic.planning import ThreadDesk
from mdms_model.errors import InputError
from mdms_model.run.folder import BUS_LOG, fresh_folder
from mdms_protocol.codecs.frame import Frame

#: What the bring-up may take of a run's time limit, which else is the scenario's duration.
BRING_UP_S = 10.0
#: Faults of the way to the cells, and not of a cell.
NO_DEVICE = (Ending.NO_CELLS, Ending.DEVICE_GONE)


def run(arguments: Namespace) -> int:
    """Bring the array up, run the program, turn everything off, and report how it went."""
    if arguments.page is not None:
        require(PAGE, "mdms run --page")
        if arguments.out is not None or arguments.json:
            raise CommandError(
                "--page: a run that a person starts and stops is not kept; leave --out and --json "
                "out",
                Exit.USAGE,
            )
    if arguments.out is not None:
        require(RECORDING, "mdms run --out")
    overrides = [*arguments.overrides, "run.fidelity=firmware"]
    if getattr(arguments, "bitrate", None):
        overrides.append(f"wire.bitrate={arguments.bitrate}")
    scenario, main = open_program(arguments.program, overrides)
    belief = believe(scenario, arguments.array, arguments)
    _check(belief, arguments)
    if arguments.page is not None:
        # The page is an extra.
        from mdms_host.cli.live_page import show_array  # noqa: PLC0415

        return show_array(belief, arguments, main)
    if arguments.limit is None:
        arguments.limit = scenario.run.duration_s + BRING_UP_S
    if arguments.out is None:
        operation, ended = _operate(belief, arguments, main)
    else:
        operation, ended = _operate_and_keep(belief, arguments, main)
    if arguments.json:
        print(json.dumps(ended.figures))
    else:
        if counts := str(operation.link):
            say(f"frames: {counts}")
        print(f"{scenario.title}: {operation.ending} after {operation.duration_s:.1f} s")
    return _verdict(operation, ended)


def _verdict(operation: Operation, ended: Run) -> Exit:
    """How the command ends. Raises what ended the run, if it has not ended well."""
    if operation.interrupt is not None:
        raise operation.interrupt
    if operation.ending in NO_DEVICE:
        raise CommandError(ended.reason, Exit.NO_DEVICE)
    ended.raise_for_status()
    return Exit.OK


def _check(belief: Belief, arguments: Namespace) -> None:
    """Raises `InputError` for what the table does not bear; warns of what it does not state."""
    if arguments.array is not None:
        _refuse_tipping_on(belief, arguments)
    check_load(belief.scenario, arguments)
    refuse_unstoppable(belief.scenario)
    if arguments.array is not None and belief.scenario.stop is None:
        say(
            f"mdms: {arguments.array} does not say which parcels the emergency stop holds; add "
            "[stop] with form, mass_kg and speed_m_s"
        )


def _refuse_tipping_on(belief: Belief, arguments: Namespace) -> None:
    """Raises `InputError` for a parcel that fits the scenario's table, but not the file's."""
    try:
        refuse_tipping(belief.scenario)
    except InputError as error:
        where = f"{belief.scenario.title!r} on {arguments.array}"
        raise InputError(f"{where}: {error}") from None


@contextmanager
def _broken_off() -> Iterator[None]:
    """Says of an error that nobody expected what became of the array."""
    try:
        yield
    except Exception as error:
        if exit_of(error) is not None:
            raise
        what = f"{type(error).__name__}: {error}"
        raise CommandError(
            f"the run was broken off, and the array turned off: {what}", Exit.FAILURE
        ) from error


def _operate_and_keep(
    belief: Belief, arguments: Namespace, main: Main | None
) -> tuple[Operation, Run]:
    """Operate, and keep what was seen in a run folder, however it ended."""
    with fresh_folder(arguments.out) as folder:
        with (folder / BUS_LOG).open("w") as log:
            writer = LogWriter(log, len(belief.scenario.array.buses) or 1)
            operation, ended = _operate(belief, arguments, main, writer.on_frame)
        ended = replace(ended, figures={**ended.figures, "run": str(arguments.out)})
        lasted = lasting(belief.scenario, ended.duration_s)
        with writing(arguments.out):
            keep_run(folder, lasted, ended.record, dict(ended.figures))
    return operation, ended


def _operate(
    belief: Belief,
    arguments: Namespace,
    main: Main | None,
    log_frame: Callable[[Frame, float, int], object] = lambda _frame, _time_s, _bus: None,
) -> tuple[Operation, Run]:
    """Operate the array; how it ended, and what it came to."""
    scenario = belief.scenario
    coordinator = coordinator_of(scenario, belief.cells, main=main, desk=ThreadDesk())
    plans = PlanLog(coordinator)
    recorder = Recorder(
        coordinator, lambda: estimates_of(coordinator, scenario), log_frame, look=plans.look
    )
    # A bus that cannot be opened raises; one that goes away later ends the run.
    with open_links(arguments, belief.channels) as (link, clock), _broken_off():
        refuse_other_host(link, clock)
        try:
            with interrupted() as pressed:
                operation = operate(
                    coordinator,
                    link,
                    clock,
                    arguments.limit,
                    _print_event,
                    participant=recorder,
                    interrupted=pressed,
                )
        except DeviceGoneError as error:
            operation = Operation(Ending.DEVICE_GONE, clock.now_s(), str(error), link.counts)
        record = recorder.record(link.incidents)
    record.plans = plans.plans
    ended = believed_run(
        scenario,
        record,
        coordinator,
        fault=operation.fault,
        late=operation.ending is not Ending.DONE,
        interrupted=operation.interrupt is not None,
    )
    of_operation = {
        "ending": str(operation.ending),
        "duration_s": operation.duration_s,
        "link": asdict(operation.link),
        "node_ids": [cell.node_id for cell in coordinator.cells],
    }
    return operation, replace(ended, figures={**ended.figures, **of_operation})


def _print_event(time_s: float, text: str) -> None:
    say(f"{time_s:8.3f} s  {text}")
