"""`mdms run`: the coordinator on a real or served array."""

import json
from argparse import Namespace
from math import isnan

from mdms_host.cli.array.bus import open_link
from mdms_host.cli.console import say
from mdms_host.cli.exits import INTERRUPTED, CommandError, Exit
from mdms_host.cli.scenario.coordination import coordinator_of, estimates_of
from mdms_host.cli.scenario.gain import open_program
from mdms_host.cli.scenario.load import warn_of_load
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.operation import Ending, Operation, operate
from mdms_model.scenario.scenario import Scenario

#: How the command ends by how the run has.
EXITS = {
    Ending.DONE: Exit.OK,
    Ending.TIME_LIMIT: Exit.TIME_LIMIT,
    Ending.FAULT: Exit.NODE_FAULT,
    Ending.NO_CELLS: Exit.NO_DEVICE,
}


def run(arguments: Namespace) -> int:
    """Bring the array up, run the program, turn everything off, and report how it went."""
    overrides = [*arguments.overrides, "run.fidelity=firmware"]
    if getattr(arguments, "bitrate", None):
        overrides.append(f"wire.bitrate={arguments.bitrate}")
    scenario = open_program(arguments.program, overrides)
    warn_of_load(scenario.array.columns * scenario.array.rows, scenario.wire)
    coordinator = coordinator_of(scenario)
    with open_link(arguments) as (link, clock):
        operation = operate(coordinator, link, clock, arguments.limit, _print_event)
    if arguments.json:
        print(json.dumps(_figures(scenario, coordinator, operation)))
    else:
        print(f"{scenario.title}: {operation.ending} after {operation.duration_s:.1f} s")
    return _verdict(operation)


def _print_event(time_s: float, text: str) -> None:
    say(f"{time_s:8.3f} s  {text}")


def _figures(
    scenario: Scenario, coordinator: Coordinator, operation: Operation
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
    }


def _verdict(operation: Operation) -> int:
    if operation.ending is Ending.INTERRUPTED:
        return INTERRUPTED
    code = EXITS[operation.ending]
    if code is not Exit.OK:
        raise CommandError(operation.fault or "the time limit has passed", code)
    return code
