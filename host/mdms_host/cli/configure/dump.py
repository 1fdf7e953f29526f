"""`mdms configure dump`: all settings of an array in a file."""

from argparse import Namespace
from pathlib import Path

from mdms_host.cli.configure.cells import open_commissioning, read_cells
from mdms_host.cli.exits import Exit
from mdms_host.cli.scenario.inputs import telling_of_full_disk

STDOUT = Path("-")


def run(arguments: Namespace) -> Exit:
    """Read all settings and write the file, whole or not at all."""
    from mdms_host.commissioning.array_file import array_text
    from mdms_host.commissioning.parameters import PARAMETERS

    with open_commissioning(arguments) as commissioning:
        cells = read_cells(commissioning, arguments, PARAMETERS)
    text = array_text(cells)
    if arguments.file == STDOUT:
        print(text, end="")
        return Exit.OK
    partial = arguments.file.with_name(f".{arguments.file.name}.partial")
    with telling_of_full_disk(arguments.file):
        partial.write_text(text, encoding="utf-8")
        partial.replace(arguments.file)
    print(f"{len(cells)} cells, {len(PARAMETERS)} settings each: {arguments.file}")
    return Exit.OK
