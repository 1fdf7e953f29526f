"""`mdms run`: the coordinator on a real or served array."""

import json
from argparse import Namespace
from math import isnan
from typing import TYPE_CHECKING

from mdms_host.cli.array.bus import add_bus, open_link
from mdms_host.cli.console import say
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import Verbs, add_json, add_overrides
from mdms_host.cli.scenario.inputs import open_program

if TYPE_CHECKING:
    from mdms_host.coordination.coordinator import Coordinator
    from mdms_host.coordination.operation import Operation
    from mdms_model.scenario.scenario import Scenario

INTERRUPTED = 130


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("run", help="run a program on a real or served array", late=add_bus)
    parser.add_argument(
        "program", metavar="PROGRAM", help="a scenario: its array, its parcels, its motion"
    )
    add_overrides(parser)
    parser.add_argument("--limit", metavar="SECONDS", type=float, help="give up after so long")
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> int:
    """Bring the array up, run the program, turn everything off, and tell how it went."""
    scenario = open_program(arguments.program, [*arguments.overrides, "run.fidelity=firmware"])
    from mdms_host.cli.scenario.coordination import coordinator_of
    from mdms_host.coordination.operation import operate

    coordinator = coordinator_of(scenario)
    with open_link(arguments) as (link, clock):
        operation = operate(coordinator, link, clock, arguments.limit, _tell)
    if arguments.json:
        print(json.dumps(_figures(scenario, coordinator, operation)))
    else:
        print(f"{scenario.title}: {operation.ending} after {operation.duration_s:.1f} s")
    return _verdict(operation)


def _tell(time_s: float, text: str) -> None:
    say(f"{time_s:8.3f} s  {text}")


def _figures(
    scenario: "Scenario", coordinator: "Coordinator", operation: "Operation"
) -> dict[str, object]:
    from mdms_host.cli.scenario.coordination import estimates_of

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


def _verdict(operation: "Operation") -> int:
    from mdms_host.coordination.operation import Ending

    if operation.ending is Ending.INTERRUPTED:
        return INTERRUPTED
    code = {
        Ending.DONE: Exit.OK,
        Ending.TIME_LIMIT: Exit.TIME_LIMIT,
        Ending.FAULT: Exit.NODE_FAULT,
        Ending.NO_CELLS: Exit.NO_DEVICE,
    }[operation.ending]
    if code is not Exit.OK:
        raise CommandError(operation.fault or "the time limit has passed", code)
    return code
