"""`mdms simulate`: one scenario in virtual time."""

import errno
import json
from argparse import Namespace
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from mdms_array.figures import fault_of, figures_of, goals_of, report
from mdms_array.recording import keep_run
from mdms_array.run import Finished
from mdms_array.simulation import run_scenario
from mdms_array.source import open_program
from mdms_host.cli.console import progress
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.files import writing
from mdms_host.cli.streams import say
from mdms_host.motion.outcome import missed_text
from mdms_host.programs.program import Main
from mdms_model.run.comings import is_wrong
from mdms_model.run.folder import BUS_LOG, fresh_folder
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
    finished, figures = simulate(
        scenario, arguments.nodes, arguments.out, arguments.bus_format, main
    )
    if arguments.json:
        print(json.dumps(figures))
    else:
        print(*report(figures), sep="\n")
    return verdict(scenario, finished)


def simulate(
    scenario: Scenario,
    nodes: str,
    out: Path | None,
    bus_format: str = "log",
    main: Main | None = None,
) -> tuple[Finished, dict[str, Any]]:
    """Run a scenario and keep it in a folder, if any; the run and its figures."""
    with ExitStack() as stack:
        folder = stack.enter_context(_folder(out)) if out else None
        bus_log = folder / BUS_LOG if folder else None
        finished = _run(scenario, nodes, bus_log, main)
        figures = figures_of(scenario, finished)
        if folder and out:
            figures["run"] = str(out)
            with writing(out):
                keep_run(folder, scenario, finished.record, figures, bus_format)
    return finished, figures


@contextmanager
def _folder(out: Path) -> Iterator[Path]:
    """A fresh run folder; a device that is full, for the bus log too, is named so."""
    try:
        with fresh_folder(out) as folder:
            yield folder
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        raise CommandError(f"{out}: cannot be written: {error.strerror}", Exit.FAILURE) from None


def _run(scenario: Scenario, nodes: str, bus_log: Path | None, main: Main | None) -> Finished:
    if not _has_bus(scenario):
        return run_scenario(scenario)
    with progress(scenario.title) as advance:
        return run_scenario(scenario, nodes, advance, bus_log, main)


def _has_bus(scenario: Scenario) -> bool:
    return scenario.run.fidelity == "firmware"


def verdict(scenario: Scenario, finished: Finished) -> Exit:
    """Report what went wrong, if anything did; how the command ends."""
    for time_s, text in finished.troubles:
        say(f"{time_s:8.3f} s  {text}")
    missed = missed_text(goals_of(scenario, finished))
    fault = fault_of(finished)
    # That a parcel is stuck is among the troubles.
    for text in filter(None, (None if fault == finished.stuck else fault, missed)):
        say(f"mdms: {text}")
    for violation in finished.violations:
        say(f"{violation.time_s:8.3f} s  rule '{violation.rule}' broken: {violation.text}")
    if finished.violations or any(event.kind == "tip" for event in finished.record.events):
        return Exit.FAILURE
    if finished.fault is not None:
        return Exit.NODE_FAULT
    if finished.lost is not None or finished.failed:
        return Exit.FAILURE
    wrong = [event for event in finished.record.events if event.kind == "exit" and is_wrong(event)]
    if wrong:
        say(f"mdms: {wrong[0].parcel} {wrong[0].detail}, and {len(wrong) - 1} more after it")
        return Exit.FAILURE
    if finished.unfinished and missed is None:
        say(f"mdms: the program has not come to its end{finished.waits}")
        return Exit.TIME_LIMIT
    return Exit.OK if missed is None else Exit.TIME_LIMIT
