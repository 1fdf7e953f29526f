"""`mdms configure restore-defaults`: cells return to their defaults, but keep their node ids."""

from argparse import Namespace

from mdms_host.cli.configure.cells import (
    agreed,
    open_commissioning,
    ranges,
    read_cells,
    refuse_other_host,
    show_changes,
)
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.commissioning.cell_settings import PARAMETERS, WIRING


def run(arguments: Namespace) -> Exit:
    """Show what is not at its default; when that is agreed, restore, restart, and verify."""
    every = (*PARAMETERS, *WIRING)
    with open_commissioning(arguments) as commissioning:
        cells = read_cells(commissioning, arguments, every, to_write=not arguments.dry_run)
        node_ids = [cell.node_id for cell in cells]
        changes = [
            change
            for cell in cells
            for change in cell.changes({each: each.default(cell.node_id) for each in every})
        ]
        show_changes(changes)
        if arguments.dry_run:
            print(f"{len(changes)} settings are not at their defaults")
            return Exit.OK
        refuse_other_host(commissioning)
        if not agreed(arguments, f"Restore the defaults of node {ranges(node_ids)}, and restart?"):
            raise CommandError("nothing was changed", Exit.FAILURE)
        for node_id in node_ids:
            commissioning.restore_defaults(node_id)
        for change in changes:
            found = commissioning.read(change.node_id, *change.parameter.place)
            if found != change.after:
                what = f"node {change.node_id}, {change.parameter.name}"
                raise CommandError(f"{what} is not at its default", Exit.NODE_FAULT)
    print(f"defaults restored and verified on node {ranges(node_ids)}")
    return Exit.OK
