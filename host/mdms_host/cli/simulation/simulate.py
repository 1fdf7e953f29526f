"""`mdms simulate`: one scenario in virtual time."""

import json
from argparse import Namespace
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mdms_host.cli.console import progress, say
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.records.keep import keep_run
from mdms_host.cli.scenario.gain import open_program
from mdms_host.cli.simulation.compose import Finished, run_scenario
from mdms_host.cli.simulation.figures import figures_of, report
from mdms_model.run.folder import BUS_LOG, fresh_folder
from mdms_model.scenario.scenario import Scenario


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
        print(*report(figures), sep="\n")
    return verdict(finished)


def simulate(
    scenario: Scenario, nodes: str, out: Path | None, bus_format: str = "log"
) -> tuple[Finished, dict[str, Any]]:
    """Run a scenario and keep it in a folder, if any; the run and its figures."""
    with ExitStack() as stack:
        folder = stack.enter_context(fresh_folder(out)) if out else None
        bus_log = folder / BUS_LOG if folder else None
        finished = _run(scenario, nodes, bus_log)
        figures = figures_of(scenario, finished)
        if folder:
            figures["run"] = str(out)
            keep_run(folder, scenario, finished.record, figures, bus_format)
    return finished, figures


def _run(scenario: Scenario, nodes: str, bus_log: Path | None) -> Finished:
    if not _has_bus(scenario):
        return run_scenario(scenario)
    with progress(scenario.title) as advance:
        return run_scenario(scenario, nodes, advance, bus_log)


def _has_bus(scenario: Scenario) -> bool:
    return scenario.run.fidelity == "firmware"


def verdict(finished: Finished) -> Exit:
    """Report what went wrong, if anything did; how the command ends."""
    for event in finished.record.events:
        if event.kind == "tip":
            say(f"mdms: {event.parcel} tips at {event.time_s:.3f} s: {event.detail}")
            return Exit.FAILURE
    if finished.fault is not None:
        say(f"mdms: {finished.fault}")
        return Exit.NODE_FAULT
    return Exit.OK
