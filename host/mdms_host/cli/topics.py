"""`mdms help TOPIC`: the documents, without a network."""

import sys
from argparse import Namespace
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown
from rich.table import Table

from mdms_host.cli.console import show
from mdms_host.cli.exits import CommandError, Exit

#: Documents by topic: where they are in the project, and what they are about.
TOPICS = {
    "start": ("README.md", "what this is, and the first steps"),
    "newcomer": ("docs/newcomer.md", "from parts to the first moving parcel"),
    "researcher": ("docs/researcher.md", "from the paper to the code"),
    "integrator": ("docs/integrator.md", "from a sorter to a program"),
    "troubleshooting": ("docs/troubleshooting.md", "by symptom: cause and cure"),
    "scenarios": ("docs/scenarios.md", "every key of a scenario"),
    "programs": ("docs/programs.md", "tasks, and programs in Python"),
    "api": ("docs/api.md", "every public name of Python"),
    "host": ("host/README.md", "coordinator, array files, commissioning, the command"),
    "firmware": ("firmware/README.md", "boards, wiring, parts, faults, flashing"),
    "freezing": ("firmware/FREEZING.md", "firmware frozen into MicroPython"),
    "protocol": ("protocol/README.md", "what goes over the bus"),
    "objects": ("protocol/OBJECTS.md", "the object table"),
    "simulator": ("sim_bus/README.md", "the virtual bus, the physics, scenarios"),
    "design": ("DESIGN.md", "why it is as it is"),
    "changes": ("CHANGELOG.md", "what is new"),
}
_PACKAGE = Path(__file__).parents[1]


def run(arguments: Namespace) -> Exit:
    """Print a document, or which there are; pages go through a pager on a terminal."""
    if arguments.topic is None:
        table = Table("topic", "about")
        for name, (_, about) in TOPICS.items():
            table.add_row(name, about)
        show(table)
        print("mdms help TOPIC prints one; mdms VERB --help has the options of a verb")
        return Exit.OK
    text = document(arguments.topic)
    if not sys.stdout.isatty():
        print(text, end="")
        return Exit.OK
    console = Console()
    with console.pager(styles=True):
        console.print(Markdown(text))
    return Exit.OK


def document(topic: str) -> str:
    """The text of a document. Raises `CommandError` for an unknown topic, or one left out."""
    if topic not in TOPICS:
        known = ", ".join(TOPICS)
        raise CommandError(f"{topic}: no such topic; there are {known}", Exit.USAGE)
    name = TOPICS[topic][0]
    # In a wheel they have a folder beside the packages, in the project they lie where they are.
    for root in (_PACKAGE.parent / "mdms_docs", _PACKAGE.parents[1]):
        path = root / name
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise CommandError(f"{name} is not installed", Exit.FAILURE)
