"""`mdms run`: the coordinator on a real or served array."""

import json
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from math import isnan
from typing import Any

from mdms_array.array import Belief, believe
from mdms_array.checks import check_load, refuse_tipping
from mdms_array.connection import open_links
from mdms_array.extras import PAGE, RECORDING, require
from mdms_array.host import coordinator_of, estimates_of, has_failed, refuse_unstoppable, waits_text
from mdms_array.recording import PlanLog, keep_run, lasting
from mdms_array.source import open_program
from mdms_host.can_link.link import DeviceGoneError
from mdms_host.cli.exits import CommandError, Exit, exit_of
from mdms_host.cli.files import writing
from mdms_host.cli.records.bus_log import LogWriter
from mdms_host.cli.signals import interrupted
from mdms_host.cli.streams import say
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.operation import Ending, Operation, operate
from mdms_host.coordination.other_host import refuse_other_host
from mdms_host.coordination.recorder import Recorder
from mdms_host.motion.goal import Goal
from mdms_host.motion.outcome import GoalOutcome, missed_text, outcome_of
from mdms_host.programs.traffic.planning import ThreadDesk
from mdms_model.errors import InputError
from mdms_model.run.folder import BUS_LOG, fresh_folder
from mdms_model.scenario.scenario import Scenario

#: What the bring-up may take of a run's time limit, which else is the scenario's duration.
BRING_UP_S = 10.0
#: How the command ends by how the run has.
EXITS = {
    Ending.DONE: Exit.OK,
    Ending.TIME_LIMIT: Exit.TIME_LIMIT,
    Ending.STUCK: Exit.TIME_LIMIT,
    Ending.FAULT: Exit.NODE_FAULT,
    Ending.NO_CELLS: Exit.NO_DEVICE,
    Ending.DEVICE_GONE: Exit.NO_DEVICE,
}


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
        from mdms_host.cli.array.live import show  # noqa: PLC0415

        return show(belief, arguments, main)
    coordinator = coordinator_of(belief.scenario, belief.cells, main=main, desk=ThreadDesk())
    if arguments.limit is None:
        arguments.limit = scenario.run.duration_s + BRING_UP_S
    if arguments.out is None:
        operation, _ = _operate(coordinator, belief, arguments)
        figures = _figures(belief.scenario, coordinator, operation)
    else:
        operation, figures = _operate_and_keep(belief, coordinator, arguments)
    if arguments.json:
        print(json.dumps(figures))
    else:
        if counts := str(operation.link):
            say(f"frames: {counts}")
        print(f"{scenario.title}: {operation.ending} after {operation.duration_s:.1f} s")
    missed = missed_text(goals_of(belief.scenario, coordinator))
    return _verdict(operation, coordinator, missed)


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
    belief: Belief, coordinator: Coordinator, arguments: Namespace
) -> tuple[Operation, dict[str, Any]]:
    """Operate, and keep what was seen in a run folder, however it ended."""
    plans = PlanLog(coordinator)
    with fresh_folder(arguments.out) as folder:
        with (folder / BUS_LOG).open("w") as log:
            recorder = Recorder(
                coordinator,
                lambda: estimates_of(coordinator, belief.scenario),
                LogWriter(log, len(belief.scenario.array.buses) or 1).on_frame,
                look=plans.look,
            )
            operation, incidents = _operate(coordinator, belief, arguments, recorder)
        figures = _figures(belief.scenario, coordinator, operation)
        figures["node_ids"] = [cell.node_id for cell in coordinator.cells]
        figures["run"] = str(arguments.out)
        record = recorder.record(incidents)
        record.plans = plans.plans
        lasted = lasting(belief.scenario, float(record.time_s[-1]))
        with writing(arguments.out):
            keep_run(folder, lasted, record, figures)
    return operation, figures


def _operate(
    coordinator: Coordinator,
    belief: Belief,
    arguments: Namespace,
    recorder: Recorder | None = None,
) -> tuple[Operation, list[tuple[float, str]]]:
    """Operate the array; how it ended, and what the link met meanwhile."""
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
        return operation, link.incidents


def _print_event(time_s: float, text: str) -> None:
    say(f"{time_s:8.3f} s  {text}")


def _figures(scenario: Scenario, coordinator: Coordinator, operation: Operation) -> dict[str, Any]:
    names = ("x_m", "y_m", "yaw_rad")
    parcels = [
        {"name": parcel.name, "estimate": dict(zip(names, belief.tolist(), strict=True))}
        for parcel, belief in zip(scenario.parcel, estimates_of(coordinator, scenario), strict=True)
        if not any(map(isnan, belief))
    ]
    return {
        "title": scenario.title,
        "ending": str(operation.ending),
        "duration_s": operation.duration_s,
        "fault": operation.fault or coordinator.lost or coordinator.stuck,
        "lost_cells": sorted(coordinator.lost_cells),
        "pauses": coordinator.pauses,
        "link": asdict(operation.link),
        "parcels": parcels,
        "goals": [asdict(outcome) for outcome in goals_of(scenario, coordinator)],
    }


def goals_of(scenario: Scenario, coordinator: Coordinator) -> list[GoalOutcome]:
    """How far from its goal each parcel that is steered to one is believed to have ended."""
    goals = coordinator.goals
    names = [parcel.name for parcel in scenario.parcel if parcel.name in goals]
    return [_outcome(coordinator, name, goals[name]) for name in names]


def _outcome(coordinator: Coordinator, name: str, goal: Goal) -> GoalOutcome:
    believed = coordinator.estimate(name)
    pose = None if believed is None else (believed.x_m, believed.y_m, believed.yaw_rad)
    return outcome_of(name, goal, pose, coordinator.arrived_s.get(name))


def _verdict(operation: Operation, coordinator: Coordinator, missed: str | None) -> int:
    if operation.interrupt is not None:
        raise operation.interrupt
    if operation.fault is None and coordinator.lost is not None:
        raise CommandError(coordinator.lost, Exit.FAILURE)
    code = EXITS[operation.ending]
    if code is not Exit.OK:
        late = f"the time limit has passed{waits_text(coordinator)}"
        text = operation.fault or missed or coordinator.stuck or late
        raise CommandError(text, Exit.FAILURE if has_failed(coordinator) else code)
    return code
