"""`mdms run`: the coordinator on a real or served array."""

import json
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from math import isnan

from mdms_host.cli.array.bus import open_link
from mdms_host.cli.exits import CommandError, Exit, exit_of
from mdms_host.cli.scenario.coordination import coordinator_of, estimates_of, goals_by_parcel
from mdms_host.cli.scenario.gain import open_program
from mdms_host.cli.streams import say
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.operation import Ending, Operation, operate
from mdms_host.coordination.other_host import refuse_other_host
from mdms_host.motion.goal import Goal
from mdms_host.motion.outcome import GoalOutcome, missed_text, outcome_of
from mdms_model.scenario.scenario import Scenario

#: What the bring-up may take of a run's time limit, which else is the scenario's duration.
BRING_UP_S = 10.0
#: How the command ends by how the run has.
EXITS = {
    Ending.DONE: Exit.OK,
    Ending.TIME_LIMIT: Exit.TIME_LIMIT,
    Ending.FAULT: Exit.NODE_FAULT,
    Ending.NO_CELLS: Exit.NO_DEVICE,
}


def run(arguments: Namespace) -> int:
    """Bring the array up, run the program, turn everything off, and report how it went."""
    scenario = open_program(arguments.program, [*arguments.overrides, "run.fidelity=firmware"])
    coordinator = coordinator_of(scenario)
    with open_link(arguments) as (link, clock), _broken_off():
        refuse_other_host(link, clock)
        limit_s = arguments.limit or scenario.run.duration_s + BRING_UP_S
        operation = operate(coordinator, link, clock, limit_s, _print_event)
    goals = goals_of(scenario, coordinator)
    if arguments.json:
        print(json.dumps(_figures(scenario, coordinator, operation, goals)))
    else:
        print(f"{scenario.title}: {operation.ending} after {operation.duration_s:.1f} s")
    return _verdict(operation, missed_text(goals))


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


def _print_event(time_s: float, text: str) -> None:
    say(f"{time_s:8.3f} s  {text}")


def _figures(
    scenario: Scenario,
    coordinator: Coordinator,
    operation: Operation,
    goals: list[GoalOutcome],
) -> dict[str, object]:
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
        "fault": operation.fault,
        "parcels": parcels,
        "goals": [asdict(outcome) for outcome in goals],
    }


def goals_of(scenario: Scenario, coordinator: Coordinator) -> list[GoalOutcome]:
    """How far from its goal each parcel that is steered to one is believed to have ended."""
    goals = zip(scenario.parcel, goals_by_parcel(scenario), strict=True)
    return [_outcome(coordinator, parcel.name, goal) for parcel, goal in goals if goal is not None]


def _outcome(coordinator: Coordinator, name: str, goal: Goal) -> GoalOutcome:
    believed = coordinator.estimate(name)
    pose = None if believed is None else (believed.x_m, believed.y_m, believed.yaw_rad)
    return outcome_of(name, goal, pose, coordinator.arrived_s.get(name))


def _verdict(operation: Operation, missed: str | None) -> int:
    if operation.interrupt is not None:
        raise operation.interrupt
    code = EXITS[operation.ending]
    if code is not Exit.OK:
        raise CommandError(operation.fault or missed or "the time limit has passed", code)
    return code
