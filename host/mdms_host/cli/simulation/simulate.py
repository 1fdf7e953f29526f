"""`mdms simulate`: one scenario in virtual time."""

import json
from argparse import Namespace
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdms_host.cli.console import progress, say
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import Verbs, add_json, add_nodes, add_scenario
from mdms_host.cli.scenario.inputs import folder_to_fill, open_program, telling_of_full_disk
from mdms_host.cli.simulation.bus_log import FORMATS, convert_log
from mdms_model.scenario.scenario import FIDELITIES

if TYPE_CHECKING:
    from mdms_host.cli.simulation.compose import Finished
    from mdms_model.scenario.scenario import Scenario


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("simulate", help="run one scenario in virtual time")
    add_scenario(parser)
    parser.add_argument("--out", metavar="DIR", type=Path, help="write a run folder")
    parser.add_argument(
        "--bus-format",
        choices=FORMATS,
        default="log",
        help="write the bus log in this form too, beside bus.log (candump)",
    )
    parser.add_argument("--seed", metavar="N", type=int, help="instead of the scenario's run.seed")
    add_nodes(parser)
    parser.add_argument("--fidelity", choices=FIDELITIES, help="instead of run.fidelity")
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Simulate, print the figures, and write the run folder if one is wanted."""
    overrides = list(arguments.overrides)
    for name in ("seed", "fidelity"):
        if getattr(arguments, name) is not None:
            overrides.append(f"run.{name}={getattr(arguments, name)}")
    scenario = open_program(arguments.scenario, overrides)
    if arguments.bus_format != "log" and not (arguments.out and _has_bus(scenario)):
        raise CommandError(
            "--bus-format: only a run of the firmware with --out has a bus log", Exit.USAGE
        )
    finished, figures = simulate(scenario, arguments.nodes, arguments.out, arguments.bus_format)
    if arguments.json:
        print(json.dumps(figures))
    else:
        from mdms_host.cli.simulation.figures import report

        print(*report(figures), sep="\n")
    return verdict(finished)


def simulate(
    scenario: "Scenario", nodes: str, out: Path | None, bus_format: str = "log"
) -> "tuple[Finished, dict[str, Any]]":
    """Run a scenario and keep it in a folder, if any. Raises `CommandError`."""
    from mdms_host.cli.simulation.figures import figures_of

    with ExitStack() as stack:
        folder = stack.enter_context(folder_to_fill(out)) if out else None
        bus_log = folder / "bus.log" if folder else None
        finished = _run(scenario, nodes, bus_log)
        figures = figures_of(scenario, finished)
        if folder:
            from mdms_model.run.folder import DATABASE, write_run
            from mdms_protocol.generators import dbc
            from mdms_sim.plots import save_picture

            figures["run"] = str(out)
            with telling_of_full_disk(folder):
                if _has_bus(scenario):
                    convert_log(folder / "bus.log", bus_format)
                    (folder / DATABASE).write_text(dbc.text(), "utf-8")
                write_run(folder, scenario, finished.record, figures, save_picture)
    return finished, figures


def _run(scenario: "Scenario", nodes: str, bus_log: Path | None) -> "Finished":
    from mdms_host.cli.simulation.compose import run_scenario

    if not _has_bus(scenario):
        return run_scenario(scenario)
    with progress(scenario.title) as advance:
        return run_scenario(scenario, nodes, advance, bus_log)


def _has_bus(scenario: "Scenario") -> bool:
    return scenario.run.fidelity == "firmware"


def verdict(finished: "Finished") -> Exit:
    """Tell what went wrong, if anything did, and how the command ends."""
    for event in finished.record.events:
        if event.kind == "tip":
            say(f"mdms: {event.parcel} tips at {event.time_s:.3f} s: {event.detail}")
            return Exit.FAILURE
    if finished.fault is not None:
        say(f"mdms: {finished.fault}")
        return Exit.NODE_FAULT
    return Exit.OK
