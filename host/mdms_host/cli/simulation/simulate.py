"""`mdms simulate`: one scenario in virtual time."""

import json
from argparse import Namespace
from contextlib import nullcontext
from pathlib import Path

from mdms_array.figures import report
from mdms_array.run import Run, RunError
from mdms_array.simulation import run_and_keep, run_scenario
from mdms_array.source import open_program
from mdms_host.cli.console import progress
from mdms_host.cli.exits import CommandError, Exit, exit_of
from mdms_host.cli.files import writing
from mdms_host.cli.streams import say
from mdms_host.programs.program import Main
from mdms_model.scenario.scenario import Scenario


def run(arguments: Namespace) -> Exit:
    """Simulate, print the figures, and write the run folder if one is wanted."""
    overrides = list(arguments.overrides)
    for name in ("seed", "fidelity"):
        if getattr(arguments, name) is not None:
            overrides.append(f"run.{name}={getattr(arguments, name)}")
    scenario, main = open_program(arguments.scenario, overrides)
    if arguments.bus_format != "log" and not (arguments.out and _has_bus(scenario)):
        raise CommandError(
            "--bus-format: only a run of the firmware with --out has a bus log", Exit.USAGE
        )
    ended = simulate(scenario, arguments.nodes, arguments.out, arguments.bus_format, main)
    if arguments.json:
        print(json.dumps(ended.figures))
    else:
        print(*report(ended.figures), sep="\n")
    return verdict(ended)


def simulate(
    scenario: Scenario,
    nodes: str,
    out: Path | None,
    bus_format: str = "log",
    main: Main | None = None,
) -> Run:
    """Run a scenario and keep it in a folder, if any."""
    with progress(scenario.title) if _has_bus(scenario) else nullcontext() as advance:
        if out is None:
            return run_scenario(scenario, nodes, advance, main=main)
        with writing(out):
            return run_and_keep(
                scenario, out, nodes, progress=advance, bus_format=bus_format, main=main
            )


def _has_bus(scenario: Scenario) -> bool:
    return scenario.run.fidelity == "firmware"


def verdict(run: Run) -> Exit:
    """Report what went wrong, if anything did; how the command ends."""
    for incident in run.incidents:
        say(f"{incident.time_s:8.3f} s  {incident.text}")
    for violation in run.violations:
        say(f"{violation.time_s:8.3f} s  rule '{violation.rule}' broken: {violation.text}")
    try:
        run.raise_for_status()
    except RunError as error:
        # Violations have been said already; there may be a reason beside them.
        if run.reason:
            say(f"mdms: {run.reason}")
        return exit_of(error) or Exit.FAILURE
    return Exit.OK
