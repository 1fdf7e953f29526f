"""The verbs `help` and `completion`: the command's documents, and a script for shells."""

import sys
from argparse import Action, Namespace, _SubParsersAction
from collections.abc import Iterator
from pathlib import Path

import shtab
from rich.console import Console
from rich.markdown import Markdown
from rich.table import Table

from mdms_host.cli.console import show
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.parser import Parser

_PACKAGE = Path(__file__).parents[1]


def complete(arguments: Namespace) -> ExitCode:
    """Print the script; nothing is installed."""
    from mdms_host.cli.verbs import build_parser  # noqa: PLC0415 - the table names this module

    parser = build_parser()
    for each in _parsers(parser):
        each.add_late_options()
        for action in each._actions:
            _complete_files(action)
    print(shtab.complete(parser, shell=arguments.shell), end="")
    return ExitCode.OK


def _parsers(parser: Parser) -> Iterator[Parser]:
    """A parser and those of all its verbs."""
    yield parser
    for action in parser._actions:
        if isinstance(action, _SubParsersAction):
            for own in action.choices.values():
                yield from _parsers(own)


def _complete_files(action: Action) -> None:
    """Where a path is wanted files are completed; scenarios may be files."""
    if action.type is Path or action.metavar == "SCENARIO":
        action.complete = shtab.FILE  # type: ignore[attr-defined]


#: Documents by topic: their places in the project, and their subjects.
TOPICS = {
    "start": ("README.md", "the project in short, and the first steps"),
    "newcomer": ("docs/newcomer.md", "from parts to the first moving parcel"),
    "guide": ("docs/index.md", "all pages of the guide, by task"),
    "install": ("docs/install.md", "install and first run"),
    "page": ("docs/page.md", "the live page in a browser"),
    "commissioning": ("docs/commissioning.md", "node ids, settings, doctor, the array file"),
    "integrator": ("docs/integrator.md", "from a sorter to a program"),
    "line": ("docs/line.md", "the table as a machine of a line"),
    "line-registers": ("docs/line-registers.md", "registers and nodes of a line"),
    "operation": ("docs/operation.md", "a table that runs for weeks: logs, reports, a service"),
    "parcels": ("docs/parcels.md", "many parcels: programs, traffic, routes"),
    "cells": ("docs/cells.md", "cells that steer by themselves"),
    "right-of-way": ("docs/right-of-way.md", "rules by which cells keep parcels apart"),
    "motion": ("docs/motion.md", "how the host finds and moves parcels"),
    "faults": ("docs/faults.md", "every fault: reaction, delay, way back, message"),
    "emergency-stop": ("docs/emergency-stop.md", "two forms that brake, with parts and distances"),
    "troubleshooting": ("docs/troubleshooting.md", "by symptom: cause and cure"),
    "boards": ("docs/boards.md", "boards, wiring, parts, flashing over USB"),
    "inside": ("docs/firmware.md", "inside the firmware: tick, speed loop, figures"),
    "updates": ("docs/updates.md", "firmware over the bus"),
    "bus": ("docs/bus.md", "the bus and other tools"),
    "researcher": ("docs/researcher.md", "from the paper to the code"),
    "experiments": ("docs/experiments.md", "experiments and benchmarks"),
    "sweeps": ("docs/sweeps.md", "many settings and seeds, tuning"),
    "swinging": ("docs/swinging.md", "figure 8 as an experiment"),
    "rolling-ends": ("docs/rolling-ends.md", "equations (12) to (17) as an experiment"),
    "losses": ("docs/losses.md", "lost frames and dead cells as an experiment"),
    "learning": ("docs/learning.md", "environments for learning"),
    "command": ("docs/command.md", "verbs, exit codes, run folders"),
    "scenarios": ("docs/scenarios.md", "every key of a scenario"),
    "programs": ("docs/programs.md", "tasks, and programs in Python"),
    "api": ("docs/api.md", "every public name of Python"),
    "code": ("docs/code.md", "a map of the host's code"),
    "host": ("host/README.md", "the folder of the host"),
    "firmware": ("firmware/README.md", "the folder of the firmware"),
    "freezing": ("firmware/FREEZING.md", "firmware frozen into MicroPython"),
    "protocol": ("protocol/README.md", "frames on the bus"),
    "objects": ("protocol/OBJECTS.md", "the object table"),
    "simulator": ("sim_bus/README.md", "the virtual bus, the physics, scenarios"),
    "design": ("DESIGN.md", "why it is as it is"),
    "changes": ("CHANGELOG.md", "changes since the last version"),
}


def help_on(arguments: Namespace) -> ExitCode:
    """Print a document, or the list of all; a terminal gets a pager."""
    if arguments.topic is None:
        table = Table("topic", "about")
        for name, (_, about) in TOPICS.items():
            table.add_row(name, about)
        show(table)
        print("mdms help TOPIC prints one; mdms VERB --help has the options of a verb")
        return ExitCode.OK
    text = document(arguments.topic)
    if not sys.stdout.isatty():
        print(text, end="")
        return ExitCode.OK
    console = Console()
    with console.pager(styles=True):
        console.print(Markdown(text))
    return ExitCode.OK


def document(topic: str) -> str:
    """The text of a document. Raises `CommandError` for an unknown topic, or one left out."""
    if topic not in TOPICS:
        known = ", ".join(TOPICS)
        raise CommandError(f"{topic}: no such topic; there are {known}", ExitCode.USAGE)
    name = TOPICS[topic][0]
    # In a wheel they have a folder beside the packages, in the project they lie where they are.
    for root in (_PACKAGE.parent / "mdms_docs", _PACKAGE.parents[1]):
        path = root / name
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise CommandError(f"{name} is not installed", ExitCode.FAILURE)
